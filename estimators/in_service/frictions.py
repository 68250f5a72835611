"""Friction, breakaway and spring as figures: in the signal's unit, in N, and in percent of the span."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.in_service.balance import DOWN, MOTION, SPRING, UP, Balance
from estimators.in_service.events import Kind, Observations
from estimators.in_service.figure import (
    COMMON_SHARE,
    HELD_SHARE,
    HIDDEN,
    LEAST_REPEATS,
    WIDEST,
    Figure,
    estimated,
    not_known,
)
from estimators.in_service.result import Input, Scale
from estimators.in_service.rows import Rows
from valve.messages import say
from valve.nameplate import Nameplate
from valve.recording import FloatArray

_SPRING_KNOWN: Final = 0.15  # standard error by value: an interval of 30 %
_REPORTED_SHARE: Final = 1.0  # of half a reported change: all reports are late in the same sense
_SIGNAL_SHARE: Final = 0.5  # of the signal's rapid swing: the part of it that is air moves a stem, a gauge's does not
_NEEDS_AREA: Final = say("needs_area", "needs the diaphragm's area: give a nameplate")
_NEEDS_RANGE: Final = say(
    "needs_area_and_range", "needs the diaphragm's area and the signal's pressure range: give a nameplate"
)
_NEEDS_SPAN: Final = say("needs_span", "needs the signal's range or the bench set: give a nameplate")
_NEEDS_TRAVEL: Final = say(
    "needs_area_and_travel", "needs the diaphragm's area, the travel and a pressure: give a nameplate"
)
_NO_SLOPE: Final = say("no_slope", "the moves were too small or too few to show a slope: wider moves would tell")
PERCENTS: Final = {
    "friction_percent": "friction_signal",
    "breakaway_percent": "breakaway_signal",
    "dead_band_percent": "dead_band",
    "stick_band_percent": "stick_band",
    "slip_jump_percent": "slip_jump",
}


def frictions(found: Balance | None, rows: Rows, seen: Observations, unit: str) -> dict[str, Figure]:
    """Friction in motion and at breakaway in the signal's unit."""
    names = ("friction", "breakaway", "breakaway_up", "breakaway_down")
    ways = {sign: int(((seen.kind == Kind.MOTION) & (seen.sign == sign)).sum()) for sign in (1, -1)}
    if found is None:
        few = say(
            "few_moves",
            "{up} moves up and {down} down, both directions and {needed} moves are needed: record for longer",
            up=ways[1],
            down=ways[-1],
            needed=LEAST_REPEATS,
        )
        return {f"{name}_signal": not_known(unit, few) for name in names}
    spring = abs(float(found.values[SPRING]))
    open_rows = (HELD_SHARE if rows.is_held else COMMON_SHARE) * float(np.mean(seen.half_width))
    share = _SIGNAL_SHARE if rows.is_even else _REPORTED_SHARE
    common = np.hypot(np.hypot(spring * rows.noise, share * rows.signal_noise), open_rows)
    away = {sign: int(((seen.kind == Kind.BREAKAWAY) & (seen.sign == sign)).sum()) for sign in (1, -1)}
    asked = {
        "friction": (_weights({MOTION: 1.0}), min(ways.values()), ways[1] + ways[-1]),
        "breakaway": (_weights({UP: 0.5, DOWN: 0.5}), min(away.values()), away[1] + away[-1]),
        "breakaway_up": (_weights({UP: 1.0}), away[1], away[1]),
        "breakaway_down": (_weights({DOWN: 1.0}), away[-1], away[-1]),
    }
    figures = {}
    for name, (weights, least, count) in asked.items():
        if least < (2 if name == "friction" else LEAST_REPEATS):
            few = say(
                "few_in_direction",
                "{count} of these in a direction, {needed} are needed: record for longer",
                count=least,
                needed=LEAST_REPEATS,
            )
            figures[f"{name}_signal"] = not_known(unit, few, count)
            continue
        value, error = _combined(found, weights)
        scatter = found.scatter if name != "friction" else None
        figures[f"{name}_signal"] = estimated(
            value,
            float(np.hypot(error, common)),
            unit,
            found.freedom,
            count=count,
            scatter=scatter,
            too_wide=_too_wide(count, error, float(common)),
        )
    return figures


def _too_wide(count: int, error: float, common: float) -> str:
    """Why a friction is known to worse than 30 %, by the larger of its two errors."""
    if common > error:
        return HIDDEN
    return say(
        "moves_leave_open",
        "{count} moves leave it open by more than {limit:.0f %}: more or wider moves, or the bench set",
        count=count,
        limit=WIDEST,
    )


def _weights(by_column: dict[int, float]) -> FloatArray:
    weights = np.zeros(5)
    for column, weight in by_column.items():
        weights[column] = weight
    return weights


def _combined(found: Balance, weights: FloatArray) -> tuple[float, float]:
    used = np.flatnonzero(weights)
    part = Balance(found.values[used], found.covariance[np.ix_(used, used)], found.freedom, found.scatter, 0.0, 0.0)
    return part.combined(weights[used])


def forces(figures: dict[str, Figure], unit: str, scale: Scale) -> dict[str, Figure]:
    """Frictions in N."""
    found = {}
    for name in ("friction", "breakaway", "breakaway_up", "breakaway_down"):
        one = figures[f"{name}_signal"]
        if unit == "N":
            found[name] = one
        elif unit == "Pa" and scale.area_m2 is not None:
            found[name] = one.times(scale.area_m2, "N")
        else:
            found[name] = not_known("N", one.note or (_NEEDS_AREA if unit == "Pa" else _NEEDS_RANGE), one.count)
    return found


def percents_of_span(
    figures: dict[str, Figure], kind: Input, nameplate: Nameplate | None, unit: str
) -> dict[str, Figure]:
    """Bands and friction in percent of the span: the signal's range, else the bench set, as the signature has it."""
    span: float | None = None
    if unit == "%":
        span = 100.0
    elif nameplate is not None and unit == "Pa":
        ends = nameplate.signal.range_pa if nameplate.signal is not None else nameplate.actuator.bench_set_pa
        span = None if ends is None else ends[1] - ends[0]
    elif nameplate is not None and kind is Input.FORCE and nameplate.nominal_spring_rate_n_per_m is not None:
        span = nameplate.nominal_spring_rate_n_per_m * nameplate.actuator.travel_m
    percents = {}
    for key, name in PERCENTS.items():
        one = figures[name]
        percents[key] = (
            one.times(100.0 / span, "percent")
            if span is not None
            else not_known("percent", one.note or _NEEDS_SPAN, one.count)
        )
    return percents


def spring_rate(found: Balance | None, rows: Rows, seen: Observations, unit: str, scale: Scale) -> Figure:
    """Spring rate in N/m, where the moves alone show it; values that an export holds leave the slope open, too."""
    if unit == "%" or (unit == "Pa" and scale.area_m2 is None) or scale.is_share:
        return not_known("N/m", _NEEDS_TRAVEL)
    if found is None or not found.spring_error <= _SPRING_KNOWN * abs(found.spring):
        return not_known("N/m", _NO_SLOPE)
    late = float(np.mean(seen.half_width)) / float(np.ptp(seen.position)) if rows.is_held else 0.0
    factor = 1.0 if unit == "N" or scale.area_m2 is None else scale.area_m2
    return estimated(
        found.spring * factor,
        float(np.hypot(found.spring_error, late)) * factor,
        "N/m",
        found.freedom,
        count=0,
        too_wide=_NO_SLOPE,
    )
