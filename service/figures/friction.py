"""Friction along the travel as a test found it, beyond its mean, with the 95 % band: both directions in one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.names import named
from service.words.reader import Reader
from valve.messages import say

_TITLE: Final = say("title_friction", "Friction along the travel")
_STYLE: Final = {"opening": ("-", BLUE), "closing": ("--", RED)}


def friction_picture(latent: Sequence[Mapping[str, Any]] | None, reader: Reader) -> Picture | None:
    """Return friction beyond its mean along the travel; ``latent`` is the analysis object's ``latent_friction``.

    None where it has nothing along the travel.
    """
    curves = [one for one in latent or () if one["coordinate"] == "travel_m" and len(one["at"]) > 1]
    if not curves:
        return None
    travel, force = reader.unit("m"), reader.unit("N")
    sizes: list[str] = []
    with settings():
        figure = sheet(7.2, 3.6)
        axes = figure.subplots()
        for curve in curves:
            way = str(curve["direction"])
            words = named(way)
            line, colour = _STYLE.get(way, ("-", INK))
            at = np.asarray(curve["at"], dtype=np.float64) / travel.in_si
            beyond = np.asarray(curve["force_n"], dtype=np.float64) / force.in_si
            low, high = (np.asarray(curve["ci95"], dtype=np.float64) / force.in_si).T
            axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0)
            axes.plot(
                at,
                beyond,
                line,
                color=colour,
                linewidth=1.8,
                label=reader.told(say("with_its_band", "{way}, with its 95 % band", way=words)),
            )
            low_words, high_words = (f"{float(end):.3g}" for end in (beyond.min(), beyond.max()))
            sizes.append(
                say(
                    "way_from_to",
                    "{way} {low} to {high} {unit}",
                    way=words,
                    low=low_words,
                    high=high_words,
                    unit=force.name,
                )
            )
        axes.axhline(0.0, color=SOFT, linewidth=0.8)
        tidy(
            axes,
            x=reader.told(say("axis_travel", "travel, {unit}", unit=travel.name)),
            y=reader.told(say("axis_friction_beyond", "friction beyond\nits mean, {unit}", unit=force.name)),
        )
        figure.legend(loc="outside upper left", frameon=False, ncols=2, fontsize=10, labelcolor=INK)
    description = say("friction_beyond_mean", "Friction beyond its mean: {sizes:; }.", sizes=tuple(sizes))
    return Picture(figure, reader.told(_TITLE), reader.told(description))


def friction_svg(latent: Sequence[Mapping[str, Any]] | None, reader: Reader) -> str | None:
    """Return friction along the travel as SVG text."""
    picture = friction_picture(latent, reader)
    return None if picture is None else svg_text(picture)
