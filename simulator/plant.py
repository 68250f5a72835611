"""The software valve: stem, I/P transducer and sensors as a function of simulated time.

Nothing here runs by itself: the state is computed when somebody looks, up to the time of the look.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from simulator.actuator_pressure import ActuatorPressure, AirState, PressureCourse
from simulator.faults import MOMENTARY, Fault, FaultKind, active_fault, next_edge_s
from simulator.packed_stem import PackedStem, Truth, plain_truth
from simulator.record import Event, Happening, ValveRecord
from simulator.samples import EndedRecord, Memory, Samples, joined
from simulator.sensor import coloured_noise
from simulator.simulated_valve import SimulatedValve
from simulator.stem import FollowedStem, PlainStem, StemWithEffects
from simulator.trajectory import Trajectory
from valve.errors import ParameterError
from valve.extended_valve import ExtendedValve
from valve.messages import say
from valve.motion import StemState
from valve.packing import NO_ROUGHNESS, PACKINGS
from valve.parameters import TravelStops, ValveParameters

FloatArray = npt.NDArray[np.float64]

_NO_TIMES: Final[FloatArray] = np.empty(0)
# Captured samples and live ones draw their noise from numbers that never meet.
LIVE_SAMPLES_FROM: Final = 1 << 48
SAMPLES_A_CAPTURE: Final = 1 << 24
# After a command has been held for so long the next one begins a record: what drifts has recovered.
RECORD_PAUSE_S: Final = 30.0
# A record of single commands ends when the last of them has been held for so long.
RECORD_TAIL_S: Final = 1.0


def warm_up(*, effects: bool = False, packing: bool = False) -> None:
    """Compile what follows a stem, or load it: seconds at the first time, which no read should have to wait for."""
    parameters, stops = ValveParameters(1.0, 1.0e4, 100.0, 10.0, 12.0, 1.0e-4), TravelStops()
    stems: list[FollowedStem] = [PlainStem(parameters, stops, 0.0)]
    if effects:
        stems.append(StemWithEffects(ExtendedValve(parameters), 0.0))
    if packing:
        stems.append(PackedStem(ExtendedValve(parameters), PACKINGS["usual"], NO_ROUGHNESS, 0.0, filter_s=0.01))
        coloured_noise(0, 0.01, np.zeros(1))
    for stem in stems:
        stem.advance(np.array([0.0, 0.1]), np.array([0.0, 100.0]))
        stem.sample(np.array([0.0, 0.1]), np.array([100.0, 0.0]), np.array([0.1]))


class SoftwareValve:
    """A valve whose state is known at ``time_s`` and can be advanced to any later time.

    ``before_advance``, where set, is called with the time of a look before the valve goes there: a device's own
    logic (watchdog, capture player) does there what it would have done in between. ``on_record``, where set, is told of
    each record that has ended: a waveform that was played, or commands with no pause between them.
    """

    def __init__(self, settings: SimulatedValve, start_s: float = 0.0) -> None:
        self.settings = settings
        self.record = ValveRecord(settings.tag)
        self.faults: tuple[Fault, ...] = settings.faults
        self.before_advance: Callable[[float], None] | None = None
        self.on_record: Callable[[str, EndedRecord], None] | None = None
        start_pa = settings.transducer.range_pa[0] if settings.start_pa is None else settings.start_pa
        start_pa = settings.transducer.level(start_pa)
        self.time_s = start_s
        self.asked = Trajectory(start_s, start_pa)
        filter_s = 0.0 if settings.pressure is None else settings.pressure.filter_s
        self._pressure = ActuatorPressure(settings.acting, filter_s, start_pa, start_s)
        self._record_from_s, self._record_until_s = start_s, -math.inf
        self._is_played = False
        self._stem = settings.stem_at(settings.rest_position_m(self.pressure_pa))
        self._frozen_m = self._stem.sensed_m
        self._shown = Memory(start_s, self._frozen_m, self._pressure.gauge_pa)
        self._asked_s = -math.inf
        self._sample = LIVE_SAMPLES_FROM

    def look(self, at_s: float) -> None:
        """Bring the valve, and the device that drives it, to the time of a look; earlier times change nothing."""
        if self.before_advance is not None:
            self.before_advance(at_s)
        self.advance(at_s)
        self.record.look(self.time_s, self.stem.position_m, self.pressure_pa, self.asked_pa)

    @property
    def stem(self) -> StemState:
        """Where the stem truly is and how fast."""
        return self._stem.state

    @property
    def asked_pa(self) -> float:
        """Pressure that the device asks of the I/P now, Pa."""
        return self.asked.at(self.time_s)

    @property
    def pressure_pa(self) -> float:
        """True pressure at the actuator, Pa."""
        return self._pressure.pressure_pa

    @property
    def supply_pa(self) -> float:
        """Air supply at its header now, Pa: what a sensor there shows."""
        lost = self.fault(FaultKind.AIR_LOST)
        return self.settings.transducer.supply_pa if lost is None else lost.amount

    @property
    def _reaching_pa(self) -> float:
        """Highest pressure that can reach the actuator now, Pa; an effect on the way may take its share."""
        return min(self.supply_pa, self.settings.acting.supply_pa)

    def ask(self, pressure_pa: float) -> None:
        """From now on ask the I/P for this pressure, rounded to a level of the output, Pa."""
        if self.time_s - self._asked_s >= RECORD_PAUSE_S:
            self._begin_record(self.time_s + RECORD_TAIL_S, played=False)
        elif not self._is_played and self.time_s <= self._record_until_s:
            self._record_until_s = self.time_s + RECORD_TAIL_S
        self._asked_s = self.time_s
        self.asked.step_to(self.time_s, self.settings.transducer.level(pressure_pa))

    def play(self, after_s: FloatArray, pressure_pa: FloatArray) -> None:
        """From now on ask for this waveform; its corners are rounded to levels of the output, the lines are not.

        ``after_s``, ``pressure_pa``: shape (n_corners,).
        """
        self._asked_s = self.time_s + float(after_s[-1])
        self._begin_record(self._asked_s, played=True)
        self.asked.replace_from(self.time_s, after_s, self.settings.transducer.quantised(pressure_pa))

    def hold(self) -> None:
        """From now on hold the pressure asked for, whatever was to come."""
        self.asked.hold_from(self.time_s)

    def inject(self, fault: Fault) -> None:
        """Add a fault. Raises ParameterError where it would have begun in the past, which is computed already."""
        if fault.start_s <= self.time_s:
            raise ParameterError(
                say(
                    "fault_in_the_past",
                    "{tag}: fault {fault} was to begin at {start:g s}, the valve is known up to {known:g s} "
                    "already: choose a later time",
                    tag=self.settings.tag,
                    fault=fault.kind,
                    start=fault.start_s,
                    known=self.time_s,
                )
            )
        self.faults = (*self.faults, fault)

    def advance(self, to_s: float, sample_s: FloatArray = _NO_TIMES) -> Samples | None:
        """Go to ``to_s`` and return values at ``sample_s``; None without.

        These are rising times from now to ``to_s``, shape (n,).
        """
        if not self.time_s < self._record_until_s < to_s:
            found = self._advance_shown(to_s, sample_s)
            if self.time_s == self._record_until_s:
                self._end_record()
            return found
        end_s = self._record_until_s
        before = int(np.searchsorted(sample_s, end_s, side="right"))
        pieces = [self.advance(end_s, sample_s[:before]), self._advance_shown(to_s, sample_s[before:])]
        return joined([piece for piece in pieces if piece is not None])

    def _advance_shown(self, to_s: float, sample_s: FloatArray) -> Samples | None:
        """Go to ``to_s`` and return at ``sample_s`` what sensors show, those with clocks of their own too."""
        position, pressure = self.settings.position, self.settings.pressure
        if position.is_instant and (pressure is None or pressure.is_instant):
            return self._advance_sampled(to_s, sample_s)
        looked_s = np.append(sample_s, max(to_s, self.time_s))
        sensed_at_s = position.taken_s(looked_s, self._record_from_s)
        gauge_at_s = looked_s if pressure is None else pressure.taken_s(looked_s, self._record_from_s)
        wanted_s = np.unique(np.concatenate((looked_s, sensed_at_s, gauge_at_s)))
        wanted_s = wanted_s[wanted_s >= self.time_s]
        found = self._advance_sampled(to_s, wanted_s)
        assert found is not None  # there is one at to_s at least
        self._shown.note(wanted_s, found.sensed_m, found.gauge_pa)
        at = np.searchsorted(wanted_s, sample_s)
        sensed_m, _ = self._shown.at(sensed_at_s[:-1])
        _, gauge_pa = self._shown.at(gauge_at_s[:-1])
        self._shown.forget(min(float(sensed_at_s[-1]), float(gauge_at_s[-1])))
        if sample_s.size == 0:
            return None
        return Samples(
            found.position_m[at],
            sensed_m,
            found.pressure_pa[at],
            gauge_pa,
            found.asked_pa[at],
            sensed_at_s[:-1],
            gauge_at_s[:-1],
        )

    def _advance_sampled(self, to_s: float, sample_s: FloatArray) -> Samples | None:
        """Go to ``to_s`` and return what there is at ``sample_s``."""
        if not self.faults and sample_s.size == 0:
            return self._advance_evenly(to_s, sample_s)
        pieces: list[Samples] = []
        taken = 0
        while True:
            edge_s = min(to_s, next_edge_s(self.faults, self.time_s)) if self.faults else to_s
            until = int(np.searchsorted(sample_s, edge_s, side="left" if edge_s < to_s else "right"))
            before_s, frozen = self.time_s, self.fault(FaultKind.FROZEN_SENSOR) is not None
            piece = self._advance_evenly(edge_s, sample_s[taken:until])
            if piece is not None:
                pieces.append(piece)
            if not frozen:
                self._frozen_m = self._stem.sensed_m
            self._let_momentary_faults_happen(before_s)
            taken = until
            if edge_s >= to_s:
                break
        return joined(pieces)

    def read_position_m(self) -> float:
        """Position as the sensor reads it now, m; NaN when it is bad. Each reading draws new noise."""
        self._sample += 1
        sensed_m, sample, sensor = self._stem.sensed_m, self._sample, self.settings.position
        taken_s = self.time_s
        if not sensor.is_instant:
            at_s = sensor.taken_s(np.array([self.time_s]), self._record_from_s)
            sensed_m, taken_s = float(self._shown.at(at_s)[0][0]), float(at_s[0])
        elif self.faults:
            sensed_m = float(self._sensed(np.array([sensed_m]))[0])
        if self.faults:
            spikes = self.fault(FaultKind.SENSOR_SPIKES)
            sensed_m += spikes.amount if spikes is not None and sample % 3 == 0 else 0.0
            if self.fault(FaultKind.FROZEN_SENSOR) is not None:
                # a converter that stands still shows the same noise again and again
                sample, taken_s = LIVE_SAMPLES_FROM, 0.0
        return sensor.reading(sensed_m, sample, taken_s)

    def read_pressure_pa(self) -> float:
        """Actuator pressure as its sensor reads it now, Pa; NaN where there is none."""
        self._sample += 1
        sensor = self.settings.pressure
        if sensor is None:
            return math.nan
        if sensor.is_instant:
            return sensor.reading(self._pressure.gauge_pa, self._sample, self.time_s)
        at_s = sensor.taken_s(np.array([self.time_s]), self._record_from_s)
        return sensor.reading(float(self._shown.at(at_s)[1][0]), self._sample, float(at_s[0]))

    @property
    def truth(self) -> Truth:
        """What an estimate of the record since its beginning is judged by."""
        if isinstance(self._stem, PackedStem):
            return self._stem.truth()
        return plain_truth(self.settings.extended.parameters)

    def _begin_record(self, until_s: float, *, played: bool) -> None:
        """Begin what counts from the start of a record anew, and set the sensors' clocks."""
        self._stem.begin_record()
        self._record_from_s, self._record_until_s, self._is_played = self.time_s, until_s, played

    def _end_record(self) -> None:
        self._record_until_s = -math.inf
        if self.on_record is not None:
            self.on_record(self.settings.tag, EndedRecord(self._record_from_s, self.time_s, self.truth))

    def fault(self, kind: FaultKind) -> Fault | None:
        """Return the fault of this kind that is there now."""
        return active_fault(self.faults, kind, self.time_s) if self.faults else None

    def _advance_evenly(self, to_s: float, sample_s: FloatArray) -> Samples | None:
        """Advance over a time in which no fault begins or ends."""
        start_s, dead_s = self.time_s, self.settings.acting.dead_time_s
        duration_s = max(to_s - start_s, 0.0)
        if sample_s.size == 0 and (duration_s == 0.0 or self._is_level(start_s - dead_s)):
            self._stay_level(duration_s)
            self.time_s = max(to_s, start_s)
            self.asked.forget(self.time_s - dead_s)
            return None
        time_s, asked_pa = self.asked.between(start_s - dead_s, start_s + duration_s - dead_s)
        # Local times: the clock may have run for days, and the difference of two such times is rounded.
        after_s = time_s - time_s[0]
        after_s[-1] = duration_s
        course = self._pressure.follow(start_s, after_s, asked_pa, self._air)
        wanted_s = np.clip(sample_s - start_s, 0.0, duration_s)
        position_m, shown_m = self._follow(course, wanted_s)
        sensed_m = self._sensed(shown_m)
        asked_then_pa = self.asked.values(sample_s)
        self.time_s = max(to_s, start_s)
        self.asked.forget(self.time_s - dead_s)
        if sample_s.size == 0:
            return None
        return Samples(position_m, sensed_m, *course.at(wanted_s), asked_then_pa, sample_s, sample_s)

    @property
    def _air(self) -> AirState:
        if not self.faults:
            return AirState(self._reaching_pa)
        runaway = self.fault(FaultKind.PRESSURE_RUNAWAY)
        stuck = self.fault(FaultKind.PRESSURE_STUCK) is not None
        return AirState(self._reaching_pa, stuck, None if runaway is None else runaway.amount)

    def _is_level(self, from_s: float) -> bool:
        """Whether the pressure asked for and that at the actuator stay as they are."""
        asked_pa = self.asked.at(from_s) if self.asked.is_held_from(from_s) else None
        return self._pressure.is_level(asked_pa, self._air)

    def _stay_level(self, duration_s: float) -> None:
        """Advance with the pressure as it is."""
        if duration_s > 0.0:
            self._pressure.stay(duration_s)
            if self.fault(FaultKind.STUCK_STEM) is not None:
                self._stem.hold(duration_s, _NO_TIMES)
                return
            force_n = self.settings.area_m2 * self.pressure_pa
            self._stem.advance(np.array((0.0, duration_s)), np.array((force_n, force_n), dtype=np.float64))

    def _let_momentary_faults_happen(self, after_s: float) -> None:
        for fault in self.faults:
            if fault.kind in MOMENTARY and after_s < fault.start_s <= self.time_s:
                self.ask(self.settings.transducer.range_pa[0])
                happening = Happening.RESTARTED if fault.kind is FaultKind.RESTART else Happening.OUTPUT_RESET
                self.record.add(Event(self.time_s, self.settings.tag, happening, pressure_pa=self.asked_pa))

    def _follow(self, course: PressureCourse, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Go on while the pressure takes this course; true and sensed positions at ``wanted_s`` after now."""
        if self.fault(FaultKind.STUCK_STEM) is not None:
            return self._stem.hold(float(course.after_s[-1]), wanted_s)
        force_n = self.settings.area_m2 * course.pressure_pa
        if wanted_s.size == 0:
            self._stem.advance(course.after_s, force_n)
            return wanted_s, wanted_s
        return self._stem.sample(course.after_s, force_n, wanted_s)

    def _sensed(self, shown_m: FloatArray) -> FloatArray:
        """Positions that the sensor shows as the faults of now leave them, before its noise and resolution."""
        if not self.faults:
            return shown_m
        if self.fault(FaultKind.SENSOR_LOST) is not None:
            return np.full(shown_m.shape, math.nan)
        if self.fault(FaultKind.FROZEN_SENSOR) is not None:
            return np.full(shown_m.shape, self._frozen_m)
        jump = self.fault(FaultKind.SENSOR_JUMP)
        return shown_m if jump is None else shown_m + jump.amount
