"""The balance of a record: a first one gives the spring by which rests are told from slow sliding, then the last."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.in_service.balance import SPRING, Balance, balanced
from estimators.in_service.events import Kind, Observations, observations_of, of_one_motion
from estimators.in_service.moves import DRIVEN_BANDS, Moves, without_false_rests
from estimators.in_service.result import COUNTED_FROM_M, Input, Scale
from estimators.in_service.rows import Rows
from valve.nameplate import Action, Nameplate

_SPRING_TOLERANCE: Final = 0.1  # of a nameplate's spring rate, one standard deviation: bench sets are set by hand
_COMMAND_TOLERANCE: Final = 0.2  # the same of "a full signal is a full travel", where no nameplate says more


def spring_prior(kind: Input, nameplate: Nameplate | None, scale: Scale, unit: str) -> tuple[float, float] | None:
    """Spring rate of the nameplate in signal by position, and its standard deviation."""
    if nameplate is not None and nameplate.actuator.action is Action.SPRING:
        length = COUNTED_FROM_M if scale.is_share else nameplate.actuator.travel_m
        bench, signal = nameplate.actuator.bench_set_pa, nameplate.signal
        span_pa = bench[1] - bench[0] if bench is not None else None
        if span_pa is None and kind is Input.COMMAND and signal is not None:
            span_pa = signal.range_pa[1] - signal.range_pa[0]
        if span_pa is not None and unit == "Pa":
            return span_pa / length, _SPRING_TOLERANCE * span_pa / length
        rate = nameplate.nominal_spring_rate_n_per_m
        if rate is not None and unit == "N":
            return rate, _SPRING_TOLERANCE * rate
    if unit == "%" and scale.is_share:
        return 100.0 / COUNTED_FROM_M, _COMMAND_TOLERANCE * 100.0 / COUNTED_FROM_M
    return None


def _swept(moves: Moves) -> tuple[tuple[float, float], tuple[float, float]]:
    """From where to where the stem moved up, and down."""
    low, high = np.minimum(moves.from_level, moves.to_level), np.maximum(moves.from_level, moves.to_level)
    ranges = []
    for sign in (1, -1):
        own = (moves.began == sign) | (moves.ended == sign)
        ranges.append((float(low[own].min()), float(high[own].max())) if own.any() else (float(low.min()),) * 2)
    return ranges[0], ranges[1]


def settled(
    rows: Rows, moves: Moves, seen: Observations, length: float, prior: tuple[float, float] | None
) -> tuple[Balance | None, Moves, Observations]:
    """Balance of the moves; a first one gives the spring by which rests are told from slow sliding."""
    first = balanced(seen, travel=length, swept=_swept(moves), spring=prior)
    spring = float("nan") if first is None else float(first.values[SPRING])
    if first is None or not spring > 0.0:
        return first, moves, seen
    joined = without_false_rests(moves, rows, spring)
    seen = observations_of(rows, joined, spring)
    driven = (seen.kind == Kind.MOTION) | (seen.driven >= DRIVEN_BANDS * spring * joined.band)
    seen = seen.chosen(driven)
    return balanced(of_one_motion(seen), travel=length, swept=_swept(joined), spring=prior), joined, seen
