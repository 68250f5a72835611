"""What is asked of the program that moves valves, what it tells meanwhile, and how a motion ended."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from drivers.motion.plant_read import PlantRead
from drivers.outcome import PlayOutcome, Recovered, SampleBlock
from drivers.permissive import Permissive
from drivers.stands_at import StandsAt
from valve.errors import InternalError
from valve.waveform import Waveform


class MotionLostError(InternalError):
    """The program that moves valves is not there, or ended while it was asked; ``why`` is that in a few words."""

    def __init__(self, text: str, why: str = "") -> None:
        super().__init__(text)
        self.why = why or text


@dataclass(frozen=True, slots=True)
class Order:
    """One motion that is asked for: which valve, which waveform, and the number that fences it.

    ``permit`` is the work permit that the request named, where the valve demands one. ``requested_by``, ``started_at``
    (ISO 8601) and ``software`` go into the journal and the audit log. ``may_end_early`` where a polled test need not
    be played to its end. ``until`` and ``together`` are for whoever fetches its end: what was to be known for an early
    one, and the tests that it is analysed with. ``read`` is the valve's fingerprint as whoever asks has read plant.toml
    (``plant_read.valve_read``): where this process has read another one nothing moves. Empty: it is not asked.
    """

    run_id: str
    tag: str
    waveform: Waveform
    sequence: str
    run_number: int
    permit: str | None = None
    requested_by: str = ""
    started_at: str = ""
    software: str = ""
    may_end_early: bool = False
    until: Mapping[str, str] | None = None
    together: tuple[str, ...] = ()
    read: str = ""


@dataclass(frozen=True, slots=True)
class Armed:
    """A motion that is about to begin: what the device commanded before it (Pa, None where it showed none), what the
    device says it is, and what must hold, each met.
    """

    entry_pa: float | None
    device: str
    permissives: tuple[Permissive, ...]


@dataclass(frozen=True, slots=True)
class Heard:
    """Who is told what happens, in order; none of it holds a motion up.

    ``on_armed`` comes once everything that moves nothing is done, ``on_commanded`` where something was sent that can
    move the valve, ``on_samples`` with samples that the journal on disk has, ``on_progress`` with a share and a phase.
    """

    on_armed: Callable[[Armed], None] = lambda _: None
    on_samples: Callable[[SampleBlock], None] = lambda _: None
    on_progress: Callable[[float, str], None] = lambda *_: None
    on_commanded: Callable[[], None] = lambda: None


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """How a motion ended. ``faults`` are why its samples or its end could not be written, ``stopped`` why it was
    stopped, "" where it was not; ``entry_pa`` is what the device commanded before it, Pa, None where unknown.
    ``early`` is what whoever had it end early gave as the reason; None where nobody did, or gave one.
    """

    outcome: PlayOutcome
    entry_pa: float | None = None
    faults: tuple[str, ...] = ()
    stopped: str = ""
    early: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Left:
    """A motion that goes on, or has ended and was not fetched."""

    order: Order
    ended: bool


class Locks(Protocol):
    """Holds buses among all processes of a machine."""

    async def take_aside(self, buses: Iterable[str]) -> None:
        """Take all of them or none; what is held stays so. Raises BusyError where another process has one."""

    def give_back(self, buses: Iterable[str]) -> None:
        """Give them back; what is not held stays as it is."""

    def hold(self, buses: Iterable[str]) -> AbstractAsyncContextManager[None]:
        """Hold them for the length of a block. Raises BusyError."""


@dataclass(frozen=True, slots=True)
class Unread:
    """Why a valve in service is not read, with what to do, and since when."""

    reason: str
    since: datetime


class MotionLink(Locks, Protocol):
    """The way to the program that moves valves. Where it cannot be reached every method raises MotionLostError."""

    @property
    def outlives_us(self) -> bool:
        """Whether a motion goes on where whoever asked for it ends."""

    @property
    def precedence(self) -> bool | None:
        """Whether the system allows the polling real-time precedence; None where nobody asked it."""

    async def permissives(self, tag: str, permit: str | None, read: str) -> tuple[Permissive, ...]:
        """Read fresh what must hold before a valve may move, ``read`` as in an Order; nothing is written."""

    async def plant_read(self, digest: str) -> PlantRead | None:
        """Return what the motion process has read of plant.toml; None where that has this ``digest``."""

    async def play(self, order: Order, heard: Heard) -> MotionEnd:
        """Play a waveform; however it ends, the valve is sent to its safe value.

        Raises ValveError only where nothing was sent that can move the valve.
        """

    async def rejoin(self, run_id: str, heard: Heard) -> MotionEnd:
        """Hear the rest of a motion that somebody else asked for. Raises NotFoundError."""

    def stop(self, run_id: str, reason: str) -> None:
        """Send a valve to its safe value at once; nothing happens where its motion has ended."""

    def end_early(self, run_id: str, because: Mapping[str, float] | None = None) -> None:
        """Let a motion that may end early end as its waveform would; its end has the reason, numbers by name."""

    async def left(self) -> tuple[Left, ...]:
        """Return the motions that go on, and those whose end was not fetched."""

    def forget(self, run_id: str) -> None:
        """Remove what was kept of a motion's end: whoever asked for it has stored it."""

    async def recover(self, tag: str, run_number: int, entry_pa: float | None, *, commanded: bool | None) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now."""

    async def stands(self, tag: str, *, safe_pa: float | None, confirmed: bool | None, after_s: float) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written."""

    async def connect(self, within_s: float) -> None:
        """Connect where there is no connection. Raises BusyError where another service has it."""

    async def close(self) -> None:
        """End the connection; what goes on goes on."""

    async def reload(self, kept: Iterable[str]) -> None:
        """Read the plant file anew; the ``kept`` valves stay as they are until they are ``settled``.

        Raises ConfigurationError.
        """

    async def settled(self, tag: str) -> None:
        """Let a valve that was kept become what the plant file said when it was read last."""

    async def watched(self) -> Mapping[str, Mapping[str, int]]:
        """Return what became of the slots of each valve that is read in service: read, missed, failed, kept."""

    async def unread(self) -> Mapping[str, Unread]:
        """Return the valves in service that cannot be read now, by tag."""
