"""Exact event-driven motion of the Karnopp valve (Romano & Garcia 2007, Eq. 1-2).

Between two events the stem obeys a linear equation whose solution is known, so only the events have to be
found; nothing is stepped. F = force - k x - F_0 is the net force on a stem at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import RecordingError, WaveformError
from valve.kernel.follow import follow
from valve.kernel.modes import FOLLOWED
from valve.kernel.sampling import even_period
from valve.messages import say
from valve.motion_batch import BatchMotion, simulate_batch
from valve.motion_inputs import (
    MOST_EVENTS,
    checked_corners,
    checked_outputs,
    kernel_arguments,
    motion_error,
    require_within_stops,
)
from valve.nameplate import Nameplate
from valve.parameters import TravelStops, ValveParameters
from valve.recording import Recording
from valve.stem import FloatArray, Mode, ModeArray, ModeChanges, Motion, StemState
from valve.waveform import Waveform

_NO_VALUES: Final[FloatArray] = np.empty(0)
_NO_MODES: Final[ModeArray] = np.empty(0, np.int8)
_EVENTS_AT_FIRST: Final = 4096


def _follow(
    arguments: tuple[float, ...],
    initial: StemState,
    corners: tuple[FloatArray, FloatArray],
    outputs: tuple[float, FloatArray, float, FloatArray, FloatArray, ModeArray, FloatArray],
    *,
    most_events: int,
    room: int = _EVENTS_AT_FIRST,
) -> tuple[ModeChanges, StemState]:
    """Run the kernel; a motion with more events than ``room`` is run again with room for all."""
    event_time_s, event_mode = np.empty(min(room, most_events)), np.empty(min(room, most_events), np.int8)
    status, events, position_m, velocity_m_per_s, mode = follow(
        *arguments,
        float(initial.position_m),
        float(initial.velocity_m_per_s),
        int(initial.mode),
        *corners,
        *outputs,
        event_time_s,
        event_mode,
        most_events,
    )
    if status != FOLLOWED:
        raise motion_error(arguments, status, events, most_events)
    if events > room:
        return _follow(arguments, initial, corners, outputs, most_events=most_events, room=events)
    changes = ModeChanges(event_time_s[:events].copy(), event_mode[:events].copy())
    return changes, StemState(position_m, velocity_m_per_s, Mode(mode))


def _simulate(
    arguments: tuple[float, ...],
    initial: StemState,
    corners: tuple[FloatArray, FloatArray],
    time_s: FloatArray,
    most_events: int,
) -> Motion:
    """Simulate with outputs at ``time_s``, all of it checked already."""
    # one block for the three: apart, each run would fault in the pages of each array anew
    position_m, velocity_m_per_s, force_n = np.empty((3, time_s.size))
    mode = np.empty(time_s.size, np.int8)
    end_s = float(time_s[-1]) if time_s.size else float(corners[0][-1])
    outputs = (end_s, time_s, float(even_period(time_s)), position_m, velocity_m_per_s, mode, force_n)
    events, final_state = _follow(arguments, initial, corners, outputs, most_events=most_events)
    return Motion(time_s, position_m, velocity_m_per_s, mode, force_n, events, final_state)


def simulate_motion(
    parameters: ValveParameters,
    force_time_s: npt.ArrayLike,
    force_n: npt.ArrayLike,
    output_time_s: npt.ArrayLike,
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
    most_events: int = MOST_EVENTS,
) -> Motion:
    """Simulate the stem under an actuator force that is straight between its corners.

    ``force_time_s`` and ``force_n``, shape (n_corners,): times never fall, two equal ones make a step, after
    the last the force is held. ``output_time_s``, shape (n,), never falls; the motion begins with the first
    corner and ends with the last output (with the last corner if there is none).
    Raises WaveformError for malformed arrays, ParameterError for a start beyond a stop and MotionError after
    ``most_events`` changes of mode.
    """
    state = StemState() if initial is None else initial
    require_within_stops(state, stops)
    corners = checked_corners(force_time_s, force_n)
    time_s = checked_outputs(output_time_s, float(corners[0][0]))
    return _simulate(kernel_arguments(parameters, stops), state, corners, time_s, most_events)


def simulate_waveform(
    parameters: ValveParameters,
    waveform: Waveform,
    area_m2: float,
    sample_period_s: float,
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
    most_events: int = MOST_EVENTS,
) -> Motion:
    """Simulate the stem under a pressure waveform on ``area_m2``, sampled evenly from 0 s to its end.

    Raises WaveformError for a sample period that is not above 0, and as ``simulate_motion``.
    """
    if not (math.isfinite(sample_period_s) and sample_period_s > 0.0):
        raise WaveformError(
            say(
                "sample_period_not_positive",
                "sample period is {sample_period:g} s, it must be above 0: correct it",
                sample_period=sample_period_s,
            )
        )
    state = StemState() if initial is None else initial
    require_within_stops(state, stops)
    corners = checked_corners(waveform.time_s, area_m2 * waveform.pressure_pa)
    samples = math.floor(waveform.duration_s / sample_period_s * (1.0 + 1.0e-12)) + 1
    time_s = np.arange(samples, dtype=np.float64)
    time_s *= sample_period_s
    return _simulate(kernel_arguments(parameters, stops), state, corners, time_s, most_events)


def simulate_recording(
    parameters: ValveParameters,
    recording: Recording,
    nameplate: Nameplate,
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
    most_events: int = MOST_EVENTS,
) -> Motion:
    """Simulate the stem under a recorded input, straight between its samples, at the recording's times.

    Without ``initial`` the stem starts at rest at the first recorded position (drawn within the stops).
    Raises RecordingError where the input has a gap, and as ``simulate_motion``.
    """
    force_n = recording.actuator_force_n(nameplate)
    missing = np.flatnonzero(~np.isfinite(force_n))
    if missing.size:
        raise RecordingError(
            say(
                "input_missing_in",
                "{tag}: the recorded input is missing in {count} of {samples} samples, first at {first:g} s, and the "
                "motion needs all of them: cut the recording at its gaps",
                tag=nameplate.tag,
                count=int(missing.size),
                samples=recording.samples,
                first=float(recording.time_s[missing[0]]),
            )
        )
    if initial is None:
        present = recording.position_m[np.isfinite(recording.position_m)]
        position_m = float(present[0]) if present.size else 0.0
        if stops is not None:
            position_m = min(max(position_m, stops.low_m), stops.high_m)
        initial = StemState(position_m)
    return simulate_motion(
        parameters,
        recording.time_s,
        force_n,
        recording.time_s,
        stops=stops,
        initial=initial,
        most_events=most_events,
    )


@dataclass(frozen=True, slots=True)
class StemIntegrator:
    """A valve whose stem is followed piece by piece: the software valve's, and the cheap way to events alone.

    Unlike ``simulate_motion`` it does not check the arrays that it is given: contiguous float64 that never
    fall in time and are finite. Raises MotionError after ``most_events`` changes of mode in one call.
    """

    parameters: ValveParameters
    stops: TravelStops | None = None
    most_events: int = MOST_EVENTS
    _arguments: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_arguments", kernel_arguments(self.parameters, self.stops))

    def advance(self, state: StemState, force_time_s: FloatArray, force_n: FloatArray) -> StemState:
        """Return the state at the last corner of a force that begins at ``state``.

        Force's arrays: shape (n_corners,).
        """
        status, events, position_m, velocity_m_per_s, mode = follow(
            *self._arguments,
            float(state.position_m),
            float(state.velocity_m_per_s),
            int(state.mode),
            force_time_s,
            force_n,
            force_time_s[-1],
            _NO_VALUES,
            0.0,
            _NO_VALUES,
            _NO_VALUES,
            _NO_MODES,
            _NO_VALUES,
            _NO_VALUES,
            _NO_MODES,
            self.most_events,
        )
        if status != FOLLOWED:
            raise motion_error(self._arguments, status, events, self.most_events)
        return StemState(position_m, velocity_m_per_s, Mode(mode))

    def ramp(self, state: StemState, duration_s: float, start_n: float, end_n: float) -> StemState:
        """Return the state after a force that goes straight from ``start_n`` to ``end_n`` in ``duration_s``."""
        return self.advance(state, np.array((0.0, duration_s)), np.array((start_n, end_n), dtype=np.float64))

    def events(self, state: StemState, force_time_s: FloatArray, force_n: FloatArray) -> tuple[ModeChanges, StemState]:
        """Return the changes of mode and the state at the last corner of a force; its arrays: shape (n_corners,)."""
        end_s = float(force_time_s[-1])
        outputs = (end_s, _NO_VALUES, 0.0, _NO_VALUES, _NO_VALUES, _NO_MODES, _NO_VALUES)
        return _follow(self._arguments, state, (force_time_s, force_n), outputs, most_events=self.most_events)


__all__ = [
    "MOST_EVENTS",
    "BatchMotion",
    "Mode",
    "ModeChanges",
    "Motion",
    "StemIntegrator",
    "StemState",
    "simulate_batch",
    "simulate_motion",
    "simulate_recording",
    "simulate_waveform",
]
