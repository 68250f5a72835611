"""What a run needs of the world of wires; tests put something else in its place."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.outcome import PlayOutcome, SafeOutcome, SampleBlock
from drivers.permissives import Permissive
from drivers.recovery import Recovered
from drivers.stands_at import StandsAt
from service.config.settings import PlantValve
from valve.waveform import Waveform


@dataclass(frozen=True, slots=True)
class Order:
    """One motion that is asked for: which valve, which waveform, and the number that fences it.

    ``permit`` is the work permit that the request named, where the valve demands one. ``enough`` is set where the
    test need not be played to its end.
    """

    valve: PlantValve
    waveform: Waveform
    sequence: str
    run_number: int
    permit: str | None = None
    enough: asyncio.Event | None = None


@dataclass(frozen=True, slots=True)
class Watcher:
    """Who is told what happens. ``on_ready`` is awaited after the device is identified and before anything moves.

    It gets what the device commanded at entry (Pa) and what the device says it is; ``on_permissives`` was told before
    what must hold, each met or not. ``on_intent`` is awaited before the first write that can move the valve, and is on
    disk when it returns. ``on_commanded`` is called, however the motion ends, where such a write went out.
    """

    on_ready: Callable[[float, str], Awaitable[None]]
    on_samples: Callable[[SampleBlock], None]
    on_progress: Callable[[float, str], None]
    on_permissives: Callable[[tuple[Permissive, ...]], None] = lambda _: None
    on_intent: Callable[[], Awaitable[None]] | None = None
    on_commanded: Callable[[], None] = lambda: None


class Rig(Protocol):
    """Drives valves."""

    def check(self, valve: PlantValve, waveform: Waveform) -> None:
        """Refuse what this valve must not do. Raises WaveformError."""

    async def permissives(self, valve: PlantValve, permit: str | None) -> tuple[Permissive, ...]:
        """Read fresh what must hold before this valve may move; nothing is moved."""

    async def play(self, order: Order, watcher: Watcher, stop: asyncio.Event) -> PlayOutcome:
        """Play a waveform; however it ends, the valve is sent to its safe value."""

    async def go_safe(self, valve: PlantValve, run_number: int, entry_pa: float | None) -> SafeOutcome:
        """Send a valve that was left alone to its safe value; return what it reached and why not. Raises nothing."""

    async def recover(
        self, valve: PlantValve, run_number: int, entry_pa: float | None, *, commanded: bool | None
    ) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now.

        Raises nothing. ``entry_pa`` is what its device commanded before the test, ``commanded`` whether the test
        commanded it; None where that is not known.
        """

    async def stands(
        self, valve: PlantValve, *, safe_pa: float | None, confirmed: bool | None, after_s: float
    ) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written, never raises for a wire.

        ``safe_pa`` is its safe value, ``confirmed`` whether that was read back after the motion.
        """
