"""A blind case: from a seed and a kind to recordings, a nameplate, and what is hidden in them."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from tests.bench.blind.kinds import KINDS, Kind
from tests.bench.blind.oddities import ODDITIES, Oddity, drawn_oddity
from tests.bench.blind.plant import (
    SETTLING_S,
    STEPS,
    VALVES,
    Course,
    Plant,
    comes_back,
    drawn_drive,
    drawn_plant,
    followed,
    on_the_integrations_clock,
    reached,
)
from tests.bench.blind.plant import followed_oddly as oddly
from tests.bench.blind.sequences import drawn_waveform, from_rest, held_out_sine
from tests.bench.blind.strengths import STOPS, STRENGTHS, Acquired, Expected, Swept, drawn_factor, expected
from valve.effects import Effect, with_effects
from valve.errors import ParameterError
from valve.extended_valve import ExtendedValve, FrictionSlots, SensorPath
from valve.nameplate import Nameplate
from valve.recording import Acquisition, FloatArray, Provenance, Recording
from valve.waveform import Waveform

NOISES_M: Final = (5.0e-6, 20.0e-6, 50.0e-6)
HELD_OUT: Final = "held-out sine"
_CAPTURED_S: Final = 1.0e-3
_POLLED_S: Final = 20.0e-3
_FIRST_RISE: Final = 0.2  # of F_s, at most, by which half of the first breakaways are harder
_MOST_PLACES: Final = 6
_MOST_DRAWS: Final = 16  # the second half of them with medium strengths
_AT_STOP_M: Final = 2.0e-5
_ZERO_M: Final = 50.0e-6  # of the position channel, at most


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """What is hidden: the cause, its strength in the unit of its line, as times the smallest, and its parameters."""

    cause: str
    strength: float
    factor: float
    parameters: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class BlindCase:
    """Recordings with something hidden. The finder sees ``recordings``, ``nameplate`` and ``held_out``, no more.

    ``oracle_rmse_m`` is the root mean square of the held-out recording minus the true model's reading at its times.
    ``changed_m`` is that of the clean first recording minus the same valve's without what is hidden.
    """

    seed: int
    kind: str
    valve: str
    recordings: tuple[Recording, ...]
    nameplate: Nameplate
    held_out: Recording
    hidden: tuple[HiddenCause, ...]
    expected: Expected
    oddity: str
    acquired: Acquired
    waveforms: tuple[str, ...]
    noise_m: float
    oracle_rmse_m: float
    changed_m: float
    truth: ExtendedValve = field(repr=False)


Drawn = tuple[HiddenCause, Effect]


def blind_case(seed: int, kind: str, *, factor: float | None = None, noise_m: float | None = None) -> BlindCase:
    """Return the case of this seed and kind, always the same; ``factor`` and ``noise_m`` replace what is drawn.

    Seeds go through the causes in turn, each with medium and large strengths alternately; all else is drawn.
    """
    group = KINDS[kind]
    rng = np.random.default_rng([4, seed, zlib.crc32(kind.encode())])
    acquired = group.acquired[int(rng.integers(len(group.acquired)))]
    names = group.waveforms[int(rng.integers(len(group.waveforms)))]
    if acquired is Acquired.FORCE:
        plant = drawn_drive(rng)
    else:
        name = VALVES[int(rng.integers(len(VALVES)))]
        plant = drawn_plant(name, rng, bench_set_known=group.bench_set_known)
    waves = tuple(drawn_waveform(name, rng, plant.low, plant.high) for name in names)
    sine = held_out_sine(rng, plant.low, plant.high)
    if acquired is Acquired.FORCE:
        waves, sine = tuple(from_rest(wave) for wave in waves), from_rest(sine)
    hiding = _Hiding(group, plant, waves, acquired)
    healthy = _healthy(plant, rng)
    oddity = hiding.oddity(seed, rng)
    hidden, valve, course = hiding.draw(seed, healthy, rng, factor, oddity)
    noise_m = float(rng.choice(NOISES_M)) if noise_m is None else noise_m
    taken = _Taken(plant, acquired, noise_m, float(rng.uniform(-_ZERO_M, _ZERO_M)), rng)
    courses = [course, *(hiding.course(valve, wave, oddity) for wave in waves[1:])]
    bare = hiding.course(healthy, waves[0], None) if hidden or oddity else courses[0]
    held_course = hiding.course(valve, sine, oddity)
    recordings = tuple(taken.recording(course, wave)[0] for course, wave in zip(courses, waves, strict=True))
    held_out, oracle_m = taken.recording(held_course, sine)
    return BlindCase(
        seed, kind, plant.name, recordings, plant.nameplate, held_out,
        hidden, hiding.expected(hidden, names, oddity), oddity.name if oddity else "", acquired, names,
        noise_m, oracle_m, _rms(courses[0].sensed_m - bare.sensed_m), valve,
    )  # fmt: skip


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _healthy(plant: Plant, rng: np.random.Generator) -> ExtendedValve:
    """The valve with what every real record may have: a first breakaway that is harder than the others."""
    rise_n = float(rng.uniform(0.0, _FIRST_RISE)) * plant.parameters.static_friction_n if rng.random() < 0.5 else 0.0
    return ExtendedValve(plant.parameters, friction=FrictionSlots(first_rise_n=rise_n))


@dataclass(frozen=True, slots=True)
class _Hiding:
    group: Kind
    plant: Plant
    waves: tuple[Waveform, ...]
    acquired: Acquired

    def oddity(self, seed: int, rng: np.random.Generator) -> Oddity | None:
        if self.group.causes != ODDITIES:
            return None
        longest_s = SETTLING_S + max(wave.duration_s for wave in self.waves)
        name = ODDITIES[seed % len(ODDITIES)]
        travel_m = self.plant.nameplate.actuator.travel_m
        return drawn_oddity(name, rng, longest_s, travel_m, self.plant.area_m2 * self.plant.high)

    def draw(
        self,
        seed: int,
        healthy: ExtendedValve,
        rng: np.random.Generator,
        factor: float | None,
        oddity: Oddity | None,
    ) -> tuple[tuple[HiddenCause, ...], ExtendedValve, Course]:
        """What is hidden, the valve with it, and its course under the first sequence.

        Drawn again where friction lets the stem out and never back: such a record shows no cause, and no test asks it.
        """
        if not self.group.causes or self.group.causes == ODDITIES:
            return (), healthy, self.course(healthy, self.waves[0], oddity)
        for turn in range(_MOST_DRAWS):
            hidden, valve = self._drawn_together(seed, healthy, rng, factor, may_be_large=2 * turn < _MOST_DRAWS)
            course = self.course(valve, self.waves[0], None)
            if comes_back(course):
                break
        return hidden, valve, course

    def _drawn_together(
        self,
        seed: int,
        healthy: ExtendedValve,
        rng: np.random.Generator,
        factor: float | None,
        *,
        may_be_large: bool,
    ) -> tuple[tuple[HiddenCause, ...], ExtendedValve]:
        causes, wanted = self.group.causes, self.group.hidden
        first, large = causes[seed % len(causes)], may_be_large and (seed // len(causes)) % 2 == 1
        while True:
            others = [str(name) for name in rng.permutation([cause for cause in causes if cause != first])]
            drawn = [self._hidden(name, rng, large, factor) for name in (first, *others[: wanted - 1])]
            try:
                drawn = self._with_stops_met(healthy, drawn)
                valve = with_effects(healthy, [effect for _, effect in drawn])
                on_the_integrations_clock(valve)
                return tuple(entry for entry, _ in drawn), valve
            except ParameterError:
                continue  # two that fill the same slot, or a drift from a friction that there is not

    def _with_stops_met(self, healthy: ExtendedValve, drawn: list[Drawn]) -> list[Drawn]:
        """What was drawn, its stops counted from the places that the stem comes to: else it may never meet one.

        A sticking stem turns before the end of what its force could sweep, and need not come back to where it began.
        """
        if not any(entry.cause in STOPS for entry, _ in drawn):
            return drawn
        wave = self.waves[0]
        stops = [entry for entry, _ in drawn if entry.cause in STOPS]
        placed: dict[str, Drawn] = {entry.cause: (entry, effect) for entry, effect in drawn if entry not in stops}
        for _ in range(_MOST_PLACES):
            valve = replace(with_effects(healthy, [effect for _, effect in placed.values()]), sensor=SensorPath())
            low_m, high_m = reached(self.course(valve, wave, None))
            swept = replace(self.plant.swept(wave), low_m=low_m, high_m=high_m)
            # a stem that begins at a stop steps elsewhere than one that does not
            missed = [one for one in stops if one.cause not in placed or not _is_met(placed[one.cause][0], swept)]
            if not missed:
                break
            placed |= {one.cause: self._drawn(one, swept) for one in missed}
        return [placed[entry.cause] for entry, _ in drawn]

    @staticmethod
    def _drawn(entry: HiddenCause, swept: Swept) -> Drawn:
        """A stop of this strength, which has no shape to draw."""
        effect = STRENGTHS[entry.cause].effect(entry.strength, swept, np.random.default_rng(0))
        return replace(entry, parameters=effect.values()), effect

    def _hidden(self, cause: str, rng: np.random.Generator, large: bool, factor: float | None) -> Drawn:
        times = drawn_factor(rng, large=large)
        times = times if factor is None else factor
        strength = times * STRENGTHS[cause].smallest
        swept = self.plant.swept(self.waves[0])
        effect = STRENGTHS[cause].effect(strength, swept, rng, other_law=self.group.other_laws)
        return HiddenCause(cause, strength, times, effect.values()), effect

    def course(self, valve: ExtendedValve, wave: Waveform, oddity: Oddity | None) -> Course:
        if oddity is not None:
            return oddly(valve.parameters, oddity, wave, self.plant.area_m2, STEPS)
        return followed(valve, wave, self.plant.area_m2, STEPS)

    def expected(self, hidden: tuple[HiddenCause, ...], names: tuple[str, ...], oddity: Oddity | None) -> Expected:
        if oddity is not None:
            return Expected.UNEXPLAINED
        p, known = self.plant.parameters, self.group.bench_set_known
        sticks = p.static_friction_n > p.coulomb_friction_n
        answers = {expected(one.cause, names, self.acquired, bench_set_known=known, stiction=sticks) for one in hidden}
        # of two causes, the one that is hardest to be sure of decides
        for answer in (Expected.SET, Expected.HIDDEN, Expected.NAMED):
            if answer in answers:
                return answer
        return Expected.NONE


def _is_met(stop: HiddenCause, swept: Swept) -> bool:
    place_m = stop.parameters["position_m"]
    if stop.cause == "travel_stop_low":
        return swept.low_m < place_m + _AT_STOP_M
    return swept.high_m > place_m - _AT_STOP_M


@dataclass(frozen=True, slots=True)
class _Taken:
    """How samples are taken of a course."""

    plant: Plant
    acquired: Acquired
    noise_m: float
    zero_m: float
    rng: np.random.Generator

    def recording(self, course: Course, wave: Waveform) -> tuple[Recording, float]:
        """Return the recording, and the root mean square of its position minus the clean reading, m.

        The zero of the position channel is not the model's error: it is left out of the second.
        """
        time_s, provenance, delay_s = self._times(wave.duration_s)
        clean_m = course.sensed_at(time_s)
        noise_m = self.noise_m * self.rng.standard_normal(time_s.size)
        force_n = course.force_at(time_s - delay_s)
        position_m = clean_m + noise_m + self.zero_m
        if self.acquired is Acquired.FORCE:
            return Recording(time_s, position_m, force_n=force_n, provenance=provenance), _rms(noise_m)
        pressure_pa = force_n / self.plant.area_m2
        if self.acquired is Acquired.GAUGED:
            share = math.exp(self.rng.uniform(math.log(2.0e-4), math.log(1.0e-3)))
            spread_pa = share * (self.plant.high - self.plant.low)
            pressure_pa = pressure_pa + spread_pa * self.rng.standard_normal(time_s.size)
        recording = Recording(
            time_s, position_m, pressure_pa=pressure_pa, command_pa=wave.at(time_s), provenance=provenance
        )
        if self.acquired is Acquired.COMMAND:
            recording = replace(recording, pressure_pa=None)
        if self.acquired is Acquired.POLLED:
            recording = self._with_gaps(recording)
        return recording, _rms(noise_m)

    def _times(self, duration_s: float) -> tuple[FloatArray, Provenance, float]:
        """Times of the samples, how they were taken, and how far the pressure is read after the position, s."""
        if self.acquired is not Acquired.POLLED:
            time_s: FloatArray = np.arange(math.floor(duration_s / _CAPTURED_S) + 1, dtype=np.float64) * _CAPTURED_S
            return time_s, Provenance(Acquisition.CAPTURED, requested_period_s=_CAPTURED_S), 0.0
        time_s = np.arange(math.floor(duration_s / _POLLED_S) + 1, dtype=np.float64) * _POLLED_S
        jitter = np.clip(self.rng.normal(0.0, 0.1, time_s.size), -0.4, 0.4) * _POLLED_S
        jitter[[0, -1]] = 0.0
        uncertainty_s = 0.05 * _POLLED_S
        provenance = Provenance(Acquisition.POLLED, requested_period_s=_POLLED_S, timing_uncertainty_s=uncertainty_s)
        return time_s + jitter, provenance, float(self.rng.uniform(-uncertainty_s, uncertainty_s))

    def _with_gaps(self, recording: Recording) -> Recording:
        """Without a few runs of rows."""
        kept = np.ones(recording.samples, dtype=bool)
        for first in self.rng.integers(10, recording.samples - 30, int(self.rng.integers(0, 5))):
            kept[first : first + int(self.rng.integers(1, 12))] = False
        return recording.rows(kept)
