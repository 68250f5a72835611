"""Behaviour unlike that of a test so far, seen while it happens: a force that no breakaway before asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from drivers.outcome import SampleBlock
from valve.messages import say

_TWICE: Final = 2.0
_LEAST: Final = 0.6  # of the usual breakaway: one that was small by chance makes no usual one an alarm
_ROWS: Final = 3  # one after the other: a single sample may be wrong
_AT_STOP: Final = 0.01  # of rated travel: on a stop the force may be anything
_BACK: Final = 5  # rows over which it is seen whether the stem stands
_STANDS: Final = 0.3  # of the way that the rising force would push a stem that slides


class OutOfFamily:
    """Holds each sample against the last breakaway; ``travel_m`` is the rated travel."""

    def __init__(self, travel_m: float) -> None:
        self._travel_m = travel_m
        self._family: Mapping[str, Any] | None = None
        self._rows = 0
        self._before = np.zeros((2, 0))  # position, m, and pressure, Pa, of the last rows

    def know(self, family: Mapping[str, Any] | None) -> None:
        """Take what an estimate so far says (``service.runs.so_far``); None leaves what was known."""
        self._family = family or self._family

    def notice(self, block: SampleBlock) -> dict[str, Any] | None:
        """Return the event of a force that is twice the last breakaway's, once while that goes on; None otherwise.

        The force is |A p - k x - F_0|, by the pressure that was measured, while it rises on a stem that stands off its
        stops.
        """
        rows = np.hstack((self._before, [block.position_m, block.pressure_pa]))
        self._before, old = rows[:, -_BACK:], self._before.shape[1]
        family = self._family
        if family is None or old < _BACK:
            return None
        position_m, pressure_pa = rows
        ends_m = np.array([0.0, self._travel_m, *family["stops_m"]])
        off_stop = np.abs(block.position_m[:, None] - ends_m).min(axis=1) > _AT_STOP * self._travel_m
        inside = off_stop & (block.position_m > 0.0) & (block.position_m < self._travel_m)
        sprung_n = family["spring_n_per_m"] * position_m
        pushed_n = family["area_m2"] * pressure_pa
        force_n = np.abs(pushed_n - sprung_n - family["preload_n"])
        gone_n, risen_n = (np.abs(one[_BACK:] - one[:-_BACK]) for one in (sprung_n, pushed_n))
        inside &= (gone_n < _STANDS * risen_n) & (force_n[_BACK:] > force_n[:-_BACK])
        force_n = force_n[_BACK:]
        most_n = _TWICE * max(family["last_n"], _LEAST * family["usual_n"])
        found = None
        for is_out, at_n, at_s in zip((inside & (force_n > most_n)).tolist(), force_n, block.time_s, strict=True):
            self._rows = self._rows + 1 if is_out else 0
            if self._rows == _ROWS:
                found = {"kind": "breakaway", "time_s": float(at_s), "force_n": float(at_n), "last_n": family["last_n"]}
                found["breakaway"] = family["breakaways"] + 1
        if found is None:
            return None
        words = say(
            "twice_last_breakaway",
            "The stem takes {force:.0f N}, twice its last breakaway of {last:.0f N}.",
            force=found["force_n"],
            last=found["last_n"],
        )
        return {**found, "sentence": words}
