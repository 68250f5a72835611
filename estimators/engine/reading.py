"""What a recording shows before anything is fitted: its rows, its noise, the force, and what the stem did."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import Outcome
from estimators.engine.force_path import ForcePath, force_path
from estimators.engine.hum import without_hum
from estimators.engine.rows import runs_between_gaps
from estimators.engine.segmentation import Segmentation, segment
from estimators.samples import Samples, channel_noise, prepare
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

_LEAST_NOISE: Final = 1.0e-5  # of the position's range: what the model itself leaves
_QUIETEST: Final = 0.1  # of the rows
_QUIETER: Final = 0.5  # than the usual ones: of white noise both are alike
_MOVED_SIGMAS: Final = 11.0  # chance makes a range of 9 of a stem at rest in 60,000 rows
_CHANGED_SIGMAS: Final = 11.0
_EVEN: Final = 1.0e-3
_PASSES: Final = 3  # of the rough spring rate and the segmentation that it leads to


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Complete rows, the force at them and the segmentation; ``spring_n_per_m`` is rough, 0 for a drive without one."""

    samples: Samples
    path: ForcePath
    segmentation: Segmentation
    spring_n_per_m: float
    noise_m: float
    travel_m: float

    @property
    def time_s(self) -> FloatArray:
        """Times of the rows, s."""
        return self.samples.time_s

    @property
    def is_even(self) -> bool:
        """Whether the rows of each run are as far apart as the clock of one device makes them."""
        step_s = np.diff(self.time_s)[self.samples.run_first[1:] == self.samples.run_first[:-1]]
        numbers = np.round(step_s / self.samples.period_s)
        return bool(np.abs(step_s - numbers * self.samples.period_s).max(initial=0.0) < _EVEN * self.samples.period_s)

    @property
    def position_m(self) -> FloatArray:
        """Positions of the rows, m."""
        return self.samples.position_m

    @property
    def least_noise_m(self) -> float:
        """The least that the position's white noise can be, m: a converter's rounding, or a computation's."""
        step_m = self.samples.position_step_m
        return max(step_m / math.sqrt(12.0), _LEAST_NOISE * float(np.ptp(self.position_m)))


def read(recording: Recording, nameplate: Nameplate) -> Reading | Outcome:
    """Return what the recording shows, or the outcome that says why it shows nothing."""
    samples = prepare(recording, nameplate)
    if isinstance(samples, Outcome):
        return samples
    rows = np.searchsorted(recording.time_s, samples.time_s)
    run_first, run_last = runs_between_gaps(samples.time_s)
    position_m = without_hum(samples.time_s, samples.position_m)
    samples = replace(samples, run_first=run_first, run_last=run_last, position_m=position_m)
    has_spring = nameplate.actuator.action is Action.SPRING
    noise_m = max(_position_noise(samples), 1.0e-7 * float(np.ptp(samples.position_m)))
    if not float(np.ptp(samples.position_m)) > _MOVED_SIGMAS * noise_m:
        return Outcome.NEVER_MOVED
    if not float(np.ptp(samples.force_n)) > _CHANGED_SIGMAS * samples.force_noise_n:
        return Outcome.NO_FORCE_CHANGE
    spring = _rough_spring(samples, samples.force_n, np.sign(np.gradient(samples.force_n))) if has_spring else 0.0
    path = force_path(recording, nameplate, rows, spring_n_per_m=abs(spring), noise_m=noise_m)
    segmentation: Segmentation | None = None
    for _ in range(_PASSES):
        segmentation = segment(
            samples.time_s,
            samples.position_m,
            path.force_n,
            samples.run_last,
            noise_m=noise_m,
            spring_n_per_m=spring,
            is_commanded=samples.is_commanded,
        )
        if not segmentation.moves:
            return Outcome.NEVER_MOVED
        if not has_spring:
            break
        sense = np.zeros(samples.count)
        for move in segmentation.moves:
            sense[move.first : move.last + 1] = move.direction
        better = _rough_spring(samples, path.force_n, sense)
        if better <= 0.0 or abs(better - spring) < 0.05 * spring:
            break
        spring = better
    assert segmentation is not None
    if has_spring and spring <= 0.0:
        return Outcome.UNPHYSICAL
    return Reading(samples, path, segmentation, spring, noise_m, nameplate.actuator.travel_m)


def _position_noise(samples: Samples) -> float:
    """White noise of the position, m: of a stem that slips every few rows, most of which show that, the quietest's."""
    usual_m = samples.position_noise_m
    quiet_m = channel_noise(samples.time_s, samples.position_m, samples.run_first, _QUIETEST)
    return max(quiet_m, samples.position_step_m / math.sqrt(12.0)) if quiet_m < _QUIETER * usual_m else usual_m


def _rough_spring(samples: Samples, force_n: FloatArray, sense: FloatArray) -> float:
    """Spring rate by least squares of the force on position and direction in the rows in which it has one, N/m."""
    moving = sense != 0.0
    if int(moving.sum()) < 10:
        return 0.0
    design = np.column_stack([np.ones(int(moving.sum())), samples.position_m[moving], sense[moving]])
    found, *_ = np.linalg.lstsq(design, force_n[moving], rcond=None)
    return float(found[1])
