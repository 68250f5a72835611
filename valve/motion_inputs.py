"""What the motion's kernels are given, checked; and the errors that they answer with."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import MotionError, ParameterError, WaveformError
from valve.kernel.modes import ROOT_NOT_FOUND, TOO_MANY_STEPS
from valve.kernel.sampling import first_fall
from valve.parameters import TravelStops, ValveParameters
from valve.stem import FloatArray, StemState

# A triangle test makes about three changes of mode a ramp; only creep below DV comes near this.
MOST_EVENTS: Final = 100_000


def float_array(values: npt.ArrayLike) -> FloatArray:
    """Return the values as the kernels take them: contiguous, writeable float64; a copy only where needed."""
    return np.require(values, np.float64, ["C", "W"])


def checked_corners(force_time_s: npt.ArrayLike, force_n: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the corners of a force as arrays of shape (n,). Raises WaveformError where they make none."""
    time_s, force = float_array(force_time_s), float_array(force_n)
    if time_s.ndim != 1 or time_s.shape != force.shape or time_s.size == 0:
        raise WaveformError(
            f"force: {time_s.size} times and {force.size} values, it needs at least 1 of each and as many of one as "
            "of the other"
        )
    fall = first_fall(time_s)
    if fall >= 0:
        raise WaveformError(
            f"force: its time at corner {fall + 1} is {time_s[fall]:g} s, times must not fall: sort them"
        )
    if not np.isfinite(force).all():
        corner = int(np.isfinite(force).argmin())
        raise WaveformError(f"force: corner {corner + 1} is {force[corner]} N, it must be a finite number: correct it")
    return time_s, force


def checked_outputs(output_time_s: npt.ArrayLike, first_s: float) -> FloatArray:
    """Return the output times, shape (n,). Raises WaveformError where they fall or begin before the force."""
    time_s = float_array(output_time_s)
    if time_s.ndim != 1:
        raise WaveformError(f"output times: they have {time_s.ndim} dimensions, give 1")
    fall = first_fall(time_s)
    if fall >= 0:
        raise WaveformError(f"output times: number {fall + 1} is {time_s[fall]:g} s, they must not fall: sort them")
    if time_s.size and time_s[0] < first_s:
        raise WaveformError(
            f"output times: they begin at {time_s[0]:g} s and the force at {first_s:g} s: begin with the force"
        )
    return time_s


def kernel_arguments(parameters: ValveParameters, stops: TravelStops | None) -> tuple[float, ...]:
    """Return m, k, F_v, F_c, F_s, DV, F_0 and both stops, as the kernels take them."""
    low_m, high_m = (-math.inf, math.inf) if stops is None else (stops.low_m, stops.high_m)
    return (
        float(parameters.mass_kg),
        float(parameters.spring_rate_n_per_m),
        float(parameters.viscous_friction_n_s_per_m),
        float(parameters.coulomb_friction_n),
        float(parameters.static_friction_n),
        float(parameters.limit_velocity_m_per_s),
        float(parameters.preload_n),
        float(low_m),
        float(high_m),
    )


def require_within_stops(state: StemState, stops: TravelStops | None) -> None:
    """Raise ParameterError where the stem starts beyond a travel stop."""
    if stops is not None and not stops.low_m <= state.position_m <= stops.high_m:
        raise ParameterError(
            f"stem state: position {state.position_m:g} m lies outside the travel stops of {stops.low_m:g} to "
            f"{stops.high_m:g} m: start between them"
        )


def motion_error(
    arguments: tuple[float, ...], status: int, events: int, most_events: int, *, subject: str = "the stem"
) -> MotionError:
    """Return the error for a kernel's ``status``: too many events or steps, or a root that was not found."""
    named = ", ".join(
        f"{symbol} = {value:.6g}"
        for symbol, value in zip(("m", "k", "F_v", "F_c", "F_s", "DV", "F_0"), arguments, strict=False)
    )
    if status == ROOT_NOT_FOUND:
        return MotionError(
            f"{subject} ({named}): the end of a slip was not found after {events} changes of mode: report these numbers"
        )
    if status == TOO_MANY_STEPS:
        return MotionError(
            f"{subject} ({named}): more steps than 100000 a second and a million besides: no spring and friction of a "
            "valve hold it, so look at these values"
        )
    creep_n_per_s = arguments[1] * arguments[5]
    return MotionError(
        f"{subject} ({named}): more than {most_events} changes of mode, the limit is {most_events}: a force slower "
        f"than k DV = {creep_n_per_s:.3g} N/s makes it creep in micro-steps, so drive it faster, shorten the test or "
        "raise most_events"
    )
