"""What a command comes to at the actuator: limited, late and lagged, exact where it is straight lines or steps.

    lag L' = min(u(t - dead time), limit) - L

All that stands between a command and a pressure follows this law, with a gain and an offset: a polled pressure is drawn
by it between its rows (estimators.likelihood.inputs.answered_lines), and an I/P's faults are read from it
(discrepancy.pressure_path).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.likelihood.lines.exact_lines import exact_corners
from estimators.likelihood.lines.stretches import Corners
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray
from valve.recording import Recording

_FEWEST_ROWS: Final = 50
_BOTH_ENDS: Final = 2  # corners that are no crossing of two lines
_LONGEST_GAP_S: Final = 0.5
_ROUNDING: Final = 1.0e-12  # of the span, that rows may be off a command's line by
_CHORD_ERROR: Final = 1.0e-5  # of the span: 1 um of 100 mm
_SHORTEST_LAG_S: Final = 1.0e-3  # what is shorter is a dead time


def answer_of(command: Corners, lag_s: float, dead_time_s: float, limit: float) -> Corners:
    """Return the corners of a command limited, late and lagged; it begins settled. ``limit`` may be infinite."""
    corner_s, asked = _limited(*command, limit)
    if lag_s > _SHORTEST_LAG_S:
        tolerance = _CHORD_ERROR * float(np.ptp(asked))
        corner_s, asked = lagged(corner_s, asked, float(asked[0]), lag_s, tolerance)
    return corner_s + dead_time_s, asked


def _limited(time_s: FloatArray, value: FloatArray, limit: float) -> Corners:
    """Return lines cut off at a limit, with corners where they cross it."""
    over = value > limit
    crossed = np.flatnonzero(over[1:] != over[:-1])
    if crossed.size == 0:
        return time_s, np.minimum(value, limit)
    share = (limit - value[crossed]) / (value[crossed + 1] - value[crossed])
    at_s = time_s[crossed] + share * (time_s[crossed + 1] - time_s[crossed])
    return (
        np.insert(time_s, crossed + 1, at_s),
        np.insert(np.minimum(value, limit), crossed + 1, np.full(crossed.size, limit)),
    )


def command_lines(recording: Recording) -> Corners | None:
    """Corners of a command that is straight lines to rounding, each crossing the next; None where it is not."""
    if recording.command_pa is None:
        return None
    known = np.isfinite(recording.command_pa)
    if np.count_nonzero(known) < _FEWEST_ROWS:
        return None
    time_s, asked = recording.time_s[known], recording.command_pa[known]
    corner_s, level, others = exact_corners(time_s, asked, _ROUNDING * max(float(np.abs(asked).max()), 1.0e-300))
    gaps = np.diff(time_s) > _LONGEST_GAP_S
    if others > _BOTH_ENDS or gaps.any():
        return None
    # the pressure may be read later than the command: of its last row the last line tells
    share = recording.sample_period_s / (corner_s[-1] - corner_s[-2])
    beyond_s, beyond = (one[-1] + share * (one[-1] - one[-2]) for one in (corner_s, level))
    return np.append(corner_s, beyond_s), np.append(level, beyond)
