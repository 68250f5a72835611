"""What a test that still runs shows so far: a quick estimate by the classic methods, and the breakaways one by one."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import Any, Final

import numpy as np

from estimators.base import Estimate, Outcome, ParameterEstimate, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.motion.static_friction import breakaway_forces
from valve.nameplate import Nameplate
from valve.recording import Recording

SHOWN: Final = ("k", "F_c", "F_s", "F_0")
_ALIKE: Final = 0.7  # of F_s, the median of the breakaways; own choice


def estimate_so_far(recording: Recording, nameplate: Nameplate) -> dict[str, Any]:
    """Return the quick estimate of the rows so far, each value with its 95 % interval or null.

    By both classic methods: the mean of their values, and an interval that holds both of theirs (benchmark until).
    ``status`` is the worse of theirs. ``family`` is what the next breakaway is held against
    (``service.runs.out_of_family``), null where that is open.
    """
    motion = read_motion(recording, nameplate)
    found = [one.estimate_motion(motion) for one in (RegressionEstimator(), GarciaEstimator())]
    poor = next((one.status for one in found if one.status is not Status.OK), Status.OK)
    return {
        "time_s": float(recording.time_s[-1]),
        "status": str(poor),
        "breakaways": min(int(one.diagnostics.get("breakaways", 0)) for one in found),
        "parameters": {symbol: _shown([one.parameters[symbol] for one in found]) for symbol in SHOWN},
        "family": None if isinstance(motion, Outcome) else _family(motion, found[0], nameplate),
    }


def _shown(entries: Sequence[ParameterEstimate]) -> dict[str, Any] | None:
    values = [one.value for one in entries if one.value is not None]
    ends = [one.ci95 for one in entries if one.ci95 is not None]
    if len(values) < len(entries) or len(ends) < len(entries):
        return None
    return {"value": fmean(values), "ci95": [min(low for low, _ in ends), max(high for _, high in ends)]}


def _family(motion: RecordedMotion, estimate: Estimate, nameplate: Nameplate) -> dict[str, Any] | None:
    """k, F_0 and the friction of the last breakaway, N, and where the stem may be for the next to be judged, m."""
    spring, preload = estimate.value("k"), estimate.value("F_0")
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if spring is None or preload is None or area_m2 is None or motion.command_only:
        return None
    forces = breakaway_forces(motion.samples, motion.phases, spring, preload)
    static = estimate.value("F_s")
    if forces is None or forces.friction_n.size < 2 or static is None:
        return None
    last_n = float(forces.friction_n[np.argmax(forces.time_s)])
    if not (_ALIKE * static < forces.value < static / _ALIKE and last_n > 0.0):
        return None  # what is seen one by one is not what the estimate rests on
    stops = motion.stops
    known = () if stops is None else (stops.low_m, stops.high_m)
    return {
        "area_m2": area_m2,
        "spring_n_per_m": spring,
        "preload_n": preload,
        "last_n": last_n,
        "usual_n": forces.value,
        "breakaways": int(forces.friction_n.size),
        "stops_m": [float(end) for end in known if np.isfinite(end)],
    }
