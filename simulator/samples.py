"""What is sampled of a software valve: values at sample times, what is still to be shown, the truth of a record."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from simulator.packed_stem import Truth

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Samples:
    """True values at sample times, all of shape (n,).

    ``sensed_m`` and ``gauge_pa`` are position and pressure behind their sensors' filters, taken at ``sensed_at_s`` and
    ``gauge_at_s``: the sample times, unless a sensor has a clock of its own.
    """

    position_m: FloatArray
    sensed_m: FloatArray
    pressure_pa: FloatArray
    gauge_pa: FloatArray
    asked_pa: FloatArray
    sensed_at_s: FloatArray
    gauge_at_s: FloatArray


def joined(pieces: list[Samples]) -> Samples | None:
    """Return the pieces as one; None without any."""
    if len(pieces) < 2:
        return pieces[0] if pieces else None
    return Samples(*(np.concatenate([getattr(piece, entry.name) for piece in pieces]) for entry in fields(Samples)))


@dataclass(frozen=True, slots=True)
class EndedRecord:
    """A record that has ended: from when to when, simulated s, and what an estimate of it is judged by."""

    from_s: float
    until_s: float
    truth: Truth


class Memory:
    """What sensors with clocks of their own are still to show, straight between what was noted."""

    def __init__(self, time_s: float, sensed_m: float, gauge_pa: float) -> None:
        self._rows = np.array([[time_s], [sensed_m], [gauge_pa]])

    def note(self, time_s: FloatArray, sensed_m: FloatArray, gauge_pa: FloatArray) -> None:
        """Note what there was at these times, later than all before; arrays: shape (n,)."""
        old = self._rows[:, self._rows[0] < time_s[0]]
        self._rows = np.concatenate((old, np.vstack((time_s, sensed_m, gauge_pa))), axis=1)

    def forget(self, before_s: float) -> None:
        """Drop what no question about ``before_s`` or later needs."""
        first = max(int(np.searchsorted(self._rows[0], before_s, side="right")) - 1, 0)
        self._rows = self._rows[:, first:]

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and pressure at these times, held beyond what is known; shape as given."""
        known_s, sensed_m, gauge_pa = self._rows
        return np.interp(time_s, known_s, sensed_m), np.interp(time_s, known_s, gauge_pa)
