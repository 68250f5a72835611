"""A pressure that is counted from vacuum: an atmosphere too high everywhere, which no motion of the stem shows.

The nameplate does: with its bench set it says which pressure holds the stem where, with the range of its signal which
pressures there can be. Of friction and spring an absolute pressure says the same as a gauge pressure, of the preload
nothing, as nobody recorded the atmosphere of that day and place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.data_faults.fault import DataFault
from valve.messages import say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

#: A recording says in its provenance that its pressure is counted from vacuum.
FROM_VACUUM: Final = "pressure_pa is counted from vacuum"
ATMOSPHERE_PA: Final = 101325.0  # the standard atmosphere, ISO 2533
#: The atmosphere from 2,000 m above the sea to a high at the shore, Pa.
_LOW_PA: Final = 79.0e3
_HIGH_PA: Final = 107.0e3
_FITS: Final = 1.35  # times the pressure's range: so far a supply goes beyond it
_OFF: Final = 0.35  # of the range: no adjuster moves a spring so far
_MOVED: Final = 0.2  # of the travel, before the bench set says anything
_PRELOAD: Final = "spring_preload"
REASON: Final = say(
    "counted_from_vacuum",
    "the pressure is counted from vacuum, and the atmosphere of that day and place was not recorded",
)
_NOT_ASSESSED: Final = say("not_assessed_for", "Not assessed: {why}.", why=REASON)


def as_gauge(recording: Recording, nameplate: Nameplate, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording with the standard atmosphere taken off its pressure where that is absolute."""
    pressure_pa = recording.pressure_pa
    if pressure_pa is None or recording.force_n is not None or nameplate.actuator.action is not Action.SPRING:
        return recording, []
    known = pressure_pa[np.isfinite(pressure_pa)]
    if known.size < 20:
        return recording, []
    stated = FROM_VACUUM in recording.provenance.notes
    low_pa, high_pa = (float(end) for end in np.percentile(known, (0.5, 99.5)))
    why = say("by_its_unit", "by its unit") if stated else _why(recording, nameplate, low_pa, high_pa)
    if not why:
        return recording, []
    sentence = say(
        "pressure_from_vacuum",
        "The pressure{place} is counted from vacuum: it is {low:.4g in kPa} to {high:.4g kPa}, {why}. The standard "
        "atmosphere of {atmosphere:.6g kPa} was taken off. Friction and spring rate are not touched by it; preload and "
        "bench set are not given, as the atmosphere of that day and place is not known. Record a gauge pressure.",
        place=place,
        low=low_pa,
        high=high_pa,
        why=why,
        atmosphere=ATMOSPHERE_PA,
    )
    fault = DataFault("pressure_pa", "from_vacuum", 0, sentence, {"taken_off_pa": (ATMOSPHERE_PA, "Pa")})
    return replace(recording, pressure_pa=pressure_pa - ATMOSPHERE_PA), [fault]


def _why(recording: Recording, nameplate: Nameplate, low_pa: float, high_pa: float) -> str:
    """Return what of the nameplate says so; "" where the pressure may be a gauge's."""
    signal, bench_pa = nameplate.signal, nameplate.actuator.bench_set_pa
    ends = [span for span in (None if signal is None else signal.range_pa, bench_pa) if span is not None]
    if not ends:
        return ""
    least_pa, full_pa = min(span[0] for span in ends), max(span[1] for span in ends)
    range_pa = full_pa - least_pa
    # with an atmosphere less it fits the nameplate
    if low_pa - _HIGH_PA < least_pa - 0.1 * range_pa - (_HIGH_PA - _LOW_PA) or low_pa < _LOW_PA:
        return ""
    if high_pa - _HIGH_PA > least_pa + _FITS * range_pa:
        return ""
    position_m = recording.position_m
    moved_m = float(np.nanmax(position_m) - np.nanmin(position_m))
    if moved_m < _MOVED * nameplate.actuator.travel_m:
        return ""
    if bench_pa is not None:
        share = position_m / nameplate.actuator.travel_m
        assert recording.pressure_pa is not None
        off = recording.pressure_pa - (bench_pa[0] + share * (bench_pa[1] - bench_pa[0]))
        # friction holds the stem above and below its spring's line: the middle of the loop lies on it
        low_off, high_off = (float(end) for end in np.nanpercentile(off, (2.0, 98.0)))
        middle_pa = 0.5 * (low_off + high_off)
        fits = _LOW_PA < middle_pa < _HIGH_PA and middle_pa > _OFF * range_pa
        if not fits:
            return ""
        return say(
            "bench_set_would_begin",
            "and the bench set would begin at {begins:.4g kPa} where the nameplate says {nameplate:.4g kPa}",
            begins=bench_pa[0] + middle_pa,
            nameplate=bench_pa[0],
        )
    if low_pa < full_pa:
        return ""
    return say(
        "range_of_nameplate",
        "the nameplate's range is {least:.4g in kPa} to {full:.4g kPa}, and the stem moves",
        least=least_pa,
        full=full_pa,
    )


def without_preload(analysis: Mapping[str, Any]) -> dict[str, Any]:
    """Return an analysis object without what an unknown atmosphere leaves open: preload, bench set, and that cause."""
    estimates = [
        {**one, "parameters": {**one["parameters"], "F_0": _not_given(one["parameters"]["F_0"])}}
        for one in analysis["estimates"]
    ]
    signature = dict(analysis["signature"])
    if signature.get("bench_set_pa") is not None:
        signature["bench_set_pa"] = None
        signature["notes"] = {**(signature.get("notes") or {}), "bench_set_pa": REASON}
    return {**analysis, "estimates": estimates, "signature": signature}


def without_preload_cause(discrepancy: Mapping[str, Any]) -> dict[str, Any]:
    """Return a diagnosis that names no preload of the spring, of which such a recording says nothing."""
    causes = discrepancy.get("causes") or []
    left = [one for one in causes if one["cause"] != _PRELOAD]
    if len(left) == len(causes):
        return dict(discrepancy)
    if left:
        return {**discrepancy, "causes": left}
    return {**discrepancy, "causes": left, "verdict": "not_assessed", "message": _NOT_ASSESSED}


def _not_given(parameter: Mapping[str, Any]) -> dict[str, Any]:
    return {**parameter, "value": None, "std_error": None, "ci95": None, "identifiable": False, "note": REASON}
