"""``[valves.health]``: how far a valve may change before somebody is told. docs/health.md says why each default."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from valve.errors import ConfigurationError, refuse


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """Changes against the baseline in percent of it, or of what the name says; 0 is refused: nothing repeats exactly.

    Raises ConfigurationError where a limit is not above 0.
    """

    friction_up_percent: float = 25.0
    friction_down_percent: float = 25.0
    spring_rate_percent: float = 5.0
    bench_set_percent: float = 5.0  # of the pressure span
    travel_lost_percent: float = 3.0  # of rated travel
    travel_failed_percent: float = 50.0  # of rated travel
    breakaway_share_percent: float = 80.0  # of the pressure that there is
    response_slower_percent: float = 50.0
    response_slower_s: float = 0.1  # and at least this
    forecast_days: float = 30.0
    stale_days: float = 35.0
    stale_checks: int = 3  # times of a schedule that the valve is in

    def __post_init__(self) -> None:
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        refuse(
            ConfigurationError,
            (
                f"health.{name} is {value:g}, it must be above 0: correct it"
                for name, value in values.items()
                if not (math.isfinite(value) and value > 0.0)
            ),
        )
