"""What a force that is recorded late leaves of friction: a gauge that lags rounds corners, which no delay does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from estimators.base import NORMAL_95
from estimators.likelihood.delay import DELAY
from estimators.likelihood.ramps import Ramps
from estimators.likelihood.stand_ins import NEAR_SPEED

_OF_CLOCKS: Final = 2.0  # periods: two clocks of one file are no further apart
_SELDOM_LATER_S: Final = 0.02  # of a gauge that nothing is known of


def known_lateness_s(values: Mapping[str, float], period_s: float, *, is_delayed: bool) -> float:
    """Return how much later than it acted the force was recorded, s, of a fit that is sure of it; 0 where it was not.

    What two clocks may be apart is a delay, and fitted as one.
    """
    late_s = -values[DELAY] if is_delayed else 0.0
    return late_s if late_s > _OF_CLOCKS * period_s else 0.0


def hidden_lateness_s(values: Mapping[str, float], ramps: Ramps) -> float:
    """Return how late a force may be that no delay was found of, s, in a file that does not say how it was read.

    On ramps of one rate a DV near their speed does what a late force does: one of 5 ms raises a DV up to 66 times, and
    no misfit tells of it.
    """
    if len(ramps.rates_n_per_s) != 1:
        return 0.0
    return _SELDOM_LATER_S if values["DV"] > NEAR_SPEED * ramps.rates_n_per_s[0] / values["k"] else 0.0


def least_errors(late_s: float, rate_n_per_s: float) -> dict[str, float]:
    """Return the least standard errors by symbol, N, of a fit whose force was recorded ``late_s`` after it acted.

    A delay alone would leave none. A gauge that lags is late by the same time while the force is steady and by less at
    a corner, after which the stem breaks away: the frictions are known to what the force changes in that time on the
    slowest ramp, at ``rate_n_per_s``.
    """
    force_n = rate_n_per_s * late_s / NORMAL_95
    return {"F_c": force_n, "F_s": force_n}
