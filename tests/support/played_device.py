"""A valve on a raw reference device, and what came out of playing on it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.addresses import MotionLimits, Point, Sampling, ValveWiring, WatchdogChoice
from drivers.device import ValveDevice
from drivers.outcome import PlayOutcome, SampleBlock
from drivers.sequence import play_sequence
from tests.support.reference_device import SPAN_PA, ReferenceDevice
from valve.recording import Provenance
from valve.waveform import Waveform, triangle

LIMITS = MotionLimits((0.0, SPAN_PA), 400_000.0, 30.0)
SAFE_PA = 5_000.0
WIRING = ValveWiring(
    "FV-101",
    Point("bus", 1, "reference"),
    SAFE_PA,
    LIMITS,
    Sampling("polled", 0.02),  # type: ignore[arg-type]  # the text is turned into a Mode
    watchdog=WatchdogChoice(timeout_s=2.0),
)
WAVE = triangle(0.5, 1, 10_000.0, 60_000.0)


@dataclass
class Bench:
    """A device under test and what came out of playing on it."""

    device: ReferenceDevice
    valve: ValveDevice
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    blocks: list[SampleBlock] = field(default_factory=list)
    phases: list[tuple[float, str]] = field(default_factory=list)
    on_phase: Callable[[str], None] = lambda _: None

    def progress(self, share: float, phase: str) -> None:
        self.phases.append((share, phase))
        self.on_phase(phase)

    async def play(
        self, waveform: Waveform = WAVE, mode: str = "polled", period_s: float = 0.02, **more: Any
    ) -> PlayOutcome:
        return await play_sequence(
            self.valve,
            waveform,
            mode=mode,
            period_s=period_s,
            run_number=7,
            stop=self.stop,
            on_samples=more.pop("on_samples", self.blocks.append),
            on_progress=self.progress,
            limits=more.pop("limits", LIMITS),
            provenance=Provenance(started_at="2026-11-20T10:00:00+00:00"),
            **more,
        )

    @property
    def moved_pa(self) -> list[float]:
        return [pressure_pa for _, pressure_pa in self.device.moves]


async def until(condition: Callable[[], bool]) -> None:
    """Wait for a condition, a minute at most."""
    async with asyncio.timeout(60.0):
        while not condition():  # noqa: ASYNC110  - it is looked at from outside, nothing would set an event
            await asyncio.sleep(0.01)
