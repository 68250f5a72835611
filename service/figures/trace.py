"""What a test measured, over time: the recording of one that has no result is shown as well."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from service.figures.canvas import BLUE, INK, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.units import UnitSystem, quantity, shown_unit
from valve.recording import Recording
from valve.recording_files import read_recording

_MOST_POINTS = 1200  # two a pixel of the page
_LEAST_SPAN_M = 1.0e-3  # that the position's axis shows: the noise of a stem that stood still is no motion


def trace_picture(recording: Recording, system: UnitSystem) -> Picture:
    """Return position above, pressure and command below, over the recording's time."""
    length, pressure = shown_unit("m", system), shown_unit("Pa", system)
    rows = _drawn(recording.position_m)
    time_s = recording.time_s[rows]
    with settings():
        figure = sheet(7.2, 4.4)
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(time_s, recording.position_m[rows] / length.in_si, color=INK, linewidth=1.4)
        _widen(above, length.in_si)
        tidy(above, y=f"position, {length.name}")
        for name, values_pa, line, colour in (
            ("command", recording.command_pa, "--", SOFT),
            ("pressure", recording.pressure_pa, "-", BLUE),
        ):
            if values_pa is not None:
                below.plot(time_s, values_pa[rows] / pressure.in_si, line, color=colour, linewidth=1.4, label=name)
        tidy(below, x="time, s", y=f"pressure, {pressure.name}")
        if below.get_lines():
            below.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0), labelcolor=INK)
    return Picture(figure, "Recording", _words(recording, system))


def trace_svg(file: str, system: UnitSystem) -> str:
    """Return the picture of a recording's file as SVG text. Raises what reading it raises."""
    return svg_text(trace_picture(read_recording(file), system))


def _widen(axes: Axes, unit_m: float) -> None:
    low, high = axes.get_ylim()
    lacking = _LEAST_SPAN_M / unit_m - (high - low)
    if lacking > 0.0:
        axes.set_ylim(low - 0.5 * lacking, high + 0.5 * lacking)


def _drawn(position_m: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
    """Return the rows to draw: all, or the lowest and highest position of as many equal pieces as there is room for."""
    count = position_m.size
    if count <= _MOST_POINTS:
        return np.arange(count)
    edges = np.linspace(0, count, _MOST_POINTS // 2 + 1).astype(np.intp)
    rows = {0, count - 1}
    for first, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        piece = position_m[first:end]
        if np.isfinite(piece).any():
            rows |= {first + int(np.nanargmin(piece)), first + int(np.nanargmax(piece))}
        else:
            rows.add(first)  # a hole stays one
    return np.array(sorted(rows), dtype=np.intp)


def _words(recording: Recording, system: UnitSystem) -> str:
    known_m = recording.position_m[np.isfinite(recording.position_m)]
    lasted = f"{recording.samples} samples in {recording.duration_s:.3g} s"
    if known_m.size == 0:
        return f"{lasted}; the position was never measured."
    low, high = quantity(float(known_m.min()), "m", system), quantity(float(known_m.max()), "m", system)
    return f"{lasted}; position {low} to {high}."
