"""A periodic force on the stem: its motion keeps a clock of its own, whatever the ramps do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.position_lag import lag_of
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from discrepancy.rough.simulation import parameters_of, with_effects
from estimators.base import NORMAL_95
from estimators.engine.reading import Reading
from valve.effects.vibration import PeriodicForce
from valve.errors import ValveError
from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.messages import say
from valve.parameters import ValveParameters
from valve.stem import StemState

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_SLOWEST_HZ: Final = 2.5  # what is slower is the test itself
_QUICKEST_HZ: Final = 45.0  # below the mains
_OF_NYQUIST: Final = 0.9
_STEP_S: Final = 5.0e-3
_AROUND_HZ: Final = 1.0  # each way: the spectrum that a line stands out of
_MIDDLES: Final = 20  # places within that width at which it is looked at
_RANK: Final = 90.0  # percent of it: a test that repeats itself is a comb of lines
_LINE: Final = 9.0  # nats over all frequencies that were looked at
_KEEPS: Final = 6.0  # nats, of the clock against strokes in any phase
_BETTER: Final = 3.5  # nats, than strokes that are alike from their beginnings on
_TRIED: Final = 41  # frequencies within one over the duration
_COARSE: Final = 5  # of their steps at first
_FEWEST_STEPS: Final = 100
_FEWEST_CYCLES: Final = 3.0
_FEWEST_STROKES: Final = 4
_LONGEST_RUN_S: Final = 240.0  # that is searched
_LONGEST_S: Final = 10.0  # that is simulated
_SHARES: Final = np.geomspace(5.0e-4, 0.1, 12)  # of the full force
_DAMPINGS: Final = (0.33, 1.0, 3.0)  # of the plain valve's
_ROUNDS: Final = 3  # of friction and phase at one force
_RESTED_S: Final = 3600.0
_HARMONICS: Final = (1.0, 2.0, 3.0)
_AS_NEAR: Final = 0.1  # of their power, beside
_TIMES: Final = 2.0  # what no force explains
_WIDE: Final = 3.0  # from the least force to the largest
_TURNED_S: Final = 0.2
_STOPS_S: Final = 0.1  # a damped stem goes on a little
_LIKE_MOTION: Final = 0.4  # of the swing in motion: that near at rest, and it is the reading that shakes
_OF_PRESSURE: Final = 0.3  # of the force's middle: so much in the gauge, and it is the pressure that shakes


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """Position (m) at even times (s), shape (n,), at its level while the stem rests, and the force there (N)."""

    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    step_s: float

    def between(self, begin_s: float, end_s: float) -> _Motion:
        """Return the part from ``begin_s`` to ``end_s``."""
        part = slice(*np.searchsorted(self.time_s, (begin_s, end_s)))
        return _Motion(self.time_s[part], self.position_m[part], self.force_n[part], self.step_s)

    def strokes(self, corners_s: FloatArray, least_s: float) -> list[_Motion]:
        """Return the parts between the force's turns, at least so long; the first stroke is no whole one."""
        inside_s = corners_s[(corners_s > self.time_s[0]) & (corners_s < self.time_s[-1])].tolist()
        ends_s = pairwise([*inside_s, float(self.time_s[-1])])
        return [self.between(begin_s, end_s) for begin_s, end_s in ends_s if end_s - begin_s >= least_s]

    def tones_m(self, frequencies_hz: FloatArray) -> ComplexArray:
        """Return the tones of these frequencies, shape (n,), m."""
        return np.array([self.tone_m(float(one)) for one in frequencies_hz])

    def tone_m(self, frequency_hz: float) -> complex:
        """How far the stem goes with this frequency in all, beside its mean motion, m."""
        steps_m = np.diff(self.position_m)
        middles_s = self.time_s[:-1] + 0.5 * self.step_s
        return complex((steps_m - steps_m.mean()) @ np.exp(-2j * np.pi * frequency_hz * middles_s))

    def swing_m(self, frequency_hz: float) -> complex:
        """Amplitude and phase of the swing with this frequency while the stem moves, m."""
        moves_s = self.step_s * int(np.count_nonzero(np.diff(self.position_m)))
        return self.tone_m(frequency_hz) / (1j * np.pi * frequency_hz * max(moves_s, self.step_s))


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """What the stem's motion keeps: a frequency, its error, and the motion of a stroke that shows it best."""

    frequency_hz: float
    error_hz: float
    motion: _Motion


@dataclass(frozen=True, slots=True)
class _Shaken:
    """A stem that was simulated: how far off its tones are, as a share of their power, and its position, m."""

    effect: PeriodicForce
    stem: ValveParameters
    off: float
    error_m: float


@dataclass(frozen=True, slots=True)
class _Force:
    """The force that is nearest, beside which friction, and from and to which force one is as near, N."""

    effect: PeriodicForce
    stem: ValveParameters
    low_n: float
    high_n: float


class Vibration(SeenCause):
    """A line in the stem's velocity whose phase goes on from stroke to stroke.

    A stem that slips again and again makes lines, too: those begin anew with each stroke. What a reading picks up is
    there while the stem rests, too.
    """

    name: ClassVar[str] = "vibration"
    action: ClassVar[str] = say(
        "look_what_shakes", "Look for what shakes at this frequency: a pump, flow past the plug, a loose bracket."
    )
    is_last: ClassVar[bool] = False

    def seen(self, view: View) -> Seen | None:
        """Return force and frequency where the motion keeps a clock that the pressure does not show."""
        clock = clock_of(view.reading)
        if clock is None or _is_readings(view, clock):
            return None
        found = _force(view, clock)
        if found is None:
            return None
        if _in_pressure_n(view.reading, clock.frequency_hz) > _OF_PRESSURE * math.sqrt(found.low_n * found.high_n):
            return None
        middle_n, half_n = 0.5 * (found.low_n + found.high_n), 0.5 * (found.high_n - found.low_n)
        fitted = {
            "force_n": Fitted(middle_n, half_n / NORMAL_95, "N"),
            "frequency_hz": Fitted(clock.frequency_hz, clock.error_hz, "Hz"),
        }
        stem = found.stem.by_symbol()
        return Seen(fitted, found.effect, {symbol: stem[symbol] for symbol in ("F_v", "F_c", "F_s")})

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        force, frequency_hz = fitted["force_n"], fitted["frequency_hz"].value
        low_n, high_n = force.ci95
        if high_n > _WIDE * low_n:
            return say(
                "stem_is_shaken_at_least",
                "A periodic force of at least {least:.2g N} shakes the stem at {frequency:.2f} Hz.",
                least=low_n,
                frequency=frequency_hz,
            )
        return say(
            "stem_is_shaken",
            "A periodic force of {force} shakes the stem at {frequency:.2f} Hz.",
            force=force.in_words("N"),
            frequency=frequency_hz,
        )


def _motion(reading: Reading) -> _Motion:
    """The longest run, its beginning if it is long, at rows or averaged over ``_STEP_S``."""
    samples = reading.samples
    first = int(np.argmax(samples.run_last - np.arange(samples.count)))
    last_s = min(float(reading.time_s[samples.run_last[first]]), float(reading.time_s[first]) + _LONGEST_RUN_S)
    run = slice(first, int(np.searchsorted(reading.time_s, last_s, side="right")))
    still_m = reading.position_m.copy()
    for rest in reading.segmentation.rests:
        still_m[rest.first : rest.last + 1] = rest.level_m
    time_s, position_m = reading.time_s[run], still_m[run]
    step_s = max(samples.period_s, _STEP_S)
    even_s = np.arange(time_s[0], time_s[-1], step_s)
    if samples.period_s < step_s:
        sums = np.concatenate([[0.0], np.cumsum(position_m)])
        begins = np.searchsorted(time_s, even_s - 0.5 * step_s)
        ends = np.maximum(np.searchsorted(time_s, even_s + 0.5 * step_s), begins + 1)
        even_m = (sums[ends] - sums[begins]) / (ends - begins)
    else:
        even_m = np.interp(even_s, time_s, position_m)
    return _Motion(even_s, even_m, np.interp(even_s, time_s, reading.path.force_n[run]), step_s)


def clock_of(reading: Reading) -> Clock | None:
    """The frequency that stands out, where strokes between the force's turns keep it; None without one."""
    motion, corners_s = _motion(reading), reading.path.corners_s
    line_hz = _line(motion)
    if line_hz is None:
        return None
    strokes = motion.strokes(corners_s, _FEWEST_CYCLES / line_hz)
    if len(strokes) < _FEWEST_STROKES:
        return None
    step_hz = 2.0 / (_TRIED * float(np.ptp(motion.time_s)))
    reach_hz = 1.0 / float(np.median([np.ptp(one.time_s) for one in strokes]))
    # motion that goes one way and the other has twice the frequency, too
    coarse_hz = np.arange(-reach_hz, reach_hz, _COARSE * step_hz)
    near_hz = np.concatenate([0.5 * line_hz + coarse_hz, line_hz + coarse_hz])
    near_hz = near_hz[near_hz >= _SLOWEST_HZ]
    begins_s = np.array([one.time_s[0] for one in strokes])
    ways = np.array([np.sign(one.force_n[-1] - one.force_n[0]) for one in strokes])

    def tones_m(frequency_hz: float) -> ComplexArray:
        return np.array([one.tone_m(frequency_hz) for one in strokes])

    middle_hz = float(max(near_hz.tolist(), key=lambda one: abs(tones_m(one).sum())))
    kept, alike, best_hz, best_m = 0.0, 0.0, middle_hz, np.zeros(len(strokes), np.complex128)
    for frequency_hz in (middle_hz + step_hz * np.arange(-(_TRIED // 2), _TRIED // 2 + 1)).tolist():
        tones = tones_m(frequency_hz)
        if abs(tones.sum()) > abs(best_m.sum()):
            best_hz, best_m = frequency_hz, tones
        kept = max(kept, _surely_alike([tones]))
        own = tones * np.exp(2j * np.pi * frequency_hz * begins_s)
        alike = max(alike, _surely_alike([own[ways > 0.0], own[ways < 0.0]]))
    if kept < _KEEPS or kept - alike < _BETTER:
        return None
    most = strokes[int(np.argmax(np.abs(best_m)))]
    begin_s = float(most.time_s[0])
    return Clock(best_hz, 0.5 * step_hz, most.between(begin_s, begin_s + _LONGEST_S))


def _line(motion: _Motion) -> float | None:
    """The frequency, Hz, that stands out of the velocity's spectrum most; None where none surely does."""
    steps_m = np.diff(motion.position_m)
    if steps_m.size < _FEWEST_STEPS:
        return None
    padded = 2 * 2 ** math.ceil(math.log2(steps_m.size))
    power = np.abs(np.fft.rfft(steps_m * np.hanning(steps_m.size), padded)) ** 2
    bin_hz = 1.0 / (padded * motion.step_s)
    around = round(_AROUND_HZ / bin_hz)
    last_hz = min(_QUICKEST_HZ, _OF_NYQUIST * 0.5 / motion.step_s)
    chosen = np.arange(math.ceil(_SLOWEST_HZ / bin_hz), math.floor(last_hz / bin_hz))
    if chosen.size == 0 or chosen[0] < around:
        return None
    middles = np.append(chosen[:: max(1, around // _MIDDLES)], chosen[-1])
    windows = sliding_window_view(power, 2 * around + 1)[np.minimum(middles, power.size - around - 1) - around]
    # of noise that is alike around it the power is distributed exponentially
    mean = np.percentile(windows, _RANK, axis=1) / -math.log1p(-_RANK / 100.0)
    over = power[chosen] / np.maximum(np.interp(chosen, middles, mean), 1.0e-300)
    looked_at = (last_hz - _SLOWEST_HZ) * steps_m.size * motion.step_s
    most = int(np.argmax(over))
    return float(chosen[most] * bin_hz) if over[most] - math.log(looked_at) > _LINE else None


def _surely_alike(groups: Sequence[ComplexArray]) -> float:
    """Minus the logarithm of how rarely tones of any phase would be as much alike within their groups."""
    groups = [one for one in groups if np.abs(one).any()]
    if not groups:
        return 0.0
    whole = float(sum(np.abs(one).sum() for one in groups))
    together = float(sum(abs(one.sum()) for one in groups)) / whole
    count = whole**2 / float(sum((np.abs(one) ** 2).sum() for one in groups))
    return -0.5 * max(count - len(groups), 0.0) * math.log(max(1.0 - together**2, 1.0e-12))


def _force(view: View, clock: Clock) -> _Force | None:
    """The forces that shake a simulated stem like this one; None where none can be simulated."""
    plain = parameters_of(view.null, view.estimate, view.nameplate)
    filtered = lag_of(view)
    filter_s = 0.0 if filtered is None else filtered.value
    forces_n = view.setting.full_force_n * _SHARES
    # the damping is hardly known of a stem that is shaken
    damped = [
        replace(plain, viscous_friction_n_s_per_m=share * plain.viscous_friction_n_s_per_m) for share in _DAMPINGS
    ]
    tried = [one for stem in damped for one in _simulated(stem, clock, forces_n, filter_s)]
    if not tried:
        return None
    least = min(one.off for one in tried)
    # where it moves at the peaks alone a larger force moves it no further
    near = [one for one in tried if one.off < _TIMES * least + _AS_NEAR]
    as_near_n = [one.effect.force_n for one in near]
    half_step = math.sqrt(_SHARES[1] / _SHARES[0])
    best = min(near, key=lambda one: one.error_m)
    return _Force(best.effect, best.stem, min(as_near_n) / half_step, max(as_near_n) * half_step)


def _simulated(plain: ValveParameters, clock: Clock, forces_n: FloatArray, filter_s: float) -> list[_Shaken]:
    """What these forces, shape (n,), do to a stem, where that can be simulated.

    What shakes makes friction look less: each force has the friction beside it that the motion shows.
    """
    motion, frequency_hz = clock.motion, clock.frequency_hz
    frequencies_hz = frequency_hz * np.array(_HARMONICS)
    measured_m = (1.0 + 2j * np.pi * frequencies_hz * filter_s) * motion.tones_m(frequencies_hz)
    found: list[_Shaken] = []
    friction_n, phase_rad = plain.coulomb_friction_n, 0.0
    for before_n, force_n in pairwise([0.0, *forces_n.tolist()]):
        friction_n += 0.5 * (force_n - before_n)
        last: _Shaken | None = None
        for _ in range(_ROUNDS):
            effect, stem = PeriodicForce(force_n, frequency_hz, phase_rad), _with_friction(plain, friction_n)
            shown = _shaken(with_effects(stem, [effect]), motion)
            if shown is None:
                last = None
                break
            tones_m = shown.tones_m(frequencies_hz)
            off = float(np.sum(np.abs(tones_m - measured_m) ** 2) / np.sum(np.abs(measured_m) ** 2))
            last = _Shaken(effect, stem, off, float(np.std(shown.position_m - motion.position_m)))
            phase_rad = math.remainder(phase_rad + float(np.angle(measured_m[0] * tones_m[0].conjugate())), math.tau)
            friction_n += _friction_n(plain, motion) - _friction_n(plain, shown)
        found += [] if last is None else [last]
    return found


def _with_friction(plain: ValveParameters, coulomb_n: float) -> ValveParameters:
    """The stem with another F_c, and as much above it for the breakaway."""
    coulomb_n = max(coulomb_n, 1.0e-6)
    static_n = coulomb_n + plain.static_friction_n - plain.coulomb_friction_n
    return replace(plain, coulomb_friction_n=coulomb_n, static_friction_n=max(static_n, coulomb_n))


def _shaken(valve: ExtendedValve, motion: _Motion) -> _Motion | None:
    """What the valve does under the same force, from rest; None where it cannot be followed."""
    start = ExtendedState(StemState(float(motion.position_m[0]), 0.0), rest_since_s=float(motion.time_s[0]) - _RESTED_S)
    try:
        shown = ExtendedStem(valve).motion(start, motion.time_s, motion.force_n, motion.time_s)
    except ValveError:
        return None
    return replace(motion, position_m=shown.sensed_m)


def _friction_n(plain: ValveParameters, motion: _Motion) -> float:
    """What the force has beside the spring's in the later half of a stroke, against the motion, N."""
    later = slice(motion.time_s.size // 2, None)
    way = math.copysign(1.0, motion.force_n[-1] - motion.force_n[0])
    return way * float(np.mean(motion.force_n[later] - plain.spring_rate_n_per_m * motion.position_m[later]))


def _is_readings(view: View, clock: Clock) -> bool:
    """Whether the position swings as in motion where friction holds the stem, after the force has turned."""
    reading, tone_m, rows = view.reading, 0.0j, 0
    time_s, force_n = reading.time_s, reading.path.force_n
    for corner_s in reading.path.corners_s.tolist():
        turned_n, later_n = np.interp([corner_s, corner_s + _TURNED_S], time_s, force_n)
        # half of what it takes to move it back
        held_s = min(view.null.known("F_c").value * _TURNED_S / max(abs(later_n - turned_n), 1.0e-9), _LONGEST_S)
        first, end = np.searchsorted(time_s, (corner_s + _STOPS_S, corner_s + held_s)).tolist()
        if (held_s - _STOPS_S) * clock.frequency_hz >= _FEWEST_CYCLES and end > first:
            part = slice(first, end)
            beside_m = reading.position_m[part] - reading.position_m[part].mean()
            tone_m += beside_m @ np.exp(-2j * np.pi * clock.frequency_hz * time_s[part])
            rows += beside_m.size
    in_motion_m = clock.motion.swing_m(clock.frequency_hz)
    return rows > 0 and abs(2.0 * tone_m / rows - in_motion_m) < _LIKE_MOTION * abs(in_motion_m)


def _in_pressure_n(reading: Reading, frequency_hz: float) -> float:
    """Amplitude of the measured force at this frequency, N."""
    samples = reading.samples
    weight = np.hanning(samples.count)
    turning = np.exp(-2j * np.pi * frequency_hz * samples.time_s)
    beside_n = weight * (samples.force_n - samples.force_n.mean())
    return float(2.0 * abs(beside_n @ turning) / weight.sum())
