"""Many valves at once: the exact motion of each, in one pass of compiled code on one core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import WaveformError
from valve.kernel.follow import follow_many
from valve.kernel.modes import FOLLOWED
from valve.kernel.sampling import even_period
from valve.messages import say
from valve.motion_inputs import (
    MOST_EVENTS,
    checked_corners,
    checked_outputs,
    float_array,
    kernel_arguments,
    motion_error,
    require_within_stops,
)
from valve.parameters import TravelStops, ValveParameters
from valve.stem import FloatArray, Mode, StemState

_STOPS: Final = say("travel_stops", "travel stops")
_STATES: Final = say("initial_states", "initial states")


@dataclass(frozen=True, slots=True, eq=False)
class BatchMotion:
    """Simulated motions: time_s, shape (n,); position_m and velocity_m_per_s, shape (n_valves, n)."""

    time_s: FloatArray
    position_m: FloatArray
    velocity_m_per_s: FloatArray | None
    final_states: tuple[StemState, ...]


def simulate_batch(
    parameters: Sequence[ValveParameters],
    force_time_s: npt.ArrayLike,
    force_n: npt.ArrayLike,
    output_time_s: npt.ArrayLike,
    *,
    velocities: bool = False,
    stops: Sequence[TravelStops | None] | None = None,
    initial: Sequence[StemState] | None = None,
    most_events: int = MOST_EVENTS,
) -> BatchMotion:
    """Simulate many valves, each exactly as ``simulate_motion`` does.

    ``force_n`` has shape (n_corners,), the same force for all, or (n_valves, n_corners), one for each, at common
    times. The positions take 8 bytes a sample and valve (1000 valves over 60 s at 1 ms: 480 MB), and
    ``velocities`` as much again. Raises as ``simulate_motion``; the MotionError says which valve.
    """
    count = len(parameters)
    stops_each = [None] * count if stops is None else stops
    states = [StemState()] * count if initial is None else initial
    for values, what in ((stops_each, _STOPS), (states, _STATES)):
        if len(values) != count:
            raise WaveformError(
                say(
                    "batch_one_each",
                    "batch: {count} {what} for {valves} valves, give one each",
                    count=len(values),
                    what=what,
                    valves=count,
                )
            )
    for state, limits in zip(states, stops_each, strict=True):
        require_within_stops(state, limits)
    force = np.atleast_2d(float_array(force_n))
    if count == 0 or force.shape[0] not in {1, count}:
        raise WaveformError(
            say(
                "batch_forces",
                "batch: {forces} forces for {valves} valves, give one for all or one each",
                forces=int(force.shape[0]),
                valves=count,
            )
        )
    corner_time_s, _ = checked_corners(force_time_s, force[0])
    for row in force[1:]:
        checked_corners(corner_time_s, row)
    time_s = checked_outputs(output_time_s, float(corner_time_s[0]))
    arguments = [kernel_arguments(valve, limits) for valve, limits in zip(parameters, stops_each, strict=True)]
    position_m = np.empty((count, time_s.size))
    velocity_m_per_s = np.empty((count, time_s.size)) if velocities else np.empty((1, 0))
    final_x = np.array([s.position_m for s in states], dtype=np.float64)
    final_v = np.array([s.velocity_m_per_s for s in states], dtype=np.float64)
    final_mode, status, events = (np.array([int(s.mode) for s in states], dtype=np.int64) for _ in range(3))
    follow_many(
        np.array(arguments),
        final_x,
        final_v,
        final_mode,
        corner_time_s,
        force,
        float(time_s[-1] if time_s.size else corner_time_s[-1]),
        time_s,
        float(even_period(time_s)),
        position_m,
        velocity_m_per_s,
        most_events,
        status,
        events,
    )
    for valve in np.flatnonzero(status != FOLLOWED):
        subject = say("valve_of_batch", "valve {number} of {all}", number=int(valve) + 1, all=count)
        raise motion_error(arguments[valve], int(status[valve]), int(events[valve]), most_events, subject=subject)
    final = tuple(
        StemState(float(x), float(v), Mode(int(mode))) for x, v, mode in zip(final_x, final_v, final_mode, strict=True)
    )
    return BatchMotion(time_s, position_m, velocity_m_per_s if velocities else None, final)
