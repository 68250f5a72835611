"""What an extended valve carries from one piece of a run to the next, and the rests that a run may be given."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from valve.errors import ParameterError, WaveformError
from valve.kernel.slots import (
    AT_V,
    AT_X,
    BRISTLE,
    ELAPSED,
    EXTRA,
    IN_MODE,
    LAGGED,
    NEVER_MOVED,
    PLAYED,
    REST_SINCE,
    SHOWN,
    STATES,
)
from valve.messages import say
from valve.motion_inputs import float_array
from valve.stem import FloatArray, Mode, StemState


@dataclass(frozen=True, slots=True)
class Rests:
    """Places at which the simulated stem is put to rest: shape (n,), times rising.

    ``since_s`` says when each rest began, for a breakaway that depends on it; by default at ``time_s``.
    Raises WaveformError where the arrays do not fit.
    """

    time_s: FloatArray
    position_m: FloatArray
    since_s: FloatArray | None = None

    def __post_init__(self) -> None:
        since_s = self.time_s if self.since_s is None else self.since_s
        arrays = [float_array(values) for values in (self.time_s, self.position_m, since_s)]
        if any(array.ndim != 1 or array.shape != arrays[0].shape for array in arrays):
            raise WaveformError(say("rests_unequal", "rests: give as many positions as times"))
        if not all(np.isfinite(array).all() for array in arrays) or (np.diff(arrays[0]) < 0.0).any():
            raise WaveformError(
                say("rests_fall", "rests: their times must rise and all numbers be finite: sort and correct them")
            )
        for name, array in zip(("time_s", "position_m", "since_s"), arrays, strict=True):
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True)
class ExtendedState:
    """All that the future of an extended valve depends on beside its input, SI.

    ``elapsed_s`` is the slots' own time (drift, vibration). A sensor or bristles that have followed nothing yet
    are None. Raises ParameterError where a number is not finite.
    """

    stem: StemState = field(default_factory=StemState)
    elapsed_s: float = 0.0
    rest_since_s: float = 0.0
    never_moved: bool = True
    bristle_n: float | None = None
    extra_static_n: float = 0.0
    sensor_m: tuple[float, float, float] | None = None  # what play, bow and gain, and lag have made of the position

    def __post_init__(self) -> None:
        values = (self.elapsed_s, self.rest_since_s, self.bristle_n or 0.0, self.extra_static_n, *(self.sensor_m or ()))
        if not all(math.isfinite(value) for value in values):
            raise ParameterError(
                say(
                    "extended_state_not_finite",
                    "state of an extended valve: all its numbers must be finite: correct them",
                )
            )

    @property
    def sensed_m(self) -> float:
        """Position that the sensor shows, m."""
        return self.stem.position_m if self.sensor_m is None else self.sensor_m[2]

    def vector(self) -> FloatArray:
        """Return the state as the kernel takes it."""
        state = np.full(len(STATES), math.nan)
        state[AT_X], state[AT_V] = self.stem.position_m, self.stem.velocity_m_per_s
        state[IN_MODE], state[ELAPSED], state[REST_SINCE] = self.stem.mode, self.elapsed_s, self.rest_since_s
        state[NEVER_MOVED], state[EXTRA] = float(self.never_moved), self.extra_static_n
        if self.bristle_n is not None:
            state[BRISTLE] = self.bristle_n
        if self.sensor_m is not None:
            state[PLAYED], state[SHOWN], state[LAGGED] = self.sensor_m
        return state


def state_from_vector(state: FloatArray) -> ExtendedState:
    """Return the state that the kernel left: one value for each of STATES, SI, shape (n_states,)."""
    sensor_m = None if math.isnan(state[PLAYED]) else (float(state[PLAYED]), float(state[SHOWN]), float(state[LAGGED]))
    return ExtendedState(
        StemState(float(state[AT_X]), float(state[AT_V]), Mode(int(state[IN_MODE]))),
        float(state[ELAPSED]),
        float(state[REST_SINCE]),
        bool(state[NEVER_MOVED]),
        None if math.isnan(state[BRISTLE]) else float(state[BRISTLE]),
        float(state[EXTRA]),
        sensor_m,
    )
