"""A force that moves in steps: between which levels, how the stem answered, and how late it does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.reading import Reading
from estimators.engine.segmentation import extremes, moving_mean
from estimators.steps.answer import StepAnswer, answer_to
from estimators.steps.inputs import InputStep, find_steps
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

_FEWEST: Final = 3  # steps of a stepped recording
_MOSTLY: Final = 0.5  # of the way of the force goes by steps
_LEAST_TURN: Final = 0.01  # of the force's range
_SMOOTHED_S: Final = 0.05
_COARSE_S: Final = 0.02  # rows are averaged over this where a noisy pressure shows no steps
_LEAP_S: Final = 0.03  # so quick a rise of the pressure may be the gauge's filter alone
_LEAP_ROWS: Final = 2.5
_LEAP_SHARE: Final = 0.3  # of F_c, from row to row
_FINE: Final = 0.04  # of the force's range
_SEEN_BANDS: Final = 0.5  # of the segmentation's band: a smaller slide is noise
_LARGE: Final = 0.25  # of the largest slide: what is timed
_DAMPED: Final = 1.5  # T86 over T63: 2.0 of a lag, 1.6 of a critically damped stem, 1.5 of one that overshoots by 1.5 %
_RESOLVED_ROWS: Final = 4.0  # that T63 takes, for its shape to be seen
_COLOURED_S: Final = 0.1  # rows so near to each other share their noise
_LIMIT_M_PER_S: Final = 2.0e-4  # a usual limit velocity
_HUNTING: Final = 1.0e-3  # of the force's range: what an I/P may swing by where the pressure was not measured


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """One step, the stem's answer, and the force before and after it, N, by the ends of the holds."""

    answer: StepAnswer
    before_n: float
    after_n: float

    @property
    def sign(self) -> float:
        """Direction of the slide."""
        return math.copysign(1.0, self.answer.change_m)


@dataclass(frozen=True, slots=True, eq=False)
class Stepped:
    """The steps of a recording; ``rise_s`` is how long the force takes from a tenth to 63 % of a step.

    ``lateness_s`` is how long the stem takes to 63 % of its slide, from the step on, ``tail_s`` from there to 86 %.
    ``damped``: its slides show that it does not swing. ``swing_n``: an I/P that hunts moves the force by so much.
    """

    held: tuple[Held, ...]
    rise_s: float
    lateness_s: float
    tail_s: float
    damped: bool
    swing_n: float
    period_s: float

    @property
    def directions(self) -> set[float]:
        """Directions in which the stem moved."""
        return {one.sign for one in self.held if one.answer.moved}

    @property
    def is_fine(self) -> bool:
        """Whether the steps are those of an output's resolution, on a ramp."""
        ends_n = [end for one in self.held for end in (one.before_n, one.after_n)]
        usual_n = float(np.median([abs(one.after_n - one.before_n) for one in self.held]))
        return usual_n < _FINE * (max(ends_n) - min(ends_n))

    def short_n(self, spring_n_per_m: float) -> float:
        """By how much the force at a rest usually is beyond F_c, N, where the stem stopped at its limit velocity."""
        return spring_n_per_m * _LIMIT_M_PER_S * self.tail_s

    def leaps(self, coulomb_n: float) -> bool:
        """Whether the rows do not show at what force a stem with this friction, N, breaks away."""
        if self.rise_s <= max(_LEAP_ROWS * self.period_s, _LEAP_S):
            return True
        usual_n = float(np.median([abs(one.after_n - one.before_n) for one in self.held]))
        return usual_n * self.period_s / self.rise_s > _LEAP_SHARE * coulomb_n


def stepped(reading: Reading, recording: Recording) -> Stepped | None:
    """Return the steps of a recording, None where its force mostly moves otherwise.

    They are those of its command where it has one; the forces between them are what was measured.
    """
    samples = reading.samples
    if reading.spring_n_per_m <= 0.0:
        return None
    steps, level = _steps(reading, recording)
    if len(steps) < _FEWEST or sum(abs(one.size) for one in steps) < _MOSTLY * _way(reading, level):
        return None
    floor_m = _SEEN_BANDS * reading.segmentation.band_m
    held = []
    for one in steps:
        answer = answer_to(one, samples.time_s, samples.position_m, reading.noise_m, floor_m)
        before = samples.force_n[one.row - (one.row - one.first) // 4 : one.row + 1]
        after = samples.force_n[one.last - (one.last - one.row) // 4 : one.last + 1]
        held.append(Held(answer, float(before.mean()), float(after.mean())))
    moved = [one.answer for one in held if one.answer.moved]
    if not moved:
        return None
    rise_s = float(np.median([_rise_s(reading, one) for one in held if one.answer.moved]))
    return Stepped(tuple(held), rise_s, *_slides(moved, samples.period_s), _swing_n(reading, steps), samples.period_s)


def _slides(moved: list[StepAnswer], period_s: float) -> tuple[float, float, bool]:
    """T63 of the large slides and T86 less T63, s, and whether they do not swing."""
    least_m = _LARGE * max(abs(one.change_m) for one in moved)
    late_s, pure_s, tails_s, shapes, swung = [], [], [], [], False
    for one in moved:
        first, later = one.times[:2]
        if abs(one.change_m) < least_m or first is None or later is None:
            continue
        dead_s = 0.0 if one.dead_time is None else one.dead_time.value_s
        late_s.append(first.value_s)
        tails_s.append(later.value_s - first.value_s)
        pure_s.append(max(first.value_s - dead_s, 0.1 * period_s))
        shapes.append((later.value_s - dead_s) / pure_s[-1])
        swung = swung or bool(one.overshoot_percent)
    if not late_s:
        return 0.0, 0.0, False
    seen = float(np.median(pure_s)) > _RESOLVED_ROWS * period_s
    damped = seen and not swung and float(np.median(shapes)) > _DAMPED
    return float(np.median(late_s)), float(np.median(tails_s)), damped


def _steps(reading: Reading, recording: Recording) -> tuple[list[InputStep], FloatArray]:
    """Steps of the command, or of the force, and that channel at the rows, shape (n,)."""
    samples = reading.samples
    if recording.command_pa is not None:
        rows = np.searchsorted(recording.time_s, samples.time_s)
        command = recording.command_pa[rows]
        if np.isfinite(command).all():
            steps = find_steps(samples.time_s, command, samples.run_first)
            if len(steps) >= _FEWEST:
                return steps, command
    steps = find_steps(samples.time_s, samples.force_n, samples.run_first)
    size = round(_COARSE_S / samples.period_s)
    if len(steps) >= _FEWEST or size < 2:
        return steps, samples.force_n
    count = samples.count // size
    mean_n = samples.force_n[: count * size].reshape(count, size).mean(axis=1)
    thin = np.arange(count) * size
    coarse = find_steps(samples.time_s[thin], mean_n, samples.run_first[thin] // size)
    steps = [
        replace(one, first=one.first * size, row=one.row * size + size - 1, last=one.last * size + size - 1)
        for one in coarse
    ]
    return steps, samples.force_n


def _swing_n(reading: Reading, steps: list[InputStep]) -> float:
    """Half of the usual range of the smoothed force in the last quarter of a hold, N."""
    force_n, period_s = reading.samples.force_n, reading.samples.period_s
    if reading.samples.is_commanded:
        return _HUNTING * float(np.ptp(force_n))
    smooth = moving_mean(force_n, 2 * (max(1, round(_COLOURED_S / period_s)) // 2) + 1, reading.samples.run_last)
    margin = round(_COLOURED_S / period_s)
    ranges = []
    for one in steps:
        part = smooth[one.last - (one.last - one.row) // 4 : max(one.last - margin, one.row) + 1]
        ranges.append(float(np.ptp(part)) if part.size else 0.0)
    return 0.5 * float(np.median(ranges))


def _way(reading: Reading, level: FloatArray) -> float:
    """How far an input goes in all, there and back counted both, in its unit; shape (n,)."""
    width = 2 * (max(1, round(_SMOOTHED_S / reading.samples.period_s)) // 2) + 1
    smooth = moving_mean(level, width, reading.samples.run_last)
    return float(np.abs(np.diff(smooth[extremes(smooth, _LEAST_TURN * float(np.ptp(smooth)))])).sum())


def _rise_s(reading: Reading, held: Held) -> float:
    """How long the force takes from a tenth of a step to 63 % of it, s."""
    step, samples = held.answer.step, reading.samples
    share = (samples.force_n[step.row : step.last + 1] - held.before_n) / (held.after_n - held.before_n)
    first, later = (int(np.argmax(share >= part)) for part in (0.1, 0.632))
    return float(samples.time_s[step.row + later] - samples.time_s[step.row + max(first - 1, 0)])
