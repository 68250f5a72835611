"""Where a valve goes when its test ends: ``safe_value_pa``, and where its stem should stand then."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Final, Literal

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from drivers.addresses import MotionLimits
from drivers.permissive_rules import PermissiveRules
from drivers.stands_at import RestRules
from service.config.errors import SAFE_VALUE
from valve.errors import ConfigurationError
from valve.messages import say
from valve.nameplate import Nameplate

if TYPE_CHECKING:
    from service.config.errors import Findings, Key

_TOLERANCE: Final = 0.02  # of the travel: own choice, above a sensor's drift and below a valve that passes
_WIDEST: Final = 0.25  # of the travel: wider would call a valve closed that stands open


def _pressure_or_entry(value: object) -> object:
    if value == "entry":
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return value
    raise PydanticCustomError(SAFE_VALUE, "it is neither a pressure nor an order")


SafeValue = Annotated[float | Literal["entry"], BeforeValidator(_pressure_or_entry)]


def rest_rules(
    findings: Findings,
    key: Key,
    nameplate: Nameplate,
    limits: MotionLimits,
    permissives: PermissiveRules,
    *,
    position_m: float | None,
    tolerance_m: float | None,
    after_s: float | None,
) -> RestRules | None:
    """Return where the stem should stand at the safe value, or None with the faults noted."""
    travel_m, before = nameplate.actuator.travel_m, len(findings)
    if position_m is not None:
        spans = (("permissives.position_m", permissives.position_m), ("limits.position_m", limits.position_m))
        for name, span_m in spans:
            if span_m is not None and not span_m[0] <= position_m <= span_m[1]:
                findings.add(
                    (*key, "safe_position_m"),
                    position_m,
                    say(
                        "stem_can_be",
                        "the stem can only be at {low:g in m} to {high:g m} ({name})",
                        low=span_m[0],
                        high=span_m[1],
                        name=name,
                    ),
                    say("give_position", "give the position in m from the closed end, or correct that span"),
                )
    if tolerance_m is not None and position_m is None:
        reason = say("belongs_to_missing", "it belongs to {other}, which is missing", other="safe_position_m")
        findings.add(
            (*key, "safe_position_tolerance_m"), tolerance_m, reason, say("add_or_remove", "add that, or remove this")
        )
    elif tolerance_m is not None and not 0.0 < tolerance_m <= _WIDEST * travel_m:
        findings.add(
            (*key, "safe_position_tolerance_m"),
            tolerance_m,
            say(
                "quarter_of_travel",
                "it must be above 0 and at most a quarter of the travel, {widest:.4g m}",
                widest=_WIDEST * travel_m,
            ),
            say("correct_it", "correct it"),
        )
    if len(findings) > before:
        return None
    wanted = {} if after_s is None else {"after_s": after_s}
    try:
        return RestRules(position_m, tolerance_m or _TOLERANCE * travel_m, travel_m=travel_m, **wanted)
    except ConfigurationError as error:
        findings.add_error((*key, "stem_read_after_s"), error)
        return None
