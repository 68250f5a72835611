"""The samples that an estimator works on: complete rows, in runs across which nothing is differenced."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import FEWEST_SAMPLES, FEWEST_TOGETHER, Outcome
from valve.errors import RecordingError
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Own choice: a longest step within a run (one missed slot is a gap).
_LONGEST_STEP_PERIODS: Final = 1.75
_LARGEST_FORCE_STEP: Final = 0.04  # own choice, of the force's range, from row to row: with more nothing is followed
_LARGEST_POSITION_M: Final = 1.0e3
_LARGEST_FORCE_N: Final = 1.0e9
_ENOUGH_DIFFERENCES: Final = 20_000  # for a median to within 1 %
_ROUNDING: Final = 1.0e-9  # of the range: below it a channel is computed and not measured
_MOST_STEPS: Final = 1.0e7  # from the first value to the furthest: a grid finer than any converter's is rounding
_WIDER: Final = 3.0
_OFF_GRID: Final = 0.08  # of a step: 24 bits of single precision on the steps of a 16-bit converter leave 0.004


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Complete rows of a recording: ``time_s``, ``position_m`` and ``force_n``, shape (n,).

    ``run_first`` and ``run_last``, shape (n,), are the first and last row of each row's run without a gap.
    """

    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    run_first: IntArray
    run_last: IntArray
    period_s: float
    position_noise_m: float
    force_noise_n: float
    position_step_m: float = 0.0  # of the sensor's grid; 0 where there is none that is coarser than rounding
    is_commanded: bool = False  # the command stands in for the force, which comes later

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.time_s.size)


def prepare(recording: Recording, nameplate: Nameplate) -> Samples | Outcome:
    """Return the recording's complete samples, or the outcome that says why there are none to work on."""
    is_forced = recording.force_n is not None or recording.pressure_pa is None
    if nameplate.actuator.action is Action.DOUBLE and not is_forced and not recording.takes_both_signs:
        # the other chamber's pressure is not known, and no spring takes its place
        return Outcome.ONE_CHAMBER
    try:
        force_n = recording.actuator_force_n(nameplate)
    except RecordingError:
        return Outcome.NO_DIAPHRAGM_AREA
    present = np.isfinite(recording.position_m) & np.isfinite(force_n)
    rows = np.flatnonzero(present)
    if rows.size < FEWEST_SAMPLES:
        return Outcome.TOO_FEW_SAMPLES
    time_s, position_m, force_n = recording.time_s[rows], recording.position_m[rows], force_n[rows]
    if max(abs(float(position_m.max())), abs(float(position_m.min()))) > _LARGEST_POSITION_M:
        return Outcome.UNPHYSICAL
    if max(abs(float(force_n.max())), abs(float(force_n.min()))) > _LARGEST_FORCE_N:
        return Outcome.UNPHYSICAL
    step_s = np.diff(time_s)
    period_s = float(np.median(step_s))
    broken = (np.diff(rows) > 1) | (step_s > _LONGEST_STEP_PERIODS * period_s)
    firsts = np.concatenate([[0], np.flatnonzero(broken) + 1])
    lengths = np.diff(np.concatenate([firsts, [rows.size]]))
    if period_s <= 0.0 or int(lengths.max()) < FEWEST_TOGETHER:
        return Outcome.TOO_FEW_SAMPLES
    # of ramps at several rates the slow ones tell; of a test in steps most rows change nothing; a measured force is
    # what a controller answers to the position's noise, at any rate
    if recording.force_n is None and float(np.quantile(np.abs(np.diff(force_n)), 0.25)) > _LARGEST_FORCE_STEP * float(
        np.ptp(force_n)
    ):
        return Outcome.RATE_TOO_LOW
    run_first = np.repeat(firsts, lengths)
    run_last = run_first + np.repeat(lengths, lengths) - 1
    return Samples(
        time_s=time_s,
        position_m=position_m,
        force_n=force_n,
        run_first=run_first,
        run_last=run_last,
        period_s=period_s,
        position_noise_m=position_noise(time_s, position_m, run_first),
        force_noise_n=channel_noise(time_s, force_n, run_first),
        position_step_m=resolution(position_m),
        is_commanded=recording.force_n is None and recording.pressure_pa is None,
    )


def position_noise(time_s: FloatArray, position_m: FloatArray, run_first: IntArray) -> float:
    """Noise of a position, one standard deviation, m: at least its resolution's; 0 where it is rounding.

    Arrays: shape (n,).
    """
    noise_m = max(channel_noise(time_s, position_m, run_first), resolution(position_m) / float(np.sqrt(12.0)))
    return noise_m if noise_m > _ROUNDING * float(np.ptp(position_m)) else 0.0


def channel_noise(time_s: FloatArray, channel: FloatArray, run_first: IntArray, share: float = 0.5) -> float:
    """White noise of a channel, one standard deviation, by its 4th differences; shape (n,), in its unit.

    By the size that this share of the 4th divided differences stays below, each scaled to unit variance; they vanish
    for a smooth motion also where the samples are uneven.
    """
    inside = np.flatnonzero(run_first[4:] == run_first[:-4])
    if inside.size < 8:
        return 0.0
    step_s = np.diff(time_s)
    if float(np.ptp(step_s)) <= 1.0e-3 * float(step_s.min()):
        fourth = np.abs(np.diff(channel, 4)[inside[:: 1 + inside.size // _ENOUGH_DIFFERENCES]]) / np.sqrt(70.0)
    else:
        fourth = _fourth_divided(time_s, channel)[inside]
    return float(np.quantile(fourth, share)) / NormalDist().inv_cdf(0.5 + 0.5 * share)


def _fourth_divided(time_s: FloatArray, channel: FloatArray) -> FloatArray:
    """Absolute 4th divided differences, each divided by the norm of its coefficients; shape (n - 4,)."""
    count = time_s.size - 4
    total, norm = np.zeros(count), np.zeros(count)
    unit_s = float(np.median(np.diff(time_s)))
    for own in range(5):
        weight = np.ones(count)
        for other in range(5):
            if other != own:
                weight /= (time_s[own : own + count] - time_s[other : other + count]) / unit_s
        total += weight * channel[own : own + count]
        norm += weight * weight
    return np.asarray(np.abs(total) / np.sqrt(norm))


def resolution(channel: FloatArray) -> float:
    """Step of the grid that a channel, shape (n,), in any unit, lies on; 0 where it lies on none coarser than rounding.

    The smallest change from row to row, fitted to more and more of the channel: single precision rounds each value.
    A stem at rest on one step hides the resolution from the differences: its noise is then step / sqrt(12).
    """
    gaps = np.abs(np.diff(channel))
    gaps = gaps[gaps > 1.0e-12 * float(np.abs(channel).max())]
    if gaps.size == 0:
        return 0.0
    step = float(gaps.min())
    away = np.sort(np.abs(channel[:: max(1, channel.size // 2000)] - channel[0]))
    if float(away[-1]) > _MOST_STEPS * step:
        return 0.0
    reach = step
    while reach < float(away[-1]):
        reach *= _WIDER
        part = away[: int(np.searchsorted(away, reach, side="right"))]
        numbers = np.rint(part / step)
        if float(np.abs(part / step - numbers).max()) > _OFF_GRID:
            return 0.0
        if numbers.any():
            step = float(part @ numbers / (numbers @ numbers))
    return step if float(np.abs(away / step - np.rint(away / step)).max()) < _OFF_GRID else 0.0
