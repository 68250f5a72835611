"""The signature's loop: stem position over actuator pressure or force, both ways, with the baseline's behind it."""

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
        drive = _driven_by(curve)
        old = None if baseline is None else baseline.get("curve")
        old = old if _has_points(old) and _driven_by(old) == drive else None
        if old is not None:
            _draw(axes, old, system, is_baseline=True)
        _draw(axes, curve, system, is_baseline=False)
        stroke_m = signature.get("central_stroke_m")
        if stroke_m is not None:
            unit = shown_unit("m", system)
            for number, place_m in enumerate(stroke_m):
                word = "" if number else "figures are of the stroke between"
                axes.axhline(unit.shown(place_m), color=SOFT, linewidth=0.8, linestyle=":", label=word)
        word, unit_of_drive = ("pressure at", "Pa") if drive == _PRESSURE else ("force of", "N")
        x, y = shown_unit(unit_of_drive, system).name, shown_unit("m", system).name
        tidy(axes, x=f"{word} the actuator, {x}", y=f"stem position, {y}")
        figure.legend(loc="outside upper left", frameon=False, ncols=3, fontsize=10, handlelength=3.0, labelcolor=INK)
    friction = quantity(signature.get("friction_mean_n"), "N", system)
    behind = ", with the baseline's loop behind it" if old is not None else ""
    return Picture(
        figure,
        f"Signature: stem position over {'pressure' if drive == _PRESSURE else 'force'}",
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
_PRESSURE: Final = "pressure_pa"
_FORCE: Final = "force_n"


def _driven_by(curve: Any) -> str:
    """Return by what a curve's travel is drawn: the pressure, or the force where that was recorded."""
    return _FORCE if any(_FORCE in (curve.get(way) or {}) for way in _KEYS) else _PRESSURE


def _draw(axes: Axes, curve: Any, system: UnitSystem, *, is_baseline: bool) -> None:
    colour, width, prefix = (PALE, 4.0, "baseline, ") if is_baseline else (BLUE, 2.0, "")
    key = _driven_by(curve)
    length, drive = shown_unit("m", system), shown_unit("Pa" if key == _PRESSURE else "N", system)
    for way, line, word in _WAYS:
        branch = curve.get(way)
        if not branch or len(branch["travel_m"]) < 2:
            continue
        x = np.asarray(branch[key], dtype=np.float64) / drive.in_si
        y = np.asarray(branch["travel_m"], dtype=np.float64) / length.in_si
        axes.plot(x, y, line, color=colour, linewidth=width, label=f"{prefix}{word}")
