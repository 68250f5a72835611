"""The captured way: the device plays and samples by its own clock; it is watched meanwhile and its samples fetched."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from drivers.capture_buffer import CaptureBuffer, Progress
from drivers.course import Course
from drivers.mover import Mover, StopAskedError
from drivers.outcome import Sample, SampleBlock
from drivers.rows import CapturedRows
from valve.errors import DeviceError, EquipmentError
from valve.messages import say
from valve.recording import Provenance, Recording

_WATCH_PERIOD_S: Final = 0.1
_UPLOAD_BLOCK: Final = 25  # windows
_UPLOAD_AFTER_STOP_S: Final = 10.0  # a slow line would need minutes, and whoever stopped wants the valve back


class CapturedPlay:
    """Lets the device play one waveform; ``on_share`` hears how much of playing or of fetching is done, 0 to 1."""

    def __init__(
        self,
        buffer: CaptureBuffer,
        course: Course,
        on_samples: Callable[[SampleBlock], None],
        on_share: Callable[[float], None],
    ) -> None:
        self._buffer = buffer
        self._course = course
        self._on_samples = on_samples
        self._on_share = on_share
        self._rows = CapturedRows(course.period_s)

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return what was fetched; None where nothing was."""
        return self._rows.recording(provenance)

    async def hand_over(self, mover: Mover) -> None:
        """Give the device what it is to play, with its watchdog fed. Raises StopAskedError when a stop comes."""
        async for _ in self._buffer.hand_over(self._course, mover.device.run_number):
            mover.require_no_stop()
            await mover.device.feed_watchdog()

    async def play(self, mover: Mover) -> None:
        """Let the device play; look at it now and then, keep its watchdog fed, and end with it."""
        device, rules, buffer = mover.device, mover.rules, self._buffer
        device.commanded = True
        device.in_force_pa = math.nan
        await buffer.start()
        while True:
            await mover.pause_until(time.monotonic() + _WATCH_PERIOD_S)
            sample: Sample | None = None
            progress: Progress | None = None
            try:
                await device.feed_watchdog()
                mover.require_no_stop()
                progress = await buffer.progress()
                mover.require_no_stop()
                sample = await device.read()
                mover.require_no_stop()
            except EquipmentError as error:
                rules.missed(error)
            fault = rules.fault(sample, follows=False)
            if fault is not None:
                raise fault
            if sample is None or progress is None:
                continue
            self._on_samples(_glimpse(sample, progress.taken * self._course.period_s))
            self._on_share(min(1.0, progress.taken / self._course.samples))
            if progress.done:
                return
            if not progress.running:
                raise DeviceError(
                    say(
                        "capture_ended_by_device",
                        "{tag}: the device ended its capture after {samples} samples by itself",
                        tag=device.tag,
                        samples=progress.taken,
                    )
                )

    async def fetch(self, mover: Mover) -> str:
        """Fetch the samples of this run; the valve rests at its safe value meanwhile.

        A stop ends it after the transaction under way; where the stop came before, it may take
        ``_UPLOAD_AFTER_STOP_S``. Returns words about samples that were left behind, none where there are none. Raises
        EquipmentError where some are lost.
        """
        until_s = time.monotonic() + _UPLOAD_AFTER_STOP_S if mover.stop_asked else -math.inf
        fetched, wanted = 0, self._course.samples
        ready: list[SampleBlock] = []

        def heard() -> None:
            if mover.stop_asked and time.monotonic() > until_s:
                raise StopAskedError

        try:
            await mover.device.feed_watchdog()
            heard()
            progress = await self._buffer.progress(agreed=True, after_each=heard)
            if progress.run_number != mover.device.run_number:
                return ""  # stopped before it was handed over: what the device keeps is another run's
            wanted = min(progress.taken, wanted)
            async for window in self._buffer.windows(wanted, after_each=heard):
                ready.append(self._rows.add(window))
                fetched = window.first + window.position_m.size
                if len(ready) == _UPLOAD_BLOCK or fetched == wanted:
                    self._hand_on(ready, fetched / wanted)
                if fetched < wanted:
                    heard()
                    await mover.device.feed_watchdog()  # on a slow line a window takes a good part of a second
        except StopAskedError:
            self._hand_on(ready, 1.0)
            return say(
                "upload_stopped",
                "{fetched} of {wanted} samples were fetched when the stop ended the upload",
                fetched=fetched,
                wanted=wanted,
            )
        return ""

    def _hand_on(self, ready: list[SampleBlock], share: float) -> None:
        if ready:
            self._on_samples(_joined(ready))
            ready.clear()
        self._on_share(share)


def _glimpse(sample: Sample, time_s: float) -> SampleBlock:
    """One look at a captured test: for the eye, not for the recording."""
    time, position, pressure, command = np.array(
        [[time_s], [sample.position_m], [sample.pressure_pa], [sample.output_pa]], dtype=np.float64
    )
    return SampleBlock(time, position, pressure, command, sent_s=None, received_s=None, recorded=False)


def _joined(blocks: list[SampleBlock]) -> SampleBlock:
    return SampleBlock(
        np.concatenate([block.time_s for block in blocks]),
        np.concatenate([block.position_m for block in blocks]),
        np.concatenate([block.pressure_pa for block in blocks]),
        np.concatenate([block.command_pa for block in blocks]),
        None,
        None,
        recorded=True,
    )
