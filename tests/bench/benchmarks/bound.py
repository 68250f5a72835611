"""The Cramér-Rao bound of a test whose truth is known: the smallest standard errors that any method can have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from estimators.identifiability.sensitivities import position_sensitivities
from valve.motion import simulate_motion
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, ValveParameters
from valve.stem import FloatArray, StemState

DV_PRIOR_SD: Final = 1.5  # of ln DV: what is assumed of it before the test
# periods: how nearly at once a device's capture, or one short exchange, reads both channels
ONE_INSTANT: Final = 5.0e-3
IDENTIFIABLE: Final = 0.30  # a 95 % half width above this share of the value is no knowledge


def bound(
    truth: ValveParameters,
    corners: tuple[FloatArray, FloatArray],
    time_s: FloatArray,
    noise_m: float,
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
    nuisances: Sequence[tuple[FloatArray, float]] = (),
) -> dict[str, float]:
    """Return the standard error of every parameter by its symbol, SI; infinite where nothing is known.

    ``corners`` are times, s, and forces, N; the positions at ``time_s`` have white noise ``noise_m``. The start
    position is unknown too, and so is each of ``nuisances``: a derivative of the position, shape (n,), and what is
    known of it beforehand, one standard deviation. (J'J / noise^2 + priors)^-1, with the weak prior of DV.
    """
    symbols = [*PARAMETER_SYMBOLS, "x_0"]
    _, slopes = position_sensitivities(truth, *corners, time_s, symbols, stops=stops, initial=initial)
    jacobian = np.column_stack([slopes, *(column for column, _ in nuisances)]) / noise_m
    information = jacobian.T @ jacobian
    place = symbols.index("DV")
    information[place, place] += (DV_PRIOR_SD * truth.limit_velocity_m_per_s) ** -2.0
    for i, (_, prior_sd) in enumerate(nuisances, start=len(symbols)):
        information[i, i] += prior_sd**-2.0
    scale = np.sqrt(np.diag(information))
    known = scale > 0.0
    errors = np.full(len(symbols), math.inf)
    scaled = information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
    # 1e-14: what is tied to another to rounding is unknown, not negative
    covariance = np.linalg.inv(scaled + 1.0e-14 * np.eye(scaled.shape[0]))
    within = np.flatnonzero(known[: len(symbols)])
    errors[within] = np.sqrt(np.abs(np.diag(covariance))[: within.size]) / scale[within]
    return dict(zip(symbols, errors.tolist(), strict=True))


def delay_slope(
    truth: ValveParameters,
    corners: tuple[FloatArray, FloatArray],
    time_s: FloatArray,
    *,
    stops: TravelStops | None = None,
    initial: StemState | None = None,
) -> FloatArray:
    """Change of the position by a force that comes later, m/s, shape (n,): central difference over 2 us."""
    force_s, force_n = corners
    sides = []
    for late_s in (1.0e-6, -1.0e-6):
        shifted_s = np.concatenate([force_s[:1], np.maximum(force_s[1:] + late_s, force_s[0])])
        motion = simulate_motion(truth, shifted_s, force_n, time_s, stops=stops, initial=initial)
        sides.append(motion.position_m)
    return np.asarray((sides[0] - sides[1]) / 2.0e-6)


def relative_half_width(symbol: str, std_error: float, truth: ValveParameters) -> float:
    """Half of the 95 % interval as a share of the value; of F_s for F_0, which may be zero."""
    values = truth.by_symbol()
    scale = max(abs(values["F_0"]), values["F_s"]) if symbol == "F_0" else values[symbol]
    return 1.959964 * std_error / scale if scale > 0.0 else math.inf
