"""The stroke: how far the stem went while the input went over its range, wherever it stood before."""

from __future__ import annotations

from typing import Final

import numpy as np

from valve.recording import FloatArray, Recording

_AT_END: Final = 0.02  # own choice, of the input's span: an end counts as reached
_COVERED: Final = 0.9  # own choice, of the input's span: what is left of the recording still shows the stroke


def stroke_m(recording: Recording) -> tuple[float, float] | None:
    """Return the lowest and the highest position once the input had been at one of its ends, m; None without any.

    A sticky stem rests where its last motion left it, anywhere within its dead band, so the way to the first end tells
    of the past and not of this test. Counted is from the later of the input's two first arrivals at an end from which
    on it still covers its span; from the first row where the input goes one way only. The input is the measured
    pressure, else the force, else the command.
    """
    known = np.isfinite(recording.position_m)
    if not known.any():
        return None
    position_m = recording.position_m[_first_row(_input(recording)) :]
    position_m = position_m[np.isfinite(position_m)]
    if position_m.size == 0:
        position_m = recording.position_m[known]
    return float(position_m.min()), float(position_m.max())


def _input(recording: Recording) -> FloatArray:
    channels = (recording.pressure_pa, recording.force_n, recording.command_pa)
    return next(one for one in channels if one is not None)


def _first_row(asked: FloatArray) -> int:
    if not np.isfinite(asked).any():
        return 0
    low, high = float(np.nanmin(asked)), float(np.nanmax(asked))
    span = high - low
    arrivals = (int(np.argmax(asked >= high - _AT_END * span)), int(np.argmax(asked <= low + _AT_END * span)))
    covering = [row for row in arrivals if np.nanmax(asked[row:]) - np.nanmin(asked[row:]) >= _COVERED * span]
    return max(covering, default=0)
