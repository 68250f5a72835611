"""The polled way: command and look from here, a slot of a fixed grid at a time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

from drivers.course import Course
from drivers.mover import Mover
from drivers.outcome import SampleBlock
from drivers.rows import PolledRows, gap
from valve.recording import Provenance, Recording

_TELL_PERIOD_S: Final = 0.1  # how often samples are handed on


class PolledPlay:
    """Plays one waveform on a valve by commands and keeps what was seen; ``on_share`` hears what share is done."""

    def __init__(
        self,
        course: Course,
        on_samples: Callable[[SampleBlock], None],
        on_share: Callable[[float], None],
    ) -> None:
        self._course = course
        self._on_samples = on_samples
        self._on_share = on_share
        self._rows: PolledRows | None = None

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return what was recorded; None where nothing was."""
        return None if self._rows is None else self._rows.recording(provenance)

    async def play(self, mover: Mover) -> None:
        """Command and look once a slot of a fixed grid; a slot that is missed is not made up for."""
        start_s = time.monotonic()
        self._rows = rows = PolledRows(start_s)
        slot, told_s = 0, start_s
        while slot < self._course.samples:
            due_s = start_s + slot * self._course.period_s
            await mover.pause_until(due_s)
            begun_s = time.monotonic()
            try:
                sample = await mover.step(self._course.pressure_pa(begun_s - start_s))
            except BaseException:
                self._tell(rows, slot)
                raise
            now_s = time.monotonic()
            rows.add(sample or gap(begun_s, now_s), mover.device.in_force_pa, mover.written, begun_s - due_s)
            slot = max(slot + 1, math.floor((now_s - start_s) / self._course.period_s + 0.5))
            if now_s - told_s >= _TELL_PERIOD_S or slot >= self._course.samples:
                told_s = now_s
                self._tell(rows, slot)

    def _tell(self, rows: PolledRows, slot: int) -> None:
        fresh = rows.fresh()
        if fresh is not None:
            self._on_samples(fresh)
        self._on_share(min(1.0, slot / self._course.samples))
