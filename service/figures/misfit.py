"""The diagnosis in pictures: the misfit over time before and after, and along the coordinate that gives it away."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.units import UnitSystem, shown_unit

_LINES: Final = {"opening": ("-", "o"), "closing": ("--", "s"), "both": ("-", "o")}


def time_picture(pictures: Mapping[str, Any] | None, system: UnitSystem) -> Picture | None:
    """Return measured minus simulated position over time, before and after the cause was put into the simulation."""
    time = None if pictures is None else pictures.get("time")
    if not time or not time.get("time_s") or not time.get("before_m"):
        return None
    unit = shown_unit("m", system)
    time_s = np.asarray(time["time_s"], dtype=np.float64)
    measured_m = _numbers(time["measured_m"])
    with settings():
        figure = sheet(7.2, 4.4)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        above.plot(time_s, measured_m / unit.in_si, color=INK, linewidth=1.4)
        tidy(above, y=f"position, {unit.name}")
        sizes = []
        for key, line, colour, word in (
            ("before_m", "-", SOFT, "without the cause" if time.get("after_m") else "misfit"),
            ("after_m", "-", BLUE, "with the cause"),
        ):
            if time.get(key):
                missed = (measured_m - _numbers(time[key])) / unit.in_si
                sizes.append(f"{word} {float(np.sqrt(np.nanmean(missed**2))):.3g} {unit.name} rms")
                below.plot(time_s, missed, line, color=colour, linewidth=1.4, label=word)
        tidy(below, x="time, s", y=f"measured minus\nsimulated, {unit.name}")
        below.legend(frameon=False, ncols=2, loc="upper left", labelcolor=INK)
        low, high = below.get_ylim()
        below.set_ylim(low, high + 0.25 * (high - low))
    return Picture(figure, "Misfit over time", f"Measured minus simulated position: {', '.join(sizes)}.")


def coordinate_picture(pictures: Mapping[str, Any] | None, system: UnitSystem) -> Picture | None:
    """Return the misfit in newtons along the coordinate that explains most, the cause's own part drawn through it."""
    curves = [] if pictures is None else pictures.get("coordinates") or []
    if pictures is None or not curves:
        return None
    name = _telling([str(curve["coordinate"]) for curve in curves], pictures.get("explained") or {})
    same = [curve for curve in curves if curve["coordinate"] == name and curve.get("x")]
    if not same:
        return None
    x_unit, force = shown_unit(str(same[0]["unit"]), system), shown_unit("N", system)
    with settings():
        figure = sheet(7.2, 3.6)
        axes = figure.subplots()
        for curve in same:
            way = str(curve["direction"])
            line, marker = _LINES.get(way, ("-", "o"))
            x = _numbers(curve["x"]) / x_unit.in_si
            label = "misfit" if way == "both" else f"misfit, {way}"
            misfit_n = _numbers(curve["misfit_n"]) / force.in_si
            axes.plot(x, misfit_n, marker, color=SOFT, markersize=4.0, label=label, fillstyle=_fill(way))
            if curve.get("part_n"):
                own = "the cause's part" if way == "both" else f"the cause's part, {way}"
                axes.plot(x, _numbers(curve["part_n"]) / force.in_si, line, color=RED, linewidth=2.0, label=own)
        axes.axhline(0.0, color=SOFT, linewidth=0.8)
        tidy(axes, x=f"{name}, {x_unit.name}", y=f"force missed, {force.name}")
        figure.legend(loc="outside upper left", frameon=False, ncols=2, fontsize=10, labelcolor=INK)
    return Picture(
        figure,
        f"Misfit along {name}",
        f"The force that the simulation misses, along {name}"
        + (", with what the named cause adds drawn as a line." if any(curve.get("part_n") for curve in same) else "."),
    )


def _telling(names: list[str], explained: Mapping[str, float]) -> str:
    return max(names, key=lambda name: explained.get(name, 0.0))


def _fill(way: str) -> Literal["none", "full"]:
    return "none" if way == "closing" else "full"


def time_svg(pictures: Mapping[str, Any] | None, system: UnitSystem) -> str | None:
    """Return the misfit over time as SVG text."""
    picture = time_picture(pictures, system)
    return None if picture is None else svg_text(picture)


def coordinate_svg(pictures: Mapping[str, Any] | None, system: UnitSystem) -> str | None:
    """Return the misfit along its coordinate as SVG text."""
    picture = coordinate_picture(pictures, system)
    return None if picture is None else svg_text(picture)


def _numbers(values: Any) -> Any:
    """Values as floats; None becomes NaN, which leaves a hole in the line."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
