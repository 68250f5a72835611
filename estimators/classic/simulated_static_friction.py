"""Static friction by simulation (Romano & Garcia 2007, Eq. 9): affordable with the exact motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from estimators.base import ParameterEstimate, measured
from estimators.classic.differences import backward_differences
from estimators.classic.misfit import Fallback, simulated_position
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import Samples
from valve.errors import ParameterError
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, ValveParameters, parameters_from_symbols

# The cost of Eq. (9) has several minima within some percent: they are scanned before the best is refined.
_SCANNED: Final = 25
_BRACKET: Final = 0.03
_TOLERANCE: Final = 1.0e-7


def refined_static_friction(
    motion: RecordedMotion, parameters: dict[str, ParameterEstimate], fallback: Fallback
) -> ParameterEstimate:
    """Method 1's third step, Eq. (9), around the value from the breakaways; that value where it cannot be done."""
    start = parameters["F_s"]
    values = {symbol: estimate.value for symbol, estimate in parameters.items()}
    complete = fallback.by_symbol() | {symbol: value for symbol, value in values.items() if value is not None}
    if start.value is None or set(complete) != set(PARAMETER_SYMBOLS):
        return start
    complete["F_s"] = max(complete["F_s"], complete["F_c"])
    try:
        valve = parameters_from_symbols(complete)
    except ParameterError:
        return start
    found = static_friction_by_simulation(
        motion.samples, valve, start.std_error or 0.0, motion.first_moving_row, motion.stops
    )
    return start if found is None else measured(*found, note="by simulation, Eq. (9)")


def static_friction_by_simulation(
    samples: Samples,
    parameters: ValveParameters,
    std_error_n: float,
    first_moving_row: int,
    stops: TravelStops | None,
) -> tuple[float, float] | None:
    """F_s that brings simulated and measured velocity together, N, with its standard error; None where none does.

    Both velocities are backward differences. The search stays within 3 % or 4 ``std_error_n`` of
    ``parameters.static_friction_n``, the value from the breakaways, and does not go below F_c.
    """
    velocity, _ = backward_differences(samples)
    seen = np.isfinite(velocity)

    def cost(static_friction_n: float) -> float:
        valve = replace(parameters, static_friction_n=float(static_friction_n))
        position_m = simulated_position(valve, samples, first_moving_row, stops)
        if position_m is None:
            return float("inf")
        simulated, _ = backward_differences(replace(samples, position_m=position_m))
        return float(np.mean((velocity[seen] - simulated[seen]) ** 2))

    start = parameters.static_friction_n
    width = max(_BRACKET * start, 4.0 * std_error_n)
    low = max(parameters.coulomb_friction_n, start - width)
    trials = np.linspace(low, start + width, _SCANNED)
    costs = np.array([cost(trial) for trial in trials])
    if not np.isfinite(costs).any():
        return None
    best = int(np.argmin(costs))
    bounds = (float(trials[max(0, best - 1)]), float(trials[min(_SCANNED - 1, best + 1)]))
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": _TOLERANCE * start})
    value = float(found.x)
    return value, _curvature_error(cost, value, float(found.fun), 2.0e-4 * start, int(seen.sum()))


def _curvature_error(cost: Callable[[float], float], value: float, least: float, step: float, count: int) -> float:
    """Standard error from the curvature of the mean square: sqrt(2 J / (n J''))."""
    curvature = (cost(value + step) - 2.0 * least + cost(value - step)) / step**2
    return float(np.sqrt(2.0 * least / (count * curvature))) if curvature > 0.0 else step
