"""What a device asks of its I/P over time: corners that are known so far, the last one held."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simulator.transducer import value_at

FloatArray = npt.NDArray[np.float64]


class Trajectory:
    """A pressure over time, straight lines between corners; what is to come may be replaced, what was is kept.

    ``forget`` drops what nobody needs any more, so that its memory is bounded by the waveform that it plays.
    """

    def __init__(self, start_s: float, pressure_pa: float) -> None:
        self._time_s: FloatArray = np.array([start_s])
        self._pressure_pa: FloatArray = np.array([pressure_pa])

    @property
    def corners(self) -> int:
        """Number of corners that are kept."""
        return int(self._time_s.size)

    def at(self, time_s: float) -> float:
        """Pressure at this time, Pa; at a step the value after it."""
        if time_s >= self._time_s[-1]:
            return float(self._pressure_pa[-1])
        return float(value_at(self._time_s, self._pressure_pa, np.array([time_s]))[0])

    def values(self, time_s: FloatArray) -> FloatArray:
        """Pressures at these times, Pa, shape as given."""
        return value_at(self._time_s, self._pressure_pa, time_s)

    def is_held_from(self, time_s: float) -> bool:
        """Whether the pressure no longer changes after this time."""
        return bool(time_s >= self._time_s[-1])

    def replace_from(self, start_s: float, after_s: FloatArray, pressure_pa: FloatArray) -> None:
        """From ``start_s`` on follow these corners, ``after_s`` later each; a jump to the first is a step.

        Corners: shape (n_corners,).
        """
        kept = self._time_s < start_s
        before_pa = self._at_left(start_s)
        self._time_s = np.concatenate([self._time_s[kept], [start_s], start_s + after_s])
        self._pressure_pa = np.concatenate([self._pressure_pa[kept], [before_pa], pressure_pa])

    def step_to(self, start_s: float, pressure_pa: float) -> None:
        """From ``start_s`` on hold this pressure."""
        if start_s > self._time_s[-1]:
            # The usual case: after a held pressure another one. One array each, and what was before is kept.
            held_pa = self._pressure_pa[-1]
            self._time_s = np.array((*self._time_s, start_s, start_s))
            self._pressure_pa = np.array((*self._pressure_pa, held_pa, pressure_pa))
            return
        self.replace_from(start_s, np.zeros(1), np.array([pressure_pa]))

    def hold_from(self, start_s: float) -> None:
        """From ``start_s`` on hold the pressure of that time."""
        self.step_to(start_s, self.at(start_s))

    def between(self, from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        """Corners of the piece from ``from_s`` (after a step there) to ``to_s`` (before a step there)."""
        if to_s <= from_s:
            return np.full(2, from_s), np.full(2, self.at(from_s))
        inside = (self._time_s > from_s) & (self._time_s < to_s)
        time_s = np.concatenate([[from_s], self._time_s[inside], [to_s]])
        return time_s, np.concatenate([[self.at(from_s)], self._pressure_pa[inside], [self._at_left(to_s)]])

    def forget(self, before_s: float) -> None:
        """Drop the corners that no question about ``before_s`` or later needs."""
        if self._time_s.size == 1:
            return
        first = int(np.searchsorted(self._time_s, before_s, side="right")) - 1
        if first > 0:
            self._time_s = self._time_s[first:].copy()
            self._pressure_pa = self._pressure_pa[first:].copy()

    def _at_left(self, time_s: float) -> float:
        """Pressure just before this time; the first corner's before all."""
        after = int(np.searchsorted(self._time_s, time_s, side="left"))
        if after == 0:
            return float(self._pressure_pa[0])
        if after == self._time_s.size:
            return float(self._pressure_pa[-1])
        run_s = self._time_s[after] - self._time_s[after - 1]
        share = (time_s - self._time_s[after - 1]) / run_s
        return float(self._pressure_pa[after - 1] + share * (self._pressure_pa[after] - self._pressure_pa[after - 1]))
