"""What a valve did in service, in words: a few sentences first, then the lines of a table."""

from __future__ import annotations

from typing import Final

from estimators.in_service.figure import Figure
from estimators.in_service.result import Input, Watched
from service.words.plain_numbers import plus_minus
from service.words.units import UnitSystem, measured, shown_unit

_NAMES: Final = {
    "friction": "Friction in motion",
    "breakaway": "Breakaway",
    "breakaway_up": "Breakaway up",
    "breakaway_down": "Breakaway down",
    "dead_band": "Dead band",
    "stick_band": "Stick band",
    "slip_jump": "Slip jump",
    "slip": "Slip of the stem",
    "spring_rate": "Spring rate",
    "lag": "Lag of the pressure",
    "stem_lag": "Lag of the stem",
}
_SYSTEM: Final = UnitSystem.SI
_BAR_LENGTH: Final = 20  # characters of a bar of the histogram that stands for all of the time
_DRIVERS: Final = {Input.FORCE: "force", Input.PRESSURE: "pressure", Input.COMMAND: "command"}


def verdict(found: Watched) -> str:
    """Return friction, breakaway with its scatter and dead band, one sentence each."""
    friction, away, dead = (_best(found, name) for name in ("friction", "breakaway", "dead_band"))
    if friction.value is None and dead.value is None and friction.note == dead.note:
        return f"Friction and dead band are not known: {friction.note}."
    words = [_sentence("Friction", friction, _percent(found, "friction"))]
    if away.value is not None:
        words.append(f"Breakaway {_value(away)}{_scatter(away)}.")
    words.append(_sentence("Dead band", dead, _percent(found, "dead_band")))
    return " ".join(words)


def figure_lines(found: Watched) -> list[tuple[str, str, str, str]]:
    """Return name, value, percent of span and scatter of each figure that is known."""
    lines = []
    for key, name in _NAMES.items():
        one = _best(found, key)
        if one.value is not None:
            scatter = f"± {100.0 * one.scatter / abs(one.value):.2g} %" if one.scatter else ""
            lines.append((name, _value(one), _percent(found, key), scatter))
    return lines


def unknown_lines(found: Watched) -> list[str]:
    """Return the figures that are not known, those of one reason together, with what would be needed."""
    by_reason: dict[str, list[str]] = {}
    for key, name in _NAMES.items():
        one = found.figures[key]
        if one.value is None and key != "stem_lag":
            in_signal = _best(found, key).value is not None
            by_reason.setdefault(one.note, []).append(f"{name.lower()}{' in N' if in_signal else ''}")
    return [f"Not known: {', '.join(names)}: {reason}." for reason, names in by_reason.items()]


def histogram_lines(found: Watched) -> list[tuple[str, str]]:
    """Return where the stem stood: range of travel, and a bar with the share of the time."""
    lines = []
    for low, high, share in zip(found.travel.edges[:-1], found.travel.edges[1:], found.travel.shares, strict=True):
        if share >= 0.0005:
            bar = "█" * max(1, round(_BAR_LENGTH * float(share)))
            lines.append((f"{_place(found, low, unit=False)} to {_place(found, high)}", f"{bar} {100.0 * share:.1f} %"))
    return lines


def travel_lines(found: Watched) -> list[tuple[str, str]]:
    """Return travel, cycles, position and record, each with its name."""
    travel, hours = found.travel, found.covered_s / 3600.0
    factor = 100.0 if found.position_unit == "%" else 1.0
    unit = "percent" if found.position_unit == "%" else "m"
    total = Figure(travel.total * factor, unit, (travel.total_ci95[0] * factor, travel.total_ci95[1] * factor))
    noise = shown_unit(unit, _SYSTEM)
    places = f"{_place(found, travel.lowest, unit=False)} to {_place(found, travel.highest)}"
    rows = f"{found.rows} rows, {found.period_s:.3g} s apart" if found.is_even else f"{found.rows} uneven rows"
    return [
        (
            "Travel",
            f"{_value(total)}, {_place(found, travel.per_hour)} an hour, {travel.moves} moves",
        ),
        ("Cycles", f"{travel.cycles} changes of direction, {round(travel.cycles / hours, 1):g} an hour"),
        (
            "Position",
            f"{places}, mean {_place(found, travel.mean)}, noise {noise.shown(found.position_noise):.2g} {noise.name}",
        ),
        ("Record", f"{hours:.3g} h, {rows}, {found.gaps} gaps, driven by the {_DRIVERS[found.driven_by]}"),
    ]


def _place(found: Watched, position: float, *, unit: bool = True) -> str:
    if found.position_unit == "%":
        shown, name = 100.0 * position, "%"
    else:
        metric = shown_unit("m", _SYSTEM)
        shown, name = metric.shown(position), metric.name
    return f"{round(shown, 1) + 0.0:g} {name}" if unit else f"{round(shown, 1) + 0.0:g}"


def _best(found: Watched, name: str) -> Figure:
    """Return the figure in N where it is known there, else in the signal's unit."""
    figures = found.figures
    one = figures[name]
    in_signal = figures.get(f"{name}_signal")
    return in_signal if one.value is None and in_signal is not None and in_signal.value is not None else one


def _percent(found: Watched, name: str) -> str:
    one = found.figures.get(f"{name}_percent", Figure(None, "percent"))
    own = _best(found, name)
    if one.value is None or own.unit == "%":
        return ""
    return f"{plus_minus(one.value, None)} %"


def _value(one: Figure) -> str:
    return measured(one.value, one.ci95, "percent" if one.unit == "%" else one.unit, _SYSTEM)


def _scatter(one: Figure) -> str:
    if one.value is None or not one.scatter:
        return ""
    return f", from breakaway to breakaway ± {100.0 * one.scatter / abs(one.value):.2g} %"


def _sentence(name: str, one: Figure, percent: str) -> str:
    if one.value is None:
        return f"{name} is not known: {one.note}."
    return f"{name} {_value(one)}{f' ({percent} of span)' if percent else ''}."
