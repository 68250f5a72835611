"""Motion of the extended valve: what a stem does, and what its sensor shows, under a force and any slots.

The linear part is solved in closed form between anchors, and what the slots add is straight in time between them:
all slots neutral it is the exact motion of valve.motion; filled, it is accurate to second order of their strength
over a sub-step (docs/effects.md has the figures).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import MotionError, ParameterError
from valve.extended_state import ExtendedState, Rests, state_from_vector
from valve.extended_valve import ExtendedValve, InputPath
from valve.kernel.follow_extended import follow_extended
from valve.kernel.input_path import lagged_corners, transformed
from valve.kernel.modes import FOLLOWED
from valve.messages import say
from valve.motion_inputs import MOST_EVENTS, checked_corners, checked_outputs, float_array, motion_error
from valve.stem import FloatArray, ModeArray, ModeChanges, StemState

LONGEST_SUB_STEP_S: Final = 5.0e-3
# On the paper's 52.5 kN/m a nanometre or two, far below what any sensor shows.
INPUT_CHORD_ERROR: Final = 2.0e-8  # of the largest force
_NO_VALUES: Final[FloatArray] = np.empty(0)
_NO_MODES: Final[ModeArray] = np.empty(0, np.int8)
_EVENTS_AT_FIRST: Final = 4096


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedMotion:
    """A simulated motion, arrays of shape (n,) at ``time_s``; at an event the values after it count.

    ``sensed_m`` is the position as the sensor path shows it, ``force_n`` the actuator force after the input path.
    """

    time_s: FloatArray
    position_m: FloatArray
    sensed_m: FloatArray
    velocity_m_per_s: FloatArray
    mode: ModeArray
    force_n: FloatArray
    events: ModeChanges
    final_state: ExtendedState


def input_corners(
    path: InputPath, force_time_s: FloatArray, force_n: FloatArray, end_s: float, *, start_n: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Corners of the actuator force that acts when these are asked for; held before the first and after the last.

    With a lag the force begins at ``start_n``, by default settled, and chords follow the exponentials to
    INPUT_CHORD_ERROR of the largest force. The first time stays; the last is ``end_s`` or later.
    ``force_time_s``, ``force_n``: shape (n_corners,).
    """
    if path.is_neutral:
        return force_time_s, force_n
    limit_n = float(path.limit_n)
    time_s, target_n = transformed(
        force_time_s, force_n, float(path.gain), float(path.leak), limit_n, float(path.dead_time_s)
    )
    if path.lag_s == 0.0:
        return time_s, target_n
    begin_n = float(target_n[0]) if start_n is None else float(start_n)
    error_n = INPUT_CHORD_ERROR * max(float(np.abs(target_n).max()), abs(begin_n), 1.0e-6)
    lagged: tuple[FloatArray, FloatArray] = lagged_corners(
        time_s, target_n, max(float(end_s), float(time_s[-1])), float(path.lag_s), begin_n, error_n
    )
    return lagged


def _room(count: int) -> tuple[FloatArray, FloatArray, FloatArray, ModeArray, FloatArray]:
    """Return room for a kernel's outputs: position, sensed, velocity, mode and force, each of shape (count,)."""
    position_m, sensed_m, velocity_m_per_s, acting_n = np.empty((4, count))
    return position_m, sensed_m, velocity_m_per_s, np.empty(count, np.int8), acting_n


@dataclass(frozen=True, slots=True)
class ExtendedStem:
    """An extended valve made ready: its slots as the kernel takes them, for many runs or piece by piece.

    The input path is not its business: it takes the force that acts. Raises MotionError after ``most_events``
    changes of mode in one run.
    """

    valve: ExtendedValve
    most_events: int = MOST_EVENTS
    longest_step_s: float = LONGEST_SUB_STEP_S
    _slots: FloatArray = field(init=False, repr=False, compare=False)
    _curves: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_slots", self.valve.vector())
        object.__setattr__(self, "_curves", self.valve.curves())

    def advance(self, state: ExtendedState, force_time_s: FloatArray, force_n: FloatArray) -> ExtendedState:
        """Return the state at the last corner of a force that begins at ``state``; arrays: shape (n_corners,)."""
        vector = state.vector()
        self._run(vector, (force_time_s, force_n), float(force_time_s[-1]), room=0)
        return state_from_vector(vector)

    def ramp(self, state: ExtendedState, duration_s: float, start_n: float, end_n: float) -> ExtendedState:
        """Return the state after a force that goes straight from ``start_n`` to ``end_n`` in ``duration_s``."""
        return self.advance(state, np.array((0.0, duration_s)), np.array((start_n, end_n), dtype=np.float64))

    def motion(
        self,
        state: ExtendedState,
        force_time_s: FloatArray,
        force_n: FloatArray,
        time_s: FloatArray,
        *,
        rests: Rests | None = None,
    ) -> ExtendedMotion:
        """Return the motion from ``state`` at ``time_s``, as ``simulate_extended`` with arrays checked already.

        The force's arrays: shape (n_corners,); ``time_s``: shape (n,).
        """
        vector = state.vector()
        position_m, sensed_m, velocity_m_per_s, mode, acting_n = outputs = _room(time_s.size)
        end_s = float(time_s[-1]) if time_s.size else float(force_time_s[-1])
        events, _ = self._run(vector, (force_time_s, force_n), end_s, rests=rests, outputs=(time_s, *outputs))
        return ExtendedMotion(
            time_s, position_m, sensed_m, velocity_m_per_s, mode, acting_n, events, state_from_vector(vector)
        )

    def sensed(
        self,
        state: ExtendedState,
        force_time_s: FloatArray,
        force_n: FloatArray,
        time_s: FloatArray,
        *,
        rests: Rests | None = None,
    ) -> tuple[FloatArray, int]:
        """Return what the sensor shows at ``time_s``, m, shape (n,), as ``motion`` has it, and the kernel's passes."""
        outputs = _room(time_s.size)
        corners, end_s = (force_time_s, force_n), float(time_s[-1])
        _, passes = self._run(state.vector(), corners, end_s, rests=rests, outputs=(time_s, *outputs), room=0)
        return outputs[1], passes

    def _run(
        self,
        vector: FloatArray,
        corners: tuple[FloatArray, FloatArray],
        end_s: float,
        *,
        rests: Rests | None = None,
        outputs: tuple[FloatArray, FloatArray, FloatArray, FloatArray, ModeArray, FloatArray] | None = None,
        room: int = _EVENTS_AT_FIRST,
    ) -> tuple[ModeChanges, int]:
        """Run the kernel, ``vector`` in place; with more events than ``room`` again with room for all, but for 0.

        Return the events and the passes that it took.
        """
        at_rest = (_NO_VALUES,) * 3
        if rests is not None:
            assert rests.since_s is not None  # filled in when it was made
            at_rest = (rests.time_s, rests.position_m, rests.since_s)
        if outputs is None:
            outputs = (_NO_VALUES, _NO_VALUES, _NO_VALUES, _NO_VALUES, _NO_MODES, _NO_VALUES)
        # each form of an array is a kernel of its own, which takes ten seconds to compile
        force_time_s, force_n, time_s = (float_array(one) for one in (*corners, outputs[0]))
        room = min(room, self.most_events)
        event_time_s, event_mode = np.empty(room), np.empty(room, np.int8)
        before = vector.copy()
        status, events, passes = follow_extended(
            self._slots,
            self._curves,
            vector,
            force_time_s,
            force_n,
            end_s,
            time_s,
            *at_rest,
            *outputs[1:],
            event_time_s,
            event_mode,
            self.most_events,
            float(self.longest_step_s),
        )
        if status != FOLLOWED:
            raise self._error(status, events)
        if events > room > 0:
            vector[:] = before
            return self._run(vector, corners, end_s, rests=rests, outputs=outputs, room=events)
        return ModeChanges(event_time_s[:events].copy(), event_mode[:events].copy()), int(passes)

    def _error(self, status: int, events: int) -> MotionError:
        return motion_error(
            tuple(self._slots[:9]),
            status,
            events,
            self.most_events,
            subject=say("the_extended_stem", "the extended stem"),
        )


def simulate_extended(
    valve: ExtendedValve,
    force_time_s: npt.ArrayLike,
    force_n: npt.ArrayLike,
    output_time_s: npt.ArrayLike,
    *,
    initial: ExtendedState | None = None,
    rests: Rests | None = None,
    command: bool = True,
    most_events: int = MOST_EVENTS,
) -> ExtendedMotion:
    """Simulate an extended valve under an actuator force S_a P that is straight between its corners.

    Corners, shape (n_corners,), and outputs, shape (n,), as in ``simulate_motion``. ``command``: the force is the one
    asked for and takes the input path; without, it is measured at the actuator and acts as it is. ``rests`` puts the
    stem to rest where it was seen to rest, so that the steps of a stick-slip stay in phase with a measurement's.
    Raises WaveformError for malformed arrays, ParameterError for a start beyond a rigid stop, MotionError after
    ``most_events`` changes of mode.
    """
    state = ExtendedState() if initial is None else initial
    _require_within_stops(valve, state.stem)
    corners = checked_corners(force_time_s, force_n)
    time_s = checked_outputs(output_time_s, float(corners[0][0]))
    if command:
        corners = input_corners(valve.input, *corners, float(time_s[-1] if time_s.size else corners[0][-1]))
    return ExtendedStem(valve, most_events).motion(state, *corners, time_s, rests=rests)


def _require_within_stops(valve: ExtendedValve, stem: StemState) -> None:
    stops = valve.stops
    low_m = stops.low_m if math.isinf(stops.low_rate_n_per_m) else -math.inf
    high_m = stops.high_m if math.isinf(stops.high_rate_n_per_m) else math.inf
    if not low_m <= stem.position_m <= high_m:
        raise ParameterError(
            say(
                "stem_outside_stops",
                "stem state: position {position:g m} lies outside the travel stops of {low:g in m} to {high:g m}: "
                "start between them",
                position=stem.position_m,
                low=low_m,
                high=high_m,
            )
        )
