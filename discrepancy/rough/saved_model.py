"""An extended model as it is saved with a test, and read back once somebody accepted it for the valve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

from discrepancy.rough.causes import CAUSES, HIDING_CAUSES, SEEN_CAUSES
from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.spring_preload import SpringPreload
from valve.errors import RequestError
from valve.messages import say
from valve.nameplate import Nameplate

SCHEMA: Final = "breakaway/valve-model/2"
_KNOWN: Final = frozenset({one.name for one in CAUSES} | {one.name for one in (*HIDING_CAUSES, *SEEN_CAUSES)})
_OFFSET: Final = "offset_n"


@dataclass(frozen=True, slots=True)
class SavedModel:
    """k, F_0, F_c and F_s by symbol, as fitted beside the causes, and the causes' parameters by name."""

    parameters: Mapping[str, Fitted]
    causes: Mapping[str, Mapping[str, Fitted]]

    def to_json(self) -> dict[str, Any]:
        """Return the model as the analysis object's ``discrepancy.extended_model``."""
        causes = {cause: _to_json(entries) for cause, entries in self.causes.items()}
        return {"schema": SCHEMA, "parameters": _to_json(self.parameters), "causes": causes}

    @classmethod
    def from_json(cls, saved: Mapping[str, Any]) -> Self:
        """Read a model back. Raises RequestError where it is none of this version, or names an unknown cause."""
        if saved.get("schema") != SCHEMA:
            raise RequestError(
                say(
                    "model_schema",
                    "the model's schema is {schema}, it must be {needed}: repeat the test",
                    schema=repr(saved.get("schema")),
                    needed=SCHEMA,
                )
            )
        try:
            parameters = _from_json(saved["parameters"])
            causes = {str(cause): _from_json(entries) for cause, entries in saved["causes"].items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RequestError(
                say(
                    "model_unreadable",
                    "the model cannot be read ({kind}: {why}): repeat the test",
                    kind=type(error).__name__,
                    why=str(error),
                )
            ) from error
        unknown = sorted(set(causes) - _KNOWN)
        if unknown:
            raise RequestError(
                say(
                    "model_cause_unknown",
                    "the model has the cause {cause}, which this version does not know: repeat it",
                    cause=repr(unknown[0]),
                )
            )
        return cls(parameters, causes)

    @property
    def preload(self) -> Fitted | None:
        """By how much the preload is off the nameplate's, None where it was not accepted to be."""
        return self.causes.get(SpringPreload.name, {}).get(_OFFSET)

    def nameplate(self, nameplate: Nameplate) -> Nameplate:
        """Return the nameplate with the bench set that was accepted."""
        entry, actuator = self.preload, nameplate.actuator
        if entry is None or actuator.bench_set_pa is None or actuator.diaphragm_area_m2 is None:
            return nameplate
        offset_pa = entry.value / actuator.diaphragm_area_m2
        low_pa, high_pa = actuator.bench_set_pa
        return replace(nameplate, actuator=replace(actuator, bench_set_pa=(low_pa + offset_pa, high_pa + offset_pa)))


def _to_json(entries: Mapping[str, Fitted]) -> dict[str, Any]:
    return {name: entry.to_json() for name, entry in entries.items()}


def _from_json(entries: Mapping[str, Any]) -> dict[str, Fitted]:
    found = {}
    for name, entry in entries.items():
        value, error = float(entry["value"]), float(entry["std_error"])
        if not (math.isfinite(value) and math.isfinite(error)):
            raise ValueError(f"{name} is not a finite number")
        found[str(name)] = Fitted(value, error, str(entry["unit"]))
    return found
