"""Trends: one figure of a valve over its tests, with intervals, the baseline and the limits."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import Any, Final

import matplotlib.dates as mdates
from matplotlib.axes import Axes

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.plant_clock import zone_words
from service.words.units import UnitSystem, measured, shown_unit


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One test's value of one figure, SI, with its 95 % interval where there is one."""

    at: datetime
    value: float
    ci95: tuple[float, float] | None = None
    mark: str = ""


@dataclass(frozen=True, slots=True)
class Ahead:
    """How a figure runs on from its last test: the line's level there, SI, and when it meets which limit.

    The ends of the 95 % interval are None where they are not within five years.
    """

    level: float
    limit: float
    at: datetime
    earliest: datetime | None
    latest: datetime | None


@dataclass(frozen=True, slots=True)
class Trend:
    """One figure over the tests of a valve, oldest first; ``limits`` are where it is judged abnormal.

    ``ahead`` is the forecast by its last test. ``watched`` are days in service beside the tests, which no limit judges.
    """

    name: str
    meaning: str
    unit: str
    points: tuple[TrendPoint, ...]
    baseline: float | None = None
    limits: tuple[float | None, float | None] = (None, None)
    ahead: Ahead | None = None
    watched: tuple[TrendPoint, ...] = ()


_COLUMNS: Final = 2
_WIDE_IN: Final = 7.2
_NARROW_IN: Final = 4.0  # of a phone: its text is read at 320 pixels
_LETTERS_AN_INCH: Final = 15.0  # of the words below the panels
_BARS: Final = "Bars: 95 % interval of each test, without what the figure differs by from test to test."
_AHEAD: Final = "Dotted: the trend on to its limit, with the 95 % interval of when it is met."
_WATCHED: Final = "Open circles: days in service, watched and not tested."
_FARTHEST: Final = 2.0  # times what the tests span: a forecast that is further would leave them no room
_FRICTION: Final = "The bar of friction holds what friction varies by within its test."


def trends_picture(
    trends: Sequence[Trend], system: UnitSystem, zone: tzinfo | None, *, narrow: bool = False
) -> Picture | None:
    """Return the trends by the clock of ``zone`` (None: this machine's), and below them what their bars hold.

    Two beside each other, or below each other if narrow. None where neither a test nor a day in service gave a figure.
    """
    shown = [trend for trend in trends if trend.points or trend.watched]
    if not shown:
        return None
    columns = 1 if narrow else min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    with settings():
        width_in = _NARROW_IN if narrow else _WIDE_IN
        below = textwrap.wrap(_below(shown, zone), int(_LETTERS_AN_INCH * width_in))
        figure = sheet(width_in, 2.5 * rows + 0.16 * len(below))
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, trend in zip(panels.flat, shown, strict=False):
            _draw(axes, trend, system, zone)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        figure.supxlabel("\n".join(below), x=0.01, ha="left", fontsize=9, color=SOFT)
    said = "; ".join(_in_words(trend, system, zone) for trend in shown)
    return Picture(figure, "Trend of the valve over its tests", f"{said}. {_below(shown, zone)}")


def trends_svg(trends: Sequence[Trend], system: UnitSystem, zone: tzinfo | None, narrow: bool) -> str | None:
    """Return the trends as SVG text."""
    picture = trends_picture(trends, system, zone, narrow=narrow)
    return None if picture is None else svg_text(picture)


def _below(trends: Sequence[Trend], zone: tzinfo | None) -> str:
    """Say what the bars hold and whose clock the time is."""
    has_bars = [trend.name for trend in trends if any(point.ci95 is not None for point in trend.points)]
    watched = _WATCHED if any(trend.watched for trend in trends) else ""
    bars = _BARS if has_bars else ""
    friction = _FRICTION if any(name.startswith("friction") for name in has_bars) else ""
    ahead = _AHEAD if any(_shown_ahead(trend) is not None for trend in trends) else ""
    clock = f"Time: {zone_words((trends[0].points or trends[0].watched)[-1].at, zone)}."
    return " ".join(words for words in (bars, friction, ahead, watched, clock) if words)


def _shown_ahead(trend: Trend) -> Ahead | None:
    """Return the forecast where the picture has room for it."""
    ahead = trend.ahead
    if ahead is None or not trend.points:
        return None
    first, last = trend.points[0].at, trend.points[-1].at
    return None if ahead.at - last > _FARTHEST * (last - first) else ahead


def _in_words(trend: Trend, system: UnitSystem, zone: tzinfo | None) -> str:
    watched = ""
    if trend.watched:
        newest = trend.watched[-1]
        watched = f"{trend.meaning} in service is {measured(newest.value, newest.ci95, trend.unit, system)}"
    if not trend.points:
        return watched
    tested = _tested_in_words(trend, system, zone)
    return f"{tested}; {watched}" if watched else tested


def _tested_in_words(trend: Trend, system: UnitSystem, zone: tzinfo | None) -> str:
    first, last = trend.points[0], trend.points[-1]
    now = f"{trend.meaning} is {measured(last.value, last.ci95, trend.unit, system)}"
    if len(trend.points) == 1:
        return now
    return (
        f"{now}, it was {measured(first.value, first.ci95, trend.unit, system)} on {first.at.astimezone(zone):%Y-%m-%d}"
    )


def _draw(axes: Axes, trend: Trend, system: UnitSystem, zone: tzinfo | None) -> None:
    unit = shown_unit(trend.unit, system)
    times = [_clock(point.at, zone) for point in trend.points]
    values = [unit.shown(point.value) for point in trend.points]
    axes.plot(times, values, "-", color=BLUE, linewidth=1.2, zorder=2)
    for time, value, point in zip(times, values, trend.points, strict=True):
        if point.ci95 is not None:
            axes.plot([time, time], [unit.shown(point.ci95[0]), unit.shown(point.ci95[1])], color=BLUE, linewidth=2.4)
        axes.plot([time], [value], "o" if not point.mark else "s", color=BLUE, markersize=5.0, zorder=3)
    seen = [(_clock(point.at, zone), unit.shown(point.value), point.ci95) for point in trend.watched]
    for time, value, ci95 in seen:
        if ci95 is not None:
            axes.plot([time, time], [unit.shown(end) for end in ci95], color=SOFT, linewidth=1.2, zorder=1)
        axes.plot([time], [value], "o", color=SOFT, markerfacecolor="none", markersize=4.5, zorder=1)
    if trend.baseline is not None:
        axes.axhline(unit.shown(trend.baseline), color=SOFT, linewidth=1.0, linestyle="--")
        axes.annotate("baseline", (0.01, unit.shown(trend.baseline)), **_LABEL, color=SOFT)
    for limit, word in zip(trend.limits, ("low limit", "high limit"), strict=True):
        if limit is not None:
            axes.axhline(unit.shown(limit), color=RED, linewidth=1.2, linestyle="-.")
            axes.annotate(word, (0.01, unit.shown(limit)), **(_ABOVE if word == "low limit" else _LABEL), color=RED)
    tidy(axes)
    axes.set_title(f"{trend.meaning}, {unit.name}", fontsize=11, loc="left", color=INK)
    _scale(axes, values + [value for _, value, _ in seen])
    locator = mdates.AutoDateLocator(minticks=2, maxticks=6)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    ahead = _shown_ahead(trend)
    if ahead is not None:
        _draw_ahead(axes, times, ahead, unit.shown, zone)
    every = times + [time for time, _, _ in seen]
    if max(every) - min(every) < 1.0:
        axes.set_xlim(min(every) - 1.0, max(every) + 1.0)


def _draw_ahead(
    axes: Axes, times: Sequence[float], ahead: Ahead, shown: Callable[[float], float], zone: tzinfo | None
) -> None:
    """Draw the line on to its limit, and the interval of when it is met as a wedge; the wedge may be cut off."""
    last = times[-1]
    at, earliest, latest = (
        None if one is None else _clock(one, zone) for one in (ahead.at, ahead.earliest, ahead.latest)
    )
    assert at is not None
    end = max(at, last + 0.5 * (last - times[0]))
    level, limit = shown(ahead.level), shown(ahead.limit)
    axes.plot([last, at], [level, limit], ":", color=BLUE, linewidth=1.6, zorder=2)
    if earliest is not None:
        beyond = last + 10.0 * (end - last) if latest is None else latest
        axes.fill([last, earliest, beyond], [level, limit, limit], color=BLUE, alpha=0.25, linewidth=0.0, zorder=1)
    pad = 0.04 * (end - times[0])
    axes.set_xlim(times[0] - pad, min(end, max(at, end if latest is None else latest)) + pad)
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, limit - 0.02 * abs(limit)), max(high, limit + 0.02 * abs(limit)))


def _clock(at: datetime, zone: tzinfo | None) -> float:
    """Return an instant by the plant's clock as the axis counts it."""
    return float(mdates.date2num(at.astimezone(zone).replace(tzinfo=None)))  # type: ignore[no-untyped-call]


_LABEL: Final[dict[str, Any]] = {
    "xycoords": ("axes fraction", "data"),
    "xytext": (0, -11),  # below its line
    "textcoords": "offset points",
    "fontsize": 9,
}
_ABOVE: Final[dict[str, Any]] = _LABEL | {"xytext": (0, 3)}


def _scale(axes: Axes, values: list[float]) -> None:
    """Show at least ±5 % about the middle: otherwise what is noise looks like a change."""
    low, high = axes.get_ylim()
    middle = 0.5 * (min(values) + max(values))
    half = max(0.05 * abs(middle), 1.0e-9)
    axes.set_ylim(min(low, middle - half), max(high, middle + half))
