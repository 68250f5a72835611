"""A force that moves in steps: what the rests between them tell of the spring, the preload and the friction.

A stem that slides after a step and does not swing comes to rest where the force no longer drives it:
s (U - k x - F_0) = F_c - o E, with E the force that drove it beyond F_c and o the share by which it overshoots. So
the rests take the place of the blocks of driven motion in the balance. Between which forces a stem broke away is
what ``brackets`` makes of the same steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from estimators.base import NORMAL_95
from estimators.engine.balance import Balance, Blocks, balance
from estimators.engine.force_path import Source
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.segmentation import extremes, moving_mean
from estimators.steps.answer import StepAnswer, answer_to
from estimators.steps.inputs import InputStep, find_steps
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

_FEWEST: Final = 3  # steps of a stepped recording
_FEWEST_RESTS: Final = 5  # after slides, both directions among them
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
_SWUNG_PERCENT: Final = 5.0  # of a slide: a stem that swung back rests anywhere between -F_c and F_c
_OVERSHOOTS: Final = (3.0e-3, 0.15)  # of a slide, where its shape says none, and where it is not seen
_COLOURED_S: Final = 0.1  # rows so near to each other share their noise
_BEYOND: Final = 5.0  # errors by which a rest on a stop is off the balance
_HELD: Final = 1.5  # times what usually moves a stem on
_LIMIT_M_PER_S: Final = 2.0e-4  # a usual limit velocity
_MOST_TIMES: Final = 19.0  # 97.5 % of valves have one of at most so many times as much, e^(1.96 * 1.5)
_LONGER: Final = 3.0  # of a slide that is cut by half, its lag over its tail
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
        first, later = one.times
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
    if reading.path.source is Source.COMMAND_ALONE:
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


def balance_of_rests(reading: Reading, found: Stepped) -> tuple[Balance, tuple[Held, ...]] | None:
    """Return the balance of the rests after slides, and the slides onto a travel stop; None with too few others.

    Rests on a stop are left out: there the stem is held by more than friction.
    """
    slides = [one for one in found.held if _rests_on_friction(one)]
    if not slides:
        return None
    band_m = 2.0 * reading.segmentation.band_m
    ends_m = [one.answer.end_m for one in slides]
    outer = [one for one in slides if not min(ends_m) + band_m < one.answer.end_m < max(ends_m) - band_m]
    held = _held_outwards(found)
    on_stop = [one for one in outer if one in held]
    inner = _balance(reading, found, [one for one in slides if one not in outer])
    if inner is not None:
        on_stop += [one for one in outer if one not in on_stop and _is_held(one, inner)]
    rests = _balance(reading, found, [one for one in slides if one not in on_stop]) or inner
    return None if rests is None else (rests, tuple(on_stop))


def _held_outwards(found: Stepped) -> list[Held]:
    """Slides after which more of the same direction moved nothing than moved the stem on after other slides."""
    rested: Held | None = None
    moved_n: list[float] = []
    unmoved_n: list[tuple[Held, float]] = []
    for one in found.held:
        if rested is not None:
            onward_n = rested.sign * (one.after_n - rested.after_n)
            if not one.answer.moved:
                unmoved_n.append((rested, onward_n))
            elif one.sign == rested.sign:
                moved_n.append(onward_n)
        if one.answer.moved:
            rested = one
    usual_n = float(np.median(moved_n)) if moved_n else math.inf
    return [one for one, onward_n in unmoved_n if onward_n > _HELD * usual_n]


def _rests_on_friction(held: Held) -> bool:
    answer = held.answer
    swung = answer.overshoot_percent is not None and answer.overshoot_percent > _SWUNG_PERCENT
    return answer.moved and answer.settled and held.sign * (held.after_n - held.before_n) > 0.0 and not swung


def _is_held(held: Held, inner: Balance) -> bool:
    """Whether a stem at rest is driven on by more than the friction that the other rests show."""
    slopes = np.array([held.answer.end_m, 1.0, held.sign, 0.0])
    left_n = held.sign * (held.after_n - float(slopes @ inner.values))
    rough = inner.roughness
    own_n = math.sqrt(rough.common_n**2 + rough.own_n**2 + rough.wander_n**2 + rough.error_n**2)
    error_n = math.sqrt(max(float(slopes @ inner.joint @ slopes), 0.0) + own_n**2)
    return left_n > _BEYOND * error_n + 0.1 * inner.known("F_c").value


def _balance(reading: Reading, found: Stepped, slides: list[Held]) -> Balance | None:
    """The balance with the rests of these slides for blocks; its fourth value is the share that they overshoot."""
    if len(slides) < _FEWEST_RESTS:
        return None
    time_s, rows = reading.time_s, []
    for one in slides:
        step = one.answer.step
        length_s = 0.25 * float(time_s[step.last] - time_s[step.row])
        middle_s = 0.5 * float(time_s[step.row] + time_s[step.last])
        count = max(1.0, min(0.25 * (step.last - step.row), length_s / _COLOURED_S))
        rows.append((middle_s, one.answer.end_m, one.after_n, one.sign, count, length_s))
    time, travel, force, sign, count, length = np.ascontiguousarray(np.array(rows).T)
    started_m = np.array([one.answer.start_m for one in slides])
    # what drove each slide is not known before the balance: without any overshoot, then with what that one says
    beyond_n, rests, widths = reading.spring_n_per_m * np.abs(travel - started_m), None, (_OVERSHOOTS[0],) * 2
    if not found.damped:
        widths = _OVERSHOOTS
    for width in widths:
        rests = balance(
            Blocks(time, travel, -sign * beyond_n, force, sign, count, length),
            noise_m=reading.noise_m,
            travel_m=reading.travel_m,
            has_spring=True,
            force_noise_n=reading.samples.force_noise_n / math.sqrt(float(count.min())),
            lag=Known(0.0, width),
            fewest_blocks=_FEWEST_RESTS,
        )
        if rests is None or min(rests.known("k").value, rests.known("F_c").value) <= 0.0:
            return None
        spring, preload, coulomb, _ = rests.values
        beyond_n = np.maximum(sign * (force - spring * started_m - preload) - coulomb, 0.0)
    return None if rests is None else _widened(rests, found)


def _widened(rests: Balance, found: Stepped) -> Balance:
    """Return the balance with what a few rests leave open: the friction between them, and where a stem stops at DV.

    It stops short of where the force would lead, by what it is late at that speed.
    """
    values, joint = rests.values.copy(), rests.joint.copy()
    coulomb, preload = rests.symbols.index("F_c"), rests.symbols.index("F_0")
    usual_n = found.short_n(rests.known("k").value)
    # a slide that is cut short has a shorter tail than its lag
    most_n = min(_MOST_TIMES * _LONGER * usual_n, 0.9 * values[coulomb])
    short_n = min(usual_n, 0.5 * most_n)
    values[coulomb] -= short_n
    joint[coulomb, coulomb] += ((most_n - short_n) / NORMAL_95) ** 2 + found.swing_n**2
    joint[preload, preload] += found.swing_n**2
    rough, direction = rests.roughness, rests.blocks.direction
    between = 0.25 * sum(1.0 / int((direction == way).sum()) for way in (1.0, -1.0))
    for at in (coulomb, preload):
        joint[at, at] += between * (rough.common_n**2 + rough.own_n**2)
    # as many rests for three values: Student's t
    freedom = max(1, rests.blocks.count - 3)
    joint *= (float(student.ppf(0.975, freedom)) / NORMAL_95) ** 2
    return replace(rests, symbols=("k", "F_0", "F_c", "overshoot"), values=values, joint=joint)
