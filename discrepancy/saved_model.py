"""An extended model as it is saved with a test, and as the baseline of later tests once somebody accepted it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

from discrepancy.causes.base import Cause, Fitted
from discrepancy.diagnosis import Finding
from discrepancy.intervals import fitted_values, standard_errors
from discrepancy.least_squares import Fit
from discrepancy.preload import PRELOAD
from discrepancy.registry import CAUSES
from estimators.base import NORMAL_95
from valve.errors import RequestError
from valve.nameplate import Nameplate
from valve.parameters import PARAMETER_SYMBOLS

SCHEMA: Final = "breakaway/valve-model/1"
_STATIC: Final = "F_s"
_OFFSET: Final = "offset_n"


@dataclass(frozen=True, slots=True)
class SavedModel:
    """The valve's parameters by symbol and its causes' by name, each with the ends of its 95 % interval."""

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
            raise RequestError(f"the model's schema is {saved.get('schema')!r}, it must be {SCHEMA}: repeat the test")
        try:
            parameters = _from_json(saved["parameters"])
            causes = {str(cause): _from_json(entries) for cause, entries in saved["causes"].items()}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise RequestError(
                f"the model cannot be read ({type(error).__name__}: {error}): repeat the test"
            ) from error
        unknown = sorted(set(causes) - set(CAUSES) - {PRELOAD.name})
        if unknown:
            raise RequestError(f"the model has the cause {unknown[0]!r}, which this version does not know: repeat it")
        return cls(parameters, causes)

    def nameplate(self, nameplate: Nameplate) -> Nameplate:
        """Return the nameplate with the bench set that was accepted."""
        entry = self.causes.get(PRELOAD.name, {}).get(_OFFSET)
        actuator = nameplate.actuator
        if entry is None or actuator.bench_set_pa is None or actuator.diaphragm_area_m2 is None:
            return nameplate
        offset_pa = entry.value / actuator.diaphragm_area_m2
        low_pa, high_pa = actuator.bench_set_pa
        return replace(nameplate, actuator=replace(actuator, bench_set_pa=(low_pa + offset_pa, high_pa + offset_pa)))

    def fitted_causes(self) -> tuple[Cause, ...]:
        """Return the causes that have a place in the motion: all but the preload, which is the nameplate's."""
        return tuple(CAUSES[name] for name in self.causes if name in CAUSES)

    def values(self) -> dict[str, float]:
        """Return its values by the names of the fit's unknowns."""
        found = {symbol: entry.value for symbol, entry in self.parameters.items() if symbol != _STATIC}
        static, coulomb = self.parameters.get(_STATIC), self.parameters.get("F_c")
        if static is not None and coulomb is not None and coulomb.value > 0.0:
            found["d"] = max(static.value / coulomb.value - 1.0, 0.0)
        for cause in self.fitted_causes():
            found |= cause.full({name: entry.value for name, entry in self.causes[cause.name].items()})
        return found


def saved_model(fit: Fit, findings: tuple[Finding, ...], accepted: SavedModel | None = None) -> SavedModel:
    """Return the extended valve of a fit; the preload's offset adds to the one that was accepted."""
    causes = {name: fitted_values(fit, CAUSES[name]) for name in fit.model.causes}
    offset = next((one.parameters[_OFFSET] for one in findings if one.cause == PRELOAD.name), None)
    before = None if accepted is None else accepted.causes.get(PRELOAD.name, {}).get(_OFFSET)
    if offset is not None and before is not None:
        offset = Fitted(offset.value + before.value, offset.low + before.value, offset.high + before.value, offset.unit)
    preload = offset if offset is not None else before
    if preload is not None:
        causes[PRELOAD.name] = {_OFFSET: preload}
    return SavedModel(_parameters(fit), causes)


def _parameters(fit: Fit) -> dict[str, Fitted]:
    values, entries = fit.values, {entry.name: entry for entry in fit.model.unknowns.entries}
    errors = dict(zip(fit.model.unknowns.names, standard_errors(fit), strict=True))
    found: dict[str, Fitted] = {}
    for symbol, entry in PARAMETER_SYMBOLS.items():
        if symbol == _STATIC:
            static_n, half = values["F_c"] * (1.0 + values["d"]), NORMAL_95 * float(errors.get("d", 0.0))
            half_n = min(values["F_c"] * half, abs(static_n))
            found[symbol] = Fitted(static_n, static_n - half_n, static_n + half_n, entry.unit)
            continue
        unknown = entries.get(symbol)
        value = values[symbol]
        low = high = value
        if unknown is not None and math.isfinite(errors[symbol]):
            at, half = unknown.coordinate(value), NORMAL_95 * float(errors[symbol])
            lowest, highest = unknown.coordinate(unknown.lower), unknown.coordinate(unknown.upper)
            low, high = unknown.value(max(at - half, lowest)), unknown.value(min(at + half, highest))
        elif unknown is not None:
            low, high = unknown.lower, unknown.upper
        found[symbol] = Fitted(value, low, high, entry.unit)
    return found


def _to_json(entries: Mapping[str, Fitted]) -> dict[str, Any]:
    return {
        name: {"value": entry.value, "ci95": [entry.low, entry.high], "unit": entry.unit}
        for name, entry in entries.items()
    }


def _from_json(entries: Mapping[str, Any]) -> dict[str, Fitted]:
    found = {}
    for name, entry in entries.items():
        low, high = (float(end) for end in entry["ci95"])
        value = float(entry["value"])
        if not all(map(math.isfinite, (value, low, high))):
            raise ValueError(f"{name} is not a finite number")
        found[str(name)] = Fitted(value, low, high, str(entry["unit"]))
    return found
