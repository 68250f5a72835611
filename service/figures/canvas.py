"""The sheet that all pictures are drawn on: sizes, colours that also the colour-blind tell apart, and the SVG text.

matplotlib is loaded where something is drawn, in a process of its own: a service that starts does not wait for it.
A picture's own words (title, what it shows) stand in it as ``title`` and ``desc`` for those who do not see it.
"""

from __future__ import annotations

import html
import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK: Final = "#1b1f23"
SOFT: Final = "#6b737c"
PALE: Final = "#c3c9cf"
GRID: Final = "#e3e6e9"
# Okabe and Ito's blue and vermilion; nothing is told by colour alone.
BLUE: Final = "#0072b2"
RED: Final = "#b8410a"

_SETTINGS: Final[Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Liberation Sans", "Arial", "sans-serif"],
    "font.size": 11.0,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "svg.hashsalt": "breakaway",
    "path.simplify": True,
    "path.simplify_threshold": 0.3,
}
_NUMBER: Final = re.compile(r"-?\d+\.\d{2,}")
_COURSE: Final = re.compile(r'(?<= d=")[^"]*')  # never a number that is read, nor the scale of a letter
_SVG_OPEN: Final = re.compile(r"<svg [^>]*>")
_PROLOGUE: Final = re.compile(r"^.*?(?=<svg )", re.DOTALL)
_METADATA: Final = re.compile(r"\s*<metadata>.*?</metadata>", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with the words for those who do not see it."""

    figure: Figure
    title: str
    description: str


def sheet(width_in: float = 7.2, height_in: float = 3.4) -> Figure:
    """Return an empty figure of this size, inches (72 SVG points each)."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with settings():
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
    return figure


def settings(fonts: Any = None) -> Any:
    """Return the context in which every picture is drawn, with matplotlib's settings of ``fonts``."""
    from matplotlib import rc_context

    return rc_context({**_SETTINGS, **(fonts or {})})


def tidy(axes: Axes, *, x: str = "", y: str = "") -> None:
    """Name the axes, draw a pale grid, and leave out the frame's upper and right side."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.ticklabel_format(useOffset=False, style="plain")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def svg_text(picture: Picture, *, text_as_paths: bool = False) -> str:
    """Return a picture as SVG that needs no other file; ``text_as_paths`` where the reader has no fonts (a PDF)."""
    written = io.StringIO()
    with settings({"svg.fonttype": "path" if text_as_paths else "none"}):
        picture.figure.savefig(written, format="svg", metadata={"Date": None, "Creator": None})
    text = _METADATA.sub("", _PROLOGUE.sub("", written.getvalue(), count=1), count=1)
    text = _COURSE.sub(lambda d: _NUMBER.sub(lambda found: f"{float(found.group()):.1f}", d.group()), text)
    words = f'<title id="t">{html.escape(picture.title)}</title><desc id="d">{html.escape(picture.description)}</desc>'
    opening = _SVG_OPEN.search(text)
    assert opening is not None, "matplotlib writes an svg element"
    opened = opening.group()[:-1] + ' role="img" aria-labelledby="t d">'
    return opened + words + text[opening.end() :]
