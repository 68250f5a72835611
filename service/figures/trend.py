"""Trends: one figure of a valve over its tests, with intervals, the baseline and the limits."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, tzinfo
from typing import TYPE_CHECKING, Any, Final

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.plant_clock import zone_words
from service.words.reader import Reader
from service.words.sentences import together
from valve.messages import Message, say

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
_BARS: Final = say(
    "trend_bars", "Bars: 95 % interval of each test, without what the figure differs by from test to test."
)
_AHEAD: Final = say("trend_ahead", "Dotted: the trend on to its limit, with the 95 % interval of when it is met.")
_WATCHED: Final = say("trend_watched", "Open circles: days in service, watched and not tested.")
_FARTHEST: Final = 2.0  # times what the tests span: a forecast that is further would leave them no room
_FRICTION: Final = say("trend_friction_bar", "The bar of friction holds what friction varies by within its test.")
_TITLE: Final = say("title_trend", "Trend of the valve over its tests")
_BASELINE: Final = say("label_baseline", "baseline")
_LOW_LIMIT: Final = say("low_limit", "low limit")
_HIGH_LIMIT: Final = say("high_limit", "high limit")
#: As matplotlib writes them in dates.
_MONTHS: Final = {
    "Jan": say("month_jan", "Jan"),
    "Feb": say("month_feb", "Feb"),
    "Mar": say("month_mar", "Mar"),
    "Apr": say("month_apr", "Apr"),
    "May": say("month_may", "May"),
    "Jun": say("month_jun", "Jun"),
    "Jul": say("month_jul", "Jul"),
    "Aug": say("month_aug", "Aug"),
    "Sep": say("month_sep", "Sep"),
    "Oct": say("month_oct", "Oct"),
    "Nov": say("month_nov", "Nov"),
    "Dec": say("month_dec", "Dec"),
}
_A_MONTH: Final = re.compile(rf"\b(?:{'|'.join(_MONTHS)})\b")


def _say_dates(axes: Axes, reader: Reader) -> None:
    """Put dates on an axis, with the months as the reader calls them."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    def told(words: str) -> str:
        return _A_MONTH.sub(lambda found: reader.told(_MONTHS[found.group()]), words)

    class Dates(ConciseDateFormatter):
        """Its words, told."""

        def format_ticks(self, values: Any) -> list[str]:
            """Return the words of the ticks."""
            return [told(words) for words in super().format_ticks(values)]  # type: ignore[no-untyped-call]

        def get_offset(self) -> str:
            """Return what all ticks have in common."""
            return told(super().get_offset())  # type: ignore[no-untyped-call]

    locator = AutoDateLocator(minticks=2, maxticks=5)  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(Dates(locator))  # type: ignore[no-untyped-call]


def trends_picture(trends: Sequence[Trend], reader: Reader, *, narrow: bool = False) -> Picture | None:
    """Return the trends by the reader's clock, and below them what their bars hold.

    Two beside each other, or below each other if narrow. None where neither a test nor a day in service gave a figure.
    """
    shown = [trend for trend in trends if trend.points or trend.watched]
    if not shown:
        return None
    columns = 1 if narrow else min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    with settings():
        width_in = _NARROW_IN if narrow else _WIDE_IN
        below = textwrap.wrap(reader.told(_below(shown, reader)), int(_LETTERS_AN_INCH * width_in))
        figure = sheet(width_in, 2.5 * rows + 0.16 * len(below))
        panels = figure.subplots(rows, columns, squeeze=False)
        for axes, trend in zip(panels.flat, shown, strict=False):
            _draw(axes, trend, reader)
        for axes in panels.flat[len(shown) :]:
            axes.set_visible(False)
        figure.supxlabel("\n".join(below), x=0.01, ha="left", fontsize=9, color=SOFT)
    said = tuple(one for trend in shown for one in _in_words(trend, reader))
    description = say("trend_said", "{said:; }. {below}", said=said, below=_below(shown, reader))
    return Picture(figure, reader.told(_TITLE), reader.told(description))


def trends_svg(trends: Sequence[Trend], reader: Reader, narrow: bool) -> str | None:
    """Return the trends as SVG text."""
    picture = trends_picture(trends, reader, narrow=narrow)
    return None if picture is None else svg_text(picture)


def _below(trends: Sequence[Trend], reader: Reader) -> str:
    """Say what the bars hold and whose clock the time is."""
    has_bars = [trend.name for trend in trends if any(point.ci95 is not None for point in trend.points)]
    watched = _WATCHED if any(trend.watched for trend in trends) else ""
    bars = _BARS if has_bars else ""
    friction = _FRICTION if any(name.startswith("friction") for name in has_bars) else ""
    ahead = _AHEAD if any(_shown_ahead(trend) is not None for trend in trends) else ""
    newest = (trends[0].points or trends[0].watched)[-1]
    clock = say("trend_clock", "Time: {zone}.", zone=zone_words(newest.at, reader.zone))
    return together([bars, friction, ahead, watched, clock])


def _shown_ahead(trend: Trend) -> Ahead | None:
    """Return the forecast where the picture has room for it."""
    ahead = trend.ahead
    if ahead is None or not trend.points:
        return None
    first, last = trend.points[0].at, trend.points[-1].at
    return None if ahead.at - last > _FARTHEST * (last - first) else ahead


def _in_words(trend: Trend, reader: Reader) -> Iterator[Message]:
    """Yield what a panel shows: the newest test beside the oldest one, and the newest day in service."""
    if trend.points:
        first, last = trend.points[0], trend.points[-1]
        now = say("trend_now", "{figure} is {value}", figure=trend.meaning, value=_value(last, trend, reader))
        if len(trend.points) > 1:
            day = f"{first.at.astimezone(reader.zone):%Y-%m-%d}"
            was = _value(first, trend, reader)
            now = say("trend_now_and_then", "{now}, it was {value} on {day}", now=now, value=was, day=day)
        yield now
    if trend.watched:
        value = _value(trend.watched[-1], trend, reader)
        yield say("trend_in_service", "{figure} in service is {value}", figure=trend.meaning, value=value)


def _value(point: TrendPoint, trend: Trend, reader: Reader) -> str:
    return reader.measured(point.value, point.ci95, trend.unit)


def _draw(axes: Axes, trend: Trend, reader: Reader) -> None:
    unit, zone = reader.unit(trend.unit), reader.zone
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
        axes.annotate(reader.told(_BASELINE), (0.01, unit.shown(trend.baseline)), **_LABEL, color=SOFT)
    for limit, word in zip(trend.limits, (_LOW_LIMIT, _HIGH_LIMIT), strict=True):
        if limit is not None:
            axes.axhline(unit.shown(limit), color=RED, linewidth=1.2, linestyle="-.")
            place = _ABOVE if word is _LOW_LIMIT else _LABEL
            axes.annotate(reader.told(word), (0.01, unit.shown(limit)), **place, color=RED)
    tidy(axes)
    axes.set_title(f"{reader.shown(trend.meaning)}, {unit.name}", fontsize=11, loc="left", color=INK)
    _scale(axes, values + [value for _, value, _ in seen])
    _say_dates(axes, reader)
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
    from matplotlib.dates import date2num

    return float(date2num(at.astimezone(zone).replace(tzinfo=None)))  # type: ignore[no-untyped-call]


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
