"""What a test measured, over time: the recording of one that has no result is shown as well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from service.figures.canvas import BLUE, INK, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.reader import Reader
from valve.messages import Message, say
from valve.recording import Recording
from valve.recording_files import read_recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLE: Final = say("title_recording", "Recording")
_COMMAND: Final = say("label_command", "command")
_PRESSURE: Final = say("label_pressure", "pressure")
_MOST_POINTS = 1200  # two a pixel of the page
_LEAST_SPAN_M = 1.0e-3  # that the position's axis shows: the noise of a stem that stood still is no motion


def trace_picture(recording: Recording, reader: Reader) -> Picture:
    """Return position above, pressure and command below, over the recording's time."""
    length, pressure = reader.unit("m"), reader.unit("Pa")
    rows = _drawn(recording.position_m)
    time_s = recording.time_s[rows]
    with settings():
        figure = sheet(7.2, 4.4)
        above, below = figure.subplots(2, 1, sharex=True)
        above.plot(time_s, recording.position_m[rows] / length.in_si, color=INK, linewidth=1.4)
        _widen(above, length.in_si)
        tidy(above, y=reader.told(say("axis_position", "position, {unit}", unit=length.name)))
        for name, values_pa, line, colour in (
            (_COMMAND, recording.command_pa, "--", SOFT),
            (_PRESSURE, recording.pressure_pa, "-", BLUE),
        ):
            if values_pa is not None:
                below.plot(
                    time_s, values_pa[rows] / pressure.in_si, line, color=colour, linewidth=1.4, label=reader.told(name)
                )
        tidy(
            below,
            x=reader.told(say("axis_time", "time, s")),
            y=reader.told(say("axis_pressure", "pressure, {unit}", unit=pressure.name)),
        )
        if below.get_lines():
            below.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0), labelcolor=INK)
    return Picture(figure, reader.told(_TITLE), reader.told(_words(recording, reader)))


def trace_svg(file: str, reader: Reader) -> str:
    """Return the picture of a recording's file as SVG text. Raises what reading it raises."""
    return svg_text(trace_picture(read_recording(file), reader))


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


def _words(recording: Recording, reader: Reader) -> Message:
    known_m = recording.position_m[np.isfinite(recording.position_m)]
    lasted = say("samples_in", "{n} samples in {lasted:.3g s}", n=recording.samples, lasted=recording.duration_s)
    if known_m.size == 0:
        return say("position_never_measured", "{lasted}; the position was never measured.", lasted=lasted)
    low, high = (reader.quantity(float(end_m), "m") for end_m in (known_m.min(), known_m.max()))
    return say("position_from_to", "{lasted}; position {low} to {high}.", lasted=lasted, low=low, high=high)
