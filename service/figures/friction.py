"""Friction along the travel as a test found it, beyond its mean, with the 95 % band: both directions in one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.units import UnitSystem, shown_unit

_STYLE: Final = {"opening": ("-", BLUE), "closing": ("--", RED)}


def friction_picture(latent: Sequence[Mapping[str, Any]] | None, system: UnitSystem) -> Picture | None:
    """Return friction beyond its mean along the travel; ``latent`` is the analysis object's ``latent_friction``.

    None where it has nothing along the travel.
    """
    curves = [one for one in latent or () if one["coordinate"] == "travel_m" and len(one["at"]) > 1]
    if not curves:
        return None
    travel, force = shown_unit("m", system), shown_unit("N", system)
    sizes = []
    with settings():
        figure = sheet(7.2, 3.6)
        axes = figure.subplots()
        for curve in curves:
            way = str(curve["direction"])
            line, colour = _STYLE.get(way, ("-", INK))
            at = np.asarray(curve["at"], dtype=np.float64) / travel.in_si
            beyond = np.asarray(curve["force_n"], dtype=np.float64) / force.in_si
            low, high = (np.asarray(curve["ci95"], dtype=np.float64) / force.in_si).T
            axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0)
            axes.plot(at, beyond, line, color=colour, linewidth=1.8, label=f"{way}, with its 95 % band")
            sizes.append(f"{way} {float(beyond.min()):.3g} to {float(beyond.max()):.3g} {force.name}")
        axes.axhline(0.0, color=SOFT, linewidth=0.8)
        tidy(axes, x=f"travel, {travel.name}", y=f"friction beyond\nits mean, {force.name}")
        figure.legend(loc="outside upper left", frameon=False, ncols=2, fontsize=10, labelcolor=INK)
    return Picture(figure, "Friction along the travel", f"Friction beyond its mean: {'; '.join(sizes)}.")


def friction_svg(latent: Sequence[Mapping[str, Any]] | None, system: UnitSystem) -> str | None:
    """Return friction along the travel as SVG text."""
    picture = friction_picture(latent, system)
    return None if picture is None else svg_text(picture)
