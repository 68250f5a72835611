"""What a valve did in service, in words: a few sentences first, then the lines of a table."""

from __future__ import annotations

from typing import Final

from estimators.in_service.figure import Figure
from estimators.in_service.result import Input, Watched
from service.words.plain_numbers import plus_minus
from service.words.units import UnitSystem, measured_said, shown_unit
from valve.messages import Message, joined, say

_NAMES: Final = {
    "friction": say("friction_in_service", "Friction in motion"),
    "breakaway": say("breakaway_in_service", "Breakaway"),
    "breakaway_up": say("breakaway_up_in_service", "Breakaway up"),
    "breakaway_down": say("breakaway_down_in_service", "Breakaway down"),
    "dead_band": say("dead_band_in_service", "Dead band"),
    "stick_band": say("stick_band_in_service", "Stick band"),
    "slip_jump": say("slip_jump_in_service", "Slip jump"),
    "slip": say("slip_in_service", "Slip of the stem"),
    "spring_rate": say("spring_rate_in_service", "Spring rate"),
    "lag": say("lag_in_service", "Lag of the pressure"),
    "stem_lag": say("stem_lag_in_service", "Lag of the stem"),
}
_SYSTEM: Final = UnitSystem.SI
_BAR_LENGTH: Final = 20  # characters of a bar of the histogram that stands for all of the time
_DRIVERS: Final = {
    Input.FORCE: say("force", "force"),
    Input.PRESSURE: say("pressure", "pressure"),
    Input.COMMAND: say("command", "command"),
}


def verdict(found: Watched) -> Message:
    """Return friction, breakaway with its scatter and dead band, one sentence each."""
    friction, away, dead = (_best(found, name) for name in ("friction", "breakaway", "dead_band"))
    if friction.value is None and dead.value is None and friction.note == dead.note:
        return say("neither_known", "Friction and dead band are not known: {why}.", why=friction.note)
    words = [_sentence(say("watched_friction", "Friction"), friction, _percent(found, "friction"))]
    if away.value is not None:
        words.append(_breakaway(away))
    words.append(_sentence(_NAMES["dead_band"], dead, _percent(found, "dead_band")))
    return joined(" ", words)


def figure_lines(found: Watched) -> list[tuple[str, str, str, str]]:
    """Return name, value, percent of span and scatter of each figure that is known."""
    lines: list[tuple[str, str, str, str]] = []
    for key, name in _NAMES.items():
        one = _best(found, key)
        if one.value is not None:
            scatter = say("scatter", "± {share:.2g %}", share=one.scatter / abs(one.value)) if one.scatter else ""
            lines.append((name, _value(one), _percent(found, key), scatter))
    return lines


def unknown_lines(found: Watched) -> list[Message]:
    """Return the figures that are not known, those of one reason together, with what would be needed."""
    by_reason: dict[str, list[Message]] = {}
    for key, name in _NAMES.items():
        one = found.figures[key]
        if one.value is None and key != "stem_lag":
            named = name.formed("clause")
            if _best(found, key).value is not None:
                named = say("in_newton", "{figure} in N", figure=named)
            by_reason.setdefault(one.note, []).append(named)
    return [
        say("figures_not_known", "Not known: {figures:, }: {why}.", figures=tuple(names), why=reason)
        for reason, names in by_reason.items()
    ]


def histogram_lines(found: Watched) -> list[tuple[str, str]]:
    """Return where the stem stood: range of travel, and a bar with the share of the time."""
    lines: list[tuple[str, str]] = []
    for low, high, share in zip(found.travel.edges[:-1], found.travel.edges[1:], found.travel.shares, strict=True):
        if share >= 0.0005:
            bar = "█" * max(1, round(_BAR_LENGTH * float(share)))
            lines.append((_range(found, low, high), f"{bar} {100.0 * share:.1f} %"))
    return lines


def travel_lines(found: Watched) -> list[tuple[Message, Message]]:
    """Return travel, cycles, position and record, each with its name."""
    travel, hours = found.travel, found.covered_s / 3600.0
    factor = 100.0 if found.position_unit == "%" else 1.0
    unit = "percent" if found.position_unit == "%" else "m"
    total = Figure(travel.total * factor, unit, (travel.total_ci95[0] * factor, travel.total_ci95[1] * factor))
    noise = shown_unit(unit, _SYSTEM)
    rows = (
        say("even_rows", "{count} rows, {period:.3g} s apart", count=found.rows, period=found.period_s)
        if found.is_even
        else say("uneven_rows", "{count} uneven rows", count=found.rows)
    )
    return [
        (
            say("travel", "Travel"),
            say(
                "travel_in_service",
                "{total}, {per_hour} an hour, {moves} moves",
                total=_value(total),
                per_hour=_place(found, travel.per_hour),
                moves=travel.moves,
            ),
        ),
        (
            say("watched_cycles", "Cycles"),
            say(
                "cycles_in_service",
                "{cycles} changes of direction, {per_hour:g} an hour",
                cycles=travel.cycles,
                per_hour=round(travel.cycles / hours, 1),
            ),
        ),
        (
            say("position_in_service", "Position"),
            say(
                "places_in_service",
                "{places}, mean {mean}, noise {noise:.2g} {unit}",
                places=_range(found, travel.lowest, travel.highest),
                mean=_place(found, travel.mean),
                noise=noise.shown(found.position_noise),
                unit=noise.name,
            ),
        ),
        (
            say("record", "Record"),
            say(
                "record_in_service",
                "{hours:.3g} h, {rows}, {gaps} gaps, driven by the {channel}",
                hours=hours,
                rows=rows,
                gaps=found.gaps,
                channel=_DRIVERS[found.driven_by],
            ),
        ),
    ]


def _range(found: Watched, low: float, high: float) -> Message:
    return say("watched_from_to", "{low} to {high}", low=_place(found, low, unit=False), high=_place(found, high))


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
    return measured_said(one.value, one.ci95, "percent" if one.unit == "%" else one.unit)


def _breakaway(one: Figure) -> Message:
    if one.value is None or not one.scatter:
        return say("breakaway_without_scatter", "Breakaway {value}.", value=_value(one))
    return say(
        "breakaway_with_scatter",
        "Breakaway {value}, from breakaway to breakaway ± {scatter:.2g %}.",
        value=_value(one),
        scatter=one.scatter / abs(one.value),
    )


def _sentence(name: Message, one: Figure, percent: str) -> Message:
    if one.value is None:
        return say("figure_not_known", "{name} is not known: {why}.", name=name, why=one.note)
    if not percent:
        return say("figure_known", "{name} {value}.", name=name, value=_value(one))
    return say(
        "figure_known_of_span", "{name} {value} ({percent} of span).", name=name, value=_value(one), percent=percent
    )
