"""Which test would tell two explanations apart: one is simulated on it, and the other fitted to its motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import simulated
from discrepancy.observed import Observed, Segment
from discrepancy.significance import NEAR, noise_factor
from discrepancy.unknowns import of_a_segment
from valve.errors import MotionError, ParameterError
from valve.waveform import Waveform

_BLOCK_S: Final = 0.01  # what a planned test is simulated in
_TIMING_SHARE: Final = 0.2  # of the sample period, as for recorded blocks (discrepancy.observed)
_GLANCE_STEPS: Final = 2
_STEPS: Final = 6
_LOOKED_AT: Final = 2  # sequences for which the rival is fitted to the end, and the other way round
# Half more than two causes are told apart by: the real valve is not the model.
ENOUGH: Final = 1.5 * NEAR
_PLENTY: Final = 1.0e3  # from here on the shorter test is the better one
_EMPTY: Final = np.empty(0)


@dataclass(frozen=True, slots=True)
class Planned:
    """A sequence that the valve's limits allow, with the overrides that make this waveform."""

    name: str
    overrides: Mapping[str, Any]
    waveform: Waveform


@dataclass(frozen=True, slots=True)
class SeparatingTest:
    """The test to run: ``discrimination`` is the least expected fall of the cost, in units of what noise makes."""

    sequence: str
    overrides: Mapping[str, Any]
    duration_s: float
    separates: tuple[str, ...]
    discrimination: float

    @property
    def sentence(self) -> str:
        """What to do, for a person."""
        one, *others = (name.replace("_", " ") for name in self.separates)
        return (
            f"run the sequence {self.sequence} ({self.duration_s:.0f} s): simulated on it, {one} and "
            f"{' and '.join(others)} differ by {math.sqrt(self.discrimination):.0f} standard deviations of the noise, "
            f"and {math.sqrt(NEAR):.0f} tell them apart."
        )

    def to_json(self) -> dict[str, Any]:
        """Return the test as the analysis object's ``separating_test``."""
        return {
            "sequence": self.sequence,
            "overrides": dict(self.overrides),
            "duration_s": self.duration_s,
            "separates": list(self.separates),
            "discrimination": self.discrimination,
            "sentence": self.sentence,
        }


def separating_test(
    best: tuple[str, Fit], rivals: Sequence[tuple[str, Fit]], planned: Sequence[Planned]
) -> SeparatingTest | None:
    """Return the sequence with the largest expected discrimination of the best explanation from its rivals.

    None where none of ``planned`` tells them apart, or nothing is to be told apart.
    """
    if best[1].model.observed.nameplate.actuator.diaphragm_area_m2 is None or not rivals:
        return None
    glanced: list[tuple[float, float, int, Planned]] = []
    for one in planned:
        least = min(_discrimination(best[1], fit, one.waveform, _GLANCE_STEPS) for _, fit in rivals)
        if least > ENOUGH:
            glanced.append((min(least, _PLENTY), -one.waveform.duration_s, len(glanced), one))
    found: list[tuple[float, float, int, Planned, float]] = []
    for rank, (_, _, _, one) in enumerate(sorted(glanced, reverse=True)[:_LOOKED_AT]):
        least = expected_discrimination(best[1], [fit for _, fit in rivals], one.waveform)
        found.append((min(least, _PLENTY), -one.waveform.duration_s, -rank, one, least))
        if least > _PLENTY:
            break
    if not found:
        return None
    *_, chosen, least = max(found)
    if least < ENOUGH:
        return None
    names = (best[0], *(name for name, _ in rivals))
    return SeparatingTest(chosen.name, dict(chosen.overrides), chosen.waveform.duration_s, names, least)


def expected_discrimination(best: Fit, rivals: Sequence[Fit], waveform: Waveform) -> float:
    """Least cost by which a test tells the best explanation from its rivals, and them from it, in units of noise's.

    Each in turn is simulated on the waveform, and the other fitted to that motion and to what was recorded.
    """
    pairs = [(best, rival) for rival in rivals] + [(rival, best) for rival in rivals]
    return min(_discrimination(true, rival, waveform, _STEPS) for true, rival in pairs)


def _discrimination(true: Fit, rival: Fit, waveform: Waveform, steps: int) -> float:
    """Cost that the rival keeps above the true one on what was recorded and on the new test; 0 where it cannot move."""
    observed = true.model.observed
    area_m2 = observed.nameplate.actuator.diaphragm_area_m2
    segment = None if area_m2 is None else _planned_segment(true, waveform, area_m2)
    if segment is None:
        return 0.0
    both = observed.of((*observed.segments, segment))
    fit = start_fit(replace(rival.model, observed=both, thin=None), rival.point)
    if not fit.is_followed:
        return 0.0
    fit = descend(fit, most_steps=steps)
    own = start_fit(replace(true.model, observed=observed.of(observed.segments), thin=None), true.point)
    return max(fit.cost - own.cost, 0.0) / noise_factor(true)


def _planned_segment(true: Fit, waveform: Waveform, area_m2: float) -> Segment | None:
    """Return the true valve's motion on a waveform, without noise, weighted as it would be recorded."""
    observed = true.model.observed
    time_s = np.arange(0.0, waveform.duration_s, _BLOCK_S)
    corner_n = area_m2 * waveform.pressure_pa
    values = {name: value for name, value in true.values.items() if not of_a_segment(name)}
    lowest_m, highest_m = float(observed.position_m.min()), float(observed.position_m.max())
    start_m = min(max((float(corner_n[0]) - values["F_0"]) / values["k"], lowest_m), highest_m)
    empty = Segment(
        time_s=time_s,
        position_m=np.zeros(time_s.size),
        weight=np.ones(time_s.size),
        rows=np.ones(time_s.size),
        corner_s=np.array(waveform.time_s),
        corner_n=corner_n,
        rest_time_s=_EMPTY,
        rest_m=_EMPTY,
        rest_sense=_EMPTY,
        start_m=start_m,
        start_error_m=observed.noise_m,
        start_velocity=0.0,
        elapsed_s=0.0,
    )
    try:
        position_m = simulated(_alone(observed, empty), true.model.valve(true.point), values)
    except (MotionError, ParameterError):
        return None
    if not np.isfinite(position_m).all():
        return None
    period_s = observed.motions[0].samples.period_s
    rows = max(_BLOCK_S / period_s, 1.0)
    speed = np.abs(np.gradient(position_m, _BLOCK_S))
    variance = (observed.noise_m**2 + (speed * _TIMING_SHARE * period_s) ** 2) / rows
    share = min(_BLOCK_S / period_s, 1.0)  # fewer samples than blocks: each block is only a part of one
    return replace(empty, position_m=position_m, weight=np.sqrt(share / variance), rows=np.full(time_s.size, rows))


def _alone(observed: Observed, segment: Segment) -> Observed:
    return observed.of([segment])
