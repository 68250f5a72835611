"""Trends: one figure of a valve over its tests, with intervals, the baseline and the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

import matplotlib.dates as mdates
from matplotlib.axes import Axes

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.shown_units import UnitSystem, measured, shown_unit


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One test's value of one figure, SI, with its 95 % interval where there is one."""

    at: datetime
    value: float
    ci95: tuple[float, float] | None = None
    mark: str = ""


@dataclass(frozen=True, slots=True)
class Trend:
    """One figure over the tests of a valve, oldest first; ``limits`` are where it is judged abnormal."""

    name: str
    meaning: str
    unit: str
    points: tuple[TrendPoint, ...]
    baseline: float | None = None
    limits: tuple[float | None, float | None] = (None, None)


_COLUMNS: Final = 2
_WIDE_IN: Final = 7.2
_NARROW_IN: Final = 4.0  # of a phone: its text is read at 320 pixels


def trends_picture(trends: Sequence[Trend], system: UnitSystem, *, narrow: bool = False) -> Picture | None:
    """Return the trends, two beside each other, or below each other if narrow; None where no test gave a figure."""
    shown = [trend for trend in trends if trend.points]
    if not shown:
        return None
    columns = 1 if narrow else min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    with settings():
        figure = sheet(_NARROW_IN if narrow else _WIDE_IN, 2.5 * rows)
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, trend in zip(panels.flat, shown, strict=False):
            _draw(axes, trend, system)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
    said = "; ".join(_in_words(trend, system) for trend in shown)
    return Picture(figure, "Trend of the valve over its tests", f"{said}.")


def trends_svg(trends: Sequence[Trend], system: UnitSystem, narrow: bool) -> str | None:
    """Return the trends as SVG text."""
    picture = trends_picture(trends, system, narrow=narrow)
    return None if picture is None else svg_text(picture)


def _in_words(trend: Trend, system: UnitSystem) -> str:
    first, last = trend.points[0], trend.points[-1]
    now = f"{trend.meaning} is {measured(last.value, last.ci95, trend.unit, system)}"
    if len(trend.points) == 1:
        return now
    return f"{now}, it was {measured(first.value, first.ci95, trend.unit, system)} on {first.at:%Y-%m-%d}"


def _draw(axes: Axes, trend: Trend, system: UnitSystem) -> None:
    unit = shown_unit(trend.unit, system)
    times = [mdates.date2num(point.at) for point in trend.points]  # type: ignore[no-untyped-call]
    values = [unit.shown(point.value) for point in trend.points]
    axes.plot(times, values, "-", color=BLUE, linewidth=1.2, zorder=2)
    for time, value, point in zip(times, values, trend.points, strict=True):
        if point.ci95 is not None:
            axes.plot([time, time], [unit.shown(point.ci95[0]), unit.shown(point.ci95[1])], color=BLUE, linewidth=2.4)
        axes.plot([time], [value], "o" if not point.mark else "s", color=BLUE, markersize=5.0, zorder=3)
    if trend.baseline is not None:
        axes.axhline(unit.shown(trend.baseline), color=SOFT, linewidth=1.0, linestyle="--")
        axes.annotate("baseline", (0.01, unit.shown(trend.baseline)), **_LABEL, color=SOFT)
    for limit, word in zip(trend.limits, ("low limit", "high limit"), strict=True):
        if limit is not None:
            axes.axhline(unit.shown(limit), color=RED, linewidth=1.2, linestyle="-.")
            axes.annotate(word, (0.01, unit.shown(limit)), **(_ABOVE if word == "low limit" else _LABEL), color=RED)
    tidy(axes)
    axes.set_title(f"{trend.meaning}, {unit.name}", fontsize=11, loc="left", color=INK)
    _scale(axes, values)
    locator = mdates.AutoDateLocator(minticks=2, maxticks=4)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(mdates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    if len(times) == 1:
        axes.set_xlim(times[0] - 1.0, times[0] + 1.0)


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
