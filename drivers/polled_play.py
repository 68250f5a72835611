"""The polled way: command and look from here, a slot of a fixed grid at a time."""

from __future__ import annotations

import asyncio
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
_GLANCE_PERIOD_S: Final = 0.1  # how often the output is looked at just before it is commanded anew


class PolledPlay:
    """Plays one waveform on a valve by commands and keeps what was seen; ``on_share`` hears what share is done.

    Once ``enough`` is set no further slot is commanded: the motion goes on as at the waveform's end.
    """

    def __init__(
        self,
        course: Course,
        on_samples: Callable[[SampleBlock], None],
        on_share: Callable[[float], None],
        enough: asyncio.Event | None = None,
    ) -> None:
        self._course = course
        self._on_samples = on_samples
        self._on_share = on_share
        self._enough = enough
        #: How long the waveform was played, s, where it was ended before its end because enough is known.
        self.ended_early_s: float | None = None
        self._rows: PolledRows | None = None
        self._slot = 0

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return what was recorded; None where nothing was."""
        return None if self._rows is None else self._rows.recording(provenance)

    async def play(self, mover: Mover) -> None:
        """Command and look once a slot of a fixed grid; a slot that is missed is not made up for.

        One that has begun is taken late as long as a sample fits in what is left of it (of a slow device: while half
        of it is left), no sooner than half a slot after the sample before.
        """
        self._rows = rows = PolledRows(time.monotonic())
        try:
            await self._play(mover, rows)
        except BaseException:
            self._tell(rows)
            raise

    async def _play(self, mover: Mover, rows: PolledRows) -> None:
        period_s, start_s = self._course.period_s, rows.start_s
        told_s = glanced_s = start_s
        begun_s, took_s, quickest_s = -math.inf, 0.0, 0.5 * period_s
        while self._slot < self._course.samples:
            if self._enough is not None and self._enough.is_set():
                mover.require_leave()  # whoever stops it at the same moment, or a lost permissive, comes first
                self.ended_early_s = time.monotonic() - start_s
                self._tell(rows)
                return
            due_s = start_s + self._slot * period_s
            if due_s - glanced_s >= _GLANCE_PERIOD_S and 2.0 * took_s < period_s:
                # Just before its slot, in time that nobody needs: the samples keep their grid.
                await mover.pause_until(due_s - took_s)
                await mover.glance()
                glanced_s = due_s
            # Half a slot apart also after a delay: a device's own scan may be as slow as that.
            await mover.pause_until(max(due_s, begun_s + 0.5 * period_s))
            begun_s = time.monotonic()
            sample = await mover.step(self._course.pressure_pa(begun_s - start_s))
            now_s = time.monotonic()
            took_s = now_s - begun_s
            quickest_s = min(quickest_s, took_s)
            rows.add(sample or gap(begun_s, now_s), mover.device.in_force_pa, mover.written, begun_s - due_s)
            self._slot = max(self._slot + 1, math.floor((now_s + quickest_s - start_s) / period_s))
            if now_s - told_s >= _TELL_PERIOD_S or self._slot >= self._course.samples:
                told_s = now_s
                self._tell(rows)

    def _tell(self, rows: PolledRows) -> None:
        fresh = rows.fresh()
        if fresh is not None:
            self._on_samples(fresh)
        self._on_share(min(1.0, self._slot / self._course.samples))
