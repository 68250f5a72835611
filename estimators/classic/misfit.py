"""The misfit of an estimate: its valve, followed exactly, beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import Estimate
from estimators.classic.transients import Transients
from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray, Samples
from valve.errors import ValveError
from valve.motion import StemState, simulate_motion
from valve.parameters import TravelStops, ValveParameters

# Own choice: far below any ramp, where DV has no influence on the motion (Karnopp 1985).
_LIMIT_SPEED_SHARE: Final = 0.01
_START_ROWS: Final = 50
_MOST_EVENTS: Final = 100_000


@dataclass(frozen=True, slots=True)
class Fallback:
    """What stands in for a value that the estimate does not have: m in kg, F_v in N s/m, and a speed for DV in m/s."""

    mass_kg: float
    viscous_n_s_per_m: float
    moving_speed: float

    @classmethod
    def of(cls, motion: RecordedMotion, transients: Transients, balance: Balance) -> Fallback:
        """The nameplate's mass, or one that makes the stem critically damped; the middle of what F_v may be."""
        viscous = max(0.0, transients.viscous_used[0])
        spring = balance.spring[0]
        mass_kg = motion.moving_mass_kg
        if mass_kg is None:
            mass_kg = viscous**2 / (4.0 * spring) if spring > 0.0 and viscous > 0.0 else 1.0
        return cls(mass_kg, viscous, motion.phases.moving_speed)

    def by_symbol(self) -> dict[str, float]:
        """Return the values by symbol; F_0 is 0 where the method has none."""
        return {
            "m": self.mass_kg,
            "F_v": max(0.0, self.viscous_n_s_per_m),
            "DV": _LIMIT_SPEED_SHARE * self.moving_speed,
            "F_0": 0.0,
        }


def simulated_position(
    parameters: ValveParameters, samples: Samples, first_moving_row: int, stops: TravelStops | None
) -> FloatArray | None:
    """Position that this valve takes under the recorded force, m, shape (n,); None where it cannot be followed.

    It starts at rest at the mean of what was measured before the first motion; across a gap the force is drawn
    straight.
    """
    rows = max(1, min(_START_ROWS, first_moving_row))
    start_m = float(np.mean(samples.position_m[:rows]))
    if stops is not None:
        start_m = min(max(start_m, stops.low_m), stops.high_m)
    try:
        motion = simulate_motion(
            parameters,
            samples.time_s,
            samples.force_n,
            samples.time_s,
            stops=stops,
            initial=StemState(start_m),
            most_events=_MOST_EVENTS,
        )
    except ValveError:
        return None
    return motion.position_m


def with_stand_ins(estimate: Estimate, fallback: Fallback) -> Estimate:
    """Return the estimate with what stands in for missing values in its diagnostics, where that makes a valve."""
    stand_ins = {symbol: value for symbol, value in fallback.by_symbol().items() if estimate.value(symbol) is None}
    try:
        valve = estimate.valve_parameters(stand_ins)
    except ValveError:
        return estimate
    if valve is None:
        return estimate
    return replace(estimate, diagnostics={**estimate.diagnostics, "stand_ins": stand_ins})


def misfit_m(estimate: Estimate, motion: RecordedMotion) -> float | None:
    """Root mean square of measured minus followed position with the estimate's values, m; None where none follows."""
    stand_ins = estimate.diagnostics.get("stand_ins")
    valve = None if stand_ins is None else estimate.valve_parameters(stand_ins)
    if valve is None:
        return None
    samples = motion.samples
    position_m = simulated_position(valve, samples, motion.first_moving_row, motion.stops)
    if position_m is None or not bool(np.isfinite(position_m).all()):
        return None
    return float(np.sqrt(np.mean((position_m - samples.position_m) ** 2)))
