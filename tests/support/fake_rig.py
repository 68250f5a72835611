"""A rig without wires, and an analyst that answers at once: what runs do is tested without a device."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.addresses import ValveWiring
from drivers.motion.orders import Order
from drivers.motion.rig import Watcher
from drivers.outcome import Ended, PlayOutcome, Recovered, SafeOutcome, SampleBlock
from drivers.permissive import Permissive
from drivers.stands_at import StandsAt, stands_at
from service.own_files.reader import own_from_bytes
from valve.errors import DeviceError
from valve.nameplate import Nameplate
from valve.recording import Recording
from valve.recording_files import file_content, read_recording


class FakeRig:
    """Plays a waveform of any length in ``duration_s``; ``moving`` is set once it does."""

    def __init__(self, duration_s: float = 0.05) -> None:
        self.duration_s = duration_s
        self.orders: list[Order] = []
        self.wirings: list[ValveWiring] = []
        self.safe_calls: list[tuple[str, int, float | None]] = []
        self.safe_confirmed = True
        self.refusal: Exception | None = None
        self.break_at: float | None = None
        self.failure: Exception = DeviceError("FV-101: the stem is stuck: look at it")
        self.moving = asyncio.Event()
        self.permits: list[str | None] = []
        self.stem_m: float | None = 0.0
        self.recoveries: list[tuple[str, int, float | None, bool | None]] = []
        self.recovered = Recovered(SafeOutcome(True), sent=True)
        self.looks: list[tuple[str, float]] = []
        self.shown: tuple[Permissive, ...] = (Permissive("loop_in_manual", True, "in manual", "the loop in manual"),)

    async def permissives(self, _wiring: ValveWiring, permit: str | None) -> tuple[Permissive, ...]:
        self.permits.append(permit)
        return self.shown

    async def play(
        self,
        wiring: ValveWiring,
        order: Order,
        watcher: Watcher,
        stop: asyncio.Event,
        _enough: asyncio.Event | None = None,
    ) -> PlayOutcome:
        self.orders.append(order)
        self.wirings.append(wiring)
        if self.refusal is not None:
            raise self.refusal
        watcher.on_permissives(self.shown)
        await watcher.on_ready(1234.0, "fake device")
        if watcher.on_intent is not None:
            await watcher.on_intent()
        watcher.on_commanded()
        self.moving.set()
        blocks = 20
        time_s = np.linspace(0.0, order.waveform.duration_s, 200)
        command_pa = order.waveform.at(time_s)
        done = 0
        for number in range(1, blocks + 1):
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), self.duration_s / blocks)
            if stop.is_set():
                break
            part = slice(done, 10 * number)
            done = 10 * number
            watcher.on_samples(_block(time_s[part], command_pa[part]))
            watcher.on_progress(number / blocks, "playing")
            if self.break_at is not None and number / blocks >= self.break_at:
                raise self.failure
        recording = (
            None if done < 2 else Recording(time_s[:done], 1e-6 * command_pa[:done], command_pa=command_pa[:done])
        )
        ended = Ended.STOPPED if stop.is_set() else Ended.COMPLETED
        return PlayOutcome(recording, ended, self.safe_confirmed, notes=("no wire",))

    async def go_safe(self, wiring: ValveWiring, run_number: int, entry_pa: float | None) -> SafeOutcome:
        self.safe_calls.append((wiring.tag, run_number, entry_pa))
        return SafeOutcome(self.safe_confirmed, reason="" if self.safe_confirmed else "the device shows 7 Pa")

    async def recover(
        self, wiring: ValveWiring, run_number: int, entry_pa: float | None, *, commanded: bool | None
    ) -> Recovered:
        self.recoveries.append((wiring.tag, run_number, entry_pa, commanded))
        return replace(self.recovered, sent=self.recovered.sent and commanded is True)

    async def stands(
        self, wiring: ValveWiring, *, safe_pa: float | None, confirmed: bool | None, after_s: float
    ) -> StandsAt:
        self.looks.append((wiring.tag, after_s))
        return stands_at(
            wiring.rest,
            after_s=after_s,
            safe_pa=safe_pa,
            confirmed=confirmed,
            signal_pa=safe_pa,
            stem_m=self.stem_m,
            stem_unread="" if self.stem_m is not None else "bus gauge-1: no answer: check the gauge",
        )


def _block(time_s: Any, command_pa: Any) -> SampleBlock:
    return SampleBlock(
        time_s=time_s,
        position_m=1e-6 * command_pa,
        pressure_pa=np.full(time_s.shape, np.nan),
        command_pa=command_pa,
        sent_s=time_s - 0.001,
        received_s=time_s + 0.001,
        recorded=True,
        late_s=np.full(time_s.shape, 0.015),
    )


class FakeAnalyst:
    """Reads the file and counts its samples."""

    def __init__(self) -> None:
        self.let_go = asyncio.Event()
        self.let_go.set()
        self.asked: list[tuple[Any, ...]] = []
        self.uploads = 0
        self.behind = 0
        self.discrepancy: dict[str, Any] = {"verdict": "not_assessed"}

    async def analyze(
        self,
        recording_path: Path,
        nameplate: Nameplate,
        progress: Any = None,
        *,
        together: Sequence[Path] = (),
        held_out: Sequence[tuple[str, Path]] = (),
        accepted: Mapping[str, Any] | None = None,
        room: Mapping[str, float] | None = None,
        upload: bool = False,
        behind: bool = False,
        mapping: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        self.uploads += upload
        self.behind += behind
        self.asked.append((tuple(together), tuple(held_out), accepted, room))
        await self.let_go.wait()
        if mapping is None:
            recording = read_recording(recording_path, nameplate)
        else:
            recording = own_from_bytes(file_content(recording_path), str(recording_path), nameplate, mapping).recording
        if progress is not None:
            progress(1.0, "done")
        return {
            "schema": "breakaway/analysis/1",
            "recording": {"samples": recording.samples},
            "discrepancy": dict(self.discrepancy),
            "estimates": [],
            "health": {"ne107": None, "reasons": []},
        }
