"""``[valves.health]``: what a valve must do, and how far it may change. docs/health.md says why each default."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from valve.errors import ConfigurationError, refuse
from valve.messages import say


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """What is asked of a valve from its first test on, and how far it may change against its baseline.

    Changes are in percent of the baseline, or of what the name says; None asks for nothing. 0 is refused: nothing
    repeats exactly. Raises ConfigurationError where a limit is not above 0.
    """

    travel_end_percent: float = 5.0  # of rated travel: how far from an end the stem may stay with the signal there
    dead_band_percent: float = 30.0  # of the signal's span
    friction_share_percent: float = 15.0  # of the force that the signal's span gives
    repeatability_percent: float = 10.0  # of F_s: one standard deviation from breakaway to breakaway
    cause_effect_percent: float = 1.0  # of rated travel: a cause that moves the stem by less is a remark
    transducer_lag_s: float = 0.3
    response_time_s: float | None = None  # T63 of a step test
    stroke_time_max_s: float | None = None  # T98 of a step over most of the travel, either way
    seat_load_percent: float | None = None  # of the force that the signal's span gives: at least
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
                say(
                    "health_not_positive",
                    "{key} is {value:g}, it must be above 0: correct it",
                    key=f"health.{name}",
                    value=value,
                )
                for name, value in values.items()
                if value is not None and not (math.isfinite(value) and value > 0.0)
            ),
        )
