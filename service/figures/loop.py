"""The signature's loop: stem position over actuator pressure, both ways, with the baseline's behind it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from service.figures.canvas import BLUE, INK, PALE, SOFT, Picture, settings, sheet, svg_text, tidy
from service.shown_units import UnitSystem, quantity, shown_unit

_WAYS: Final = (("up", "-", "opening"), ("down", "--", "closing"))


def loop_picture(
    signature: Mapping[str, Any] | None, baseline: Mapping[str, Any] | None, system: UnitSystem
) -> Picture | None:
    """Return the loop of a signature, over that of the baseline's where there is one; None where it has no curve."""
    curve = None if signature is None else signature.get("curve")
    if signature is None or not _has_points(curve):
        return None
    with settings():
        figure = sheet(7.2, 4.4)
        axes = figure.subplots()
        old = None if baseline is None else baseline.get("curve")
        if _has_points(old):
            _draw(axes, old, system, is_baseline=True)
        _draw(axes, curve, system, is_baseline=False)
        stroke_m = signature.get("central_stroke_m")
        if stroke_m is not None:
            unit = shown_unit("m", system)
            for number, place_m in enumerate(stroke_m):
                word = "" if number else "figures are of the stroke between"
                axes.axhline(unit.shown(place_m), color=SOFT, linewidth=0.8, linestyle=":", label=word)
        x, y = shown_unit("Pa", system).name, shown_unit("m", system).name
        tidy(axes, x=f"pressure at the actuator, {x}", y=f"stem position, {y}")
        figure.legend(loc="outside upper left", frameon=False, ncols=3, fontsize=10, handlelength=3.0, labelcolor=INK)
    friction = quantity(signature.get("friction_mean_n"), "N", system)
    behind = ", with the baseline's loop behind it" if _has_points(old) else ""
    return Picture(
        figure,
        "Signature: stem position over pressure",
        f"The loop that the valve draws opening and closing{behind}. Half of its width is friction: {friction} on "
        "average over the stroke between the dotted lines.",
    )


def loop_svg(signature: Mapping[str, Any] | None, baseline: Mapping[str, Any] | None, system: UnitSystem) -> str | None:
    """Return the loop as SVG text."""
    picture = loop_picture(signature, baseline, system)
    return None if picture is None else svg_text(picture)


def _has_points(curve: Any) -> bool:
    return isinstance(curve, Mapping) and any(len((curve.get(way) or {}).get("travel_m") or []) > 1 for way in _KEYS)


_KEYS: Final = tuple(way for way, _, _ in _WAYS)


def _draw(axes: Axes, curve: Any, system: UnitSystem, *, is_baseline: bool) -> None:
    colour, width, prefix = (PALE, 4.0, "baseline, ") if is_baseline else (BLUE, 2.0, "")
    length, pressure = shown_unit("m", system), shown_unit("Pa", system)
    for way, line, word in _WAYS:
        branch = curve.get(way)
        if not branch or len(branch["travel_m"]) < 2:
            continue
        x = np.asarray(branch["pressure_pa"], dtype=np.float64) / pressure.in_si
        y = np.asarray(branch["travel_m"], dtype=np.float64) / length.in_si
        axes.plot(x, y, line, color=colour, linewidth=width, label=f"{prefix}{word}")
