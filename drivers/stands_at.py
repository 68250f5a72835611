"""Where a valve stands: its signal and its stem, each as it was read, and whether the stem is where it should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from valve.errors import ConfigurationError
from valve.messages import say

_LONGEST_S = 600.0  # a stem that needs longer is not judged by a look; no test of its valve starts until then


@dataclass(frozen=True, slots=True)
class RestRules:
    """Where the stem should stand at the safe value, and when after a motion it is looked at.

    ``position_m`` is the declared safe position, None where there is none: then the stem is told and not judged.
    ``travel_m`` is the rated travel; None where nobody knows it.
    """

    position_m: float | None = None
    tolerance_m: float = 0.0
    after_s: float = 10.0
    travel_m: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.after_s <= _LONGEST_S:
            raise ConfigurationError(
                say(
                    "stem_read_time_outside",
                    "{key} is {time:g s}, it must be from 0 to {most:g s}: correct it",
                    key="stem_read_after_s",
                    time=self.after_s,
                    most=_LONGEST_S,
                )
            )
        if self.position_m is not None and not self.tolerance_m > 0.0:
            raise ConfigurationError(
                say(
                    "safe_tolerance_not_positive",
                    "{key} is {tolerance:g m}, it must be above 0: correct it",
                    key="safe_position_tolerance_m",
                    tolerance=self.tolerance_m,
                )
            )


class StemVerdict(StrEnum):
    """Whether a stem stands where it should."""

    MOVING = "moving"  # its time is not over, or nobody could look since
    THERE = "there"
    NOT_THERE = "not_there"
    UNKNOWN = "unknown"  # a safe position is declared, and no valid position could be read
    NOT_JUDGED = "not_judged"  # no safe position is declared

    @property
    def is_alarm(self) -> bool:
        """Whether somebody must look at the valve."""
        return self in (StemVerdict.NOT_THERE, StemVerdict.UNKNOWN)


@dataclass(frozen=True, slots=True)
class StandsAt:
    """Where a valve was seen to stand at one instant.

    ``safe_pa`` is its safe value, Pa, None where nobody knows it; ``signal_pa`` what its device showed as output, None
    where that was not read, for the reason ``signal_unread``; ``signal_is_safe`` whether they are the same, None where
    one is not known. ``signal_confirmed`` is whether the safe value was read back after the motion; None where the
    motion commanded nothing. ``stem_m`` is the stem's position, None where it was not read, for the reason
    ``stem_unread``. ``after_s`` counts from the end of the motion, ``due_s`` is when the stem is to be looked at.
    """

    verdict: StemVerdict
    read_at: datetime
    after_s: float
    safe_pa: float | None = None
    signal_pa: float | None = None
    signal_is_safe: bool | None = None
    signal_confirmed: bool | None = None
    signal_unread: str = ""
    stem_m: float | None = None
    stem_unread: str = ""
    travel_m: float | None = None
    safe_position_m: float | None = None
    tolerance_m: float | None = None
    due_s: float = 0.0

    @property
    def stem_percent(self) -> float | None:
        """Where the stem stood, in percent of its rated travel from the closed end; None where that is not known."""
        if self.stem_m is None or self.travel_m is None:
            return None
        return 100.0 * self.stem_m / self.travel_m

    def to_json(self) -> dict[str, Any]:
        """Return it as the store and the interface have it."""
        return asdict(self) | {"verdict": self.verdict.value, "read_at": self.read_at.isoformat()}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> StandsAt:
        """Return what ``to_json`` made; what else stands there is left out. Raises ValueError and KeyError."""
        known = {one.name: stored[one.name] for one in fields(cls) if one.name in stored}
        read_at = datetime.fromisoformat(stored["read_at"])
        return cls(**{**known, "verdict": StemVerdict(stored["verdict"]), "read_at": read_at})


def stands_at(
    rules: RestRules,
    *,
    after_s: float,
    safe_pa: float | None,
    confirmed: bool | None,
    signal_pa: float | None = None,
    signal_tolerance_pa: float = 0.0,
    signal_unread: str = "",
    stem_m: float | None = None,
    stem_unread: str = "",
    is_over: bool = True,
) -> StandsAt:
    """Judge what was read of a valve ``after_s`` seconds after its motion; ``is_over``: whether it should be there."""
    if confirmed is None:  # whoever commands it now may have it stand anywhere
        rules = replace(rules, position_m=None)
    judged = rules.position_m is not None
    return StandsAt(
        _verdict(rules, stem_m) if is_over else StemVerdict.MOVING,
        datetime.now(UTC),
        after_s,
        safe_pa,
        signal_pa,
        abs(signal_pa - safe_pa) <= signal_tolerance_pa if signal_pa is not None and safe_pa is not None else None,
        confirmed,
        signal_unread,
        stem_m,
        stem_unread,
        rules.travel_m,
        rules.position_m,
        rules.tolerance_m if judged else None,
        rules.after_s,
    )


def unseen(stands: StandsAt, reason: str) -> StandsAt:
    """Return the same valve as one that nobody can look at any more, for ``reason``."""
    verdict = StemVerdict.NOT_JUDGED if stands.safe_position_m is None else StemVerdict.UNKNOWN
    return replace(
        stands,
        verdict=verdict,
        read_at=datetime.now(UTC),
        signal_pa=None,
        signal_is_safe=None,
        signal_unread=reason,
        stem_m=None,
        stem_unread=reason,
    )


def _verdict(rules: RestRules, stem_m: float | None) -> StemVerdict:
    if rules.position_m is None:
        return StemVerdict.NOT_JUDGED
    if stem_m is None:
        return StemVerdict.UNKNOWN
    is_there = abs(stem_m - rules.position_m) <= rules.tolerance_m
    return StemVerdict.THERE if is_there else StemVerdict.NOT_THERE
