"""What the motion's kernels are given, checked; and the errors that they answer with."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import MotionError, ParameterError, WaveformError
from valve.kernel.modes import ROOT_NOT_FOUND, TOO_MANY_STEPS
from valve.kernel.sampling import first_fall
from valve.messages import say
from valve.parameters import TravelStops, ValveParameters
from valve.stem import FloatArray, StemState

# A triangle test makes about three changes of mode a ramp; only creep below DV comes near this.
MOST_EVENTS: Final = 100_000

_THE_STEM: Final = say("the_stem", "the stem")


def float_array(values: npt.ArrayLike) -> FloatArray:
    """Return the values as the kernels take them: contiguous, writeable float64; a copy only where needed.

    Any shape and unit.
    """
    return np.require(values, np.float64, ["C", "W"])


def checked_corners(force_time_s: npt.ArrayLike, force_n: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the corners of a force as arrays of shape (n,). Raises WaveformError where they make none."""
    time_s, force = float_array(force_time_s), float_array(force_n)
    if time_s.ndim != 1 or time_s.shape != force.shape or time_s.size == 0:
        raise WaveformError(
            say(
                "force_unequal",
                "force: {times} times and {forces} values, it needs at least 1 of each and as many of one as of the "
                "other",
                times=int(time_s.size),
                forces=int(force.size),
            )
        )
    fall = first_fall(time_s)
    if fall >= 0:
        raise WaveformError(
            say(
                "force_time_falls",
                "force: its time at corner {number} is {time:g} s, times must not fall: sort them",
                number=fall + 1,
                time=float(time_s[fall]),
            )
        )
    if not np.isfinite(force).all():
        corner = int(np.isfinite(force).argmin())
        raise WaveformError(
            say(
                "force_corner_not_finite",
                "force: corner {number} is {force} N, it must be a finite number: correct it",
                number=corner + 1,
                force=float(force[corner]),
            )
        )
    return time_s, force


def checked_outputs(output_time_s: npt.ArrayLike, first_s: float) -> FloatArray:
    """Return the output times, shape (n,). Raises WaveformError where they fall or begin before the force."""
    time_s = float_array(output_time_s)
    if time_s.ndim != 1:
        raise WaveformError(
            say("output_times_dimensions", "output times: they have {count} dimensions, give 1", count=int(time_s.ndim))
        )
    fall = first_fall(time_s)
    if fall >= 0:
        raise WaveformError(
            say(
                "output_times_fall",
                "output times: number {number} is {time:g} s, they must not fall: sort them",
                number=fall + 1,
                time=float(time_s[fall]),
            )
        )
    if time_s.size and time_s[0] < first_s:
        raise WaveformError(
            say(
                "output_times_before_force",
                "output times: they begin at {time:g} s and the force at {first:g} s: begin with the force",
                time=float(time_s[0]),
                first=first_s,
            )
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
            say(
                "stem_outside_stops",
                "stem state: position {position:g m} lies outside the travel stops of {low:g in m} to {high:g m}: "
                "start between them",
                position=state.position_m,
                low=stops.low_m,
                high=stops.high_m,
            )
        )


def motion_error(
    arguments: tuple[float, ...], status: int, events: int, most_events: int, *, subject: str = _THE_STEM
) -> MotionError:
    """Return the error for a kernel's ``status``: too many events or steps, or a root that was not found."""
    named = tuple(
        say("value_of_symbol", "{symbol} = {value:.6g}", symbol=symbol, value=value)
        for symbol, value in zip(("m", "k", "F_v", "F_c", "F_s", "DV", "F_0"), arguments, strict=False)
    )
    if status == ROOT_NOT_FOUND:
        return MotionError(
            say(
                "slip_end_not_found",
                "{subject} ({named:, }): the end of a slip was not found after {events} changes of mode: report these "
                "numbers",
                subject=subject,
                named=named,
                events=events,
            )
        )
    if status == TOO_MANY_STEPS:
        return MotionError(
            say(
                "too_many_steps",
                "{subject} ({named:, }): more steps than 100000 a second and a million besides: no spring and friction "
                "of a valve hold it, so look at these values",
                subject=subject,
                named=named,
            )
        )
    creep_n_per_s = arguments[1] * arguments[5]
    return MotionError(
        say(
            "too_many_events",
            "{subject} ({named:, }): more than {most} changes of mode, the limit is {most}: a force slower than k "
            "DV = {rate:.3g N/s} makes it creep in micro-steps, so drive it faster, shorten the test or raise "
            "most_events",
            subject=subject,
            named=named,
            most=most_events,
            rate=creep_n_per_s,
        )
    )
