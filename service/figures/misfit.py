"""The diagnosis in pictures: the misfit over time before and after, and along the coordinate that gives it away."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.names import named
from service.words.reader import Reader
from valve.messages import Message, say

_TITLE: Final = say("title_misfit", "Misfit over time")
_MISFIT: Final = say("label_misfit", "misfit")
_WITHOUT: Final = say("without_the_cause", "without the cause")
_WITH: Final = say("with_the_cause", "with the cause")
_PART: Final = say("part_of_cause", "the cause's part")
_LINES: Final = {"opening": ("-", "o"), "closing": ("--", "s"), "both": ("-", "o")}


def time_picture(pictures: Mapping[str, Any] | None, reader: Reader) -> Picture | None:
    """Return measured minus simulated position over time, before and after the cause was put into the simulation."""
    time = None if pictures is None else pictures.get("time")
    if not time or not time.get("time_s") or not time.get("before_m"):
        return None
    unit = reader.unit("m")
    time_s = np.asarray(time["time_s"], dtype=np.float64)
    measured_m = _numbers(time["measured_m"])
    with settings():
        figure = sheet(7.2, 4.4)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        above.plot(time_s, measured_m / unit.in_si, color=INK, linewidth=1.4)
        tidy(above, y=reader.told(say("axis_position", "position, {unit}", unit=unit.name)))
        sizes: list[str] = []
        for key, line, colour, word in (
            ("before_m", "-", SOFT, _WITHOUT if time.get("after_m") else _MISFIT),
            ("after_m", "-", BLUE, _WITH),
        ):
            if time.get(key):
                missed = (measured_m - _numbers(time[key])) / unit.in_si
                size = f"{float(np.sqrt(np.nanmean(missed**2))):.3g} {unit.name}"
                sizes.append(say("name_and_rms", "{name} {size} rms", name=word, size=size))
                below.plot(time_s, missed, line, color=colour, linewidth=1.4, label=reader.told(word))
        tidy(
            below,
            x=reader.told(say("axis_time", "time, s")),
            y=reader.told(say("axis_misfit", "measured minus\nsimulated, {unit}", unit=unit.name)),
        )
        below.legend(frameon=False, ncols=2, loc="upper left", labelcolor=INK)
        low, high = below.get_ylim()
        below.set_ylim(low, high + 0.25 * (high - low))
    description = say("measured_minus_simulated", "Measured minus simulated position: {sizes:, }.", sizes=tuple(sizes))
    return Picture(figure, reader.told(_TITLE), reader.told(description))


def coordinate_picture(pictures: Mapping[str, Any] | None, reader: Reader) -> Picture | None:
    """Return the misfit in newtons along the coordinate that explains most, the cause's own part drawn through it."""
    curves = [] if pictures is None else pictures.get("coordinates") or []
    if pictures is None or not curves:
        return None
    name = _telling([str(curve["coordinate"]) for curve in curves], pictures.get("explained") or {})
    same = [curve for curve in curves if curve["coordinate"] == name and curve.get("x")]
    if not same:
        return None
    x_unit, force = reader.unit(str(same[0]["unit"])), reader.unit("N")
    with settings():
        figure = sheet(7.2, 3.6)
        axes = figure.subplots()
        for curve in same:
            way = str(curve["direction"])
            line, marker = _LINES.get(way, ("-", "o"))
            x = _numbers(curve["x"]) / x_unit.in_si
            misfit_n = _numbers(curve["misfit_n"]) / force.in_si
            axes.plot(
                x,
                misfit_n,
                marker,
                color=SOFT,
                markersize=4.0,
                label=reader.told(_of_way(_MISFIT, way)),
                fillstyle=_fill(way),
            )
            if curve.get("part_n"):
                own = reader.told(_of_way(_PART, way))
                axes.plot(x, _numbers(curve["part_n"]) / force.in_si, line, color=RED, linewidth=2.0, label=own)
        axes.axhline(0.0, color=SOFT, linewidth=0.8)
        tidy(
            axes,
            x=reader.told(say("axis_named", "{name}, {unit}", name=named(name), unit=x_unit.name)),
            y=reader.told(say("axis_force_missed", "force missed, {unit}", unit=force.name)),
        )
        figure.legend(loc="outside upper left", frameon=False, ncols=2, fontsize=10, labelcolor=INK)
    title = say("title_misfit_along", "Misfit along {name}", name=named(name))
    if any(curve.get("part_n") for curve in same):
        description = say(
            "force_missed_with_cause",
            "The force that the simulation misses, along {name}, with what the named cause adds drawn as a line.",
            name=named(name),
        )
    else:
        description = say("force_missed_along", "The force that the simulation misses, along {name}.", name=named(name))
    return Picture(figure, reader.told(title), reader.told(description))


def _of_way(what: Message, way: str) -> Message:
    return what if way == "both" else say("of_way", "{what}, {way}", what=what, way=named(way))


def _telling(names: list[str], explained: Mapping[str, float]) -> str:
    return max(names, key=lambda name: explained.get(name, 0.0))


def _fill(way: str) -> Literal["none", "full"]:
    return "none" if way == "closing" else "full"


def time_svg(pictures: Mapping[str, Any] | None, reader: Reader) -> str | None:
    """Return the misfit over time as SVG text."""
    picture = time_picture(pictures, reader)
    return None if picture is None else svg_text(picture)


def coordinate_svg(pictures: Mapping[str, Any] | None, reader: Reader) -> str | None:
    """Return the misfit along its coordinate as SVG text."""
    picture = coordinate_picture(pictures, reader)
    return None if picture is None else svg_text(picture)


def _numbers(values: Any) -> Any:
    """Values as floats; None becomes NaN, which leaves a hole in the line."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
