"""A recording's command as corners, and the rows at which the pressure was read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.inputs.answered_command import answer_of, command_lines
from estimators.likelihood.lines.stretches import Corners
from estimators.samples import FloatArray
from valve.recording import Recording

FEWEST_ROWS: Final = 50
_FINE_S: Final = 2.0e-3  # between the corners of a command that is no straight lines


@dataclass(frozen=True, slots=True, eq=False)
class CommandedRows:
    """A command's corners, and the rows at which the pressure was read."""

    command: Corners
    time_s: FloatArray
    pressure_pa: FloatArray

    @classmethod
    def of(cls, recording: Recording) -> CommandedRows:
        """Return those of a recording that has the command; without a pressure the command stands for it."""
        assert recording.command_pa is not None
        pressure_pa = recording.command_pa if recording.pressure_pa is None else recording.pressure_pa
        return cls(_asked(recording), recording.time_s, pressure_pa)

    def answer(self, lag_s: float, dead_time_s: float, limit_pa: float) -> FloatArray:
        """Return the command limited, late and lagged, at the rows."""
        return np.interp(self.time_s, *answer_of(self.command, lag_s, dead_time_s, limit_pa))


def _asked(recording: Recording) -> Corners:
    """Return the command's corners: held from each write on, its straight lines, or its rows."""
    assert recording.command_pa is not None
    written_s, known = written(recording), np.isfinite(recording.command_pa)
    if written_s is not None:
        known &= np.isfinite(written_s)
        held_pa = recording.command_pa[known]
        first_s, end_s = min(recording.time_s[0], written_s[known][0]), max(recording.time_s[-1], written_s[known][-1])
        return np.concatenate([[first_s], np.repeat(written_s[known][1:], 2), [end_s]]), np.repeat(held_pa, 2)
    lines = command_lines(recording)
    if lines is not None:
        return lines
    time_s, asked_pa = recording.time_s[known], recording.command_pa[known]
    if recording.sample_period_s >= _FINE_S:
        return time_s, asked_pa
    grid_s: FloatArray = np.arange(time_s[0], time_s[-1] + _FINE_S, _FINE_S, dtype=np.float64)
    return grid_s, np.interp(grid_s, time_s, asked_pa)


def written(recording: Recording) -> FloatArray | None:
    """Return when each command reached the device, s, shape (n,), where that was recorded: it is held from then on."""
    if recording.write_sent_s is None or recording.written_s is None:
        return None
    middle_s = 0.5 * (recording.write_sent_s + recording.written_s)
    return middle_s if np.count_nonzero(np.isfinite(middle_s)) >= FEWEST_ROWS else None
