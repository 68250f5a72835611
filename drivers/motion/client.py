"""The way from the service to the program that moves valves: its local socket."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import structlog

from drivers.motion.local_socket import connected
from drivers.motion.orders import Armed, Heard, Left, MotionEnd, MotionLostError, Order, Unread
from drivers.motion.plant_read import PlantRead
from drivers.motion.spool import Spool, end_of_json
from drivers.motion.wire_format import PROTOCOL, error_of, line_of, of_json, said_in, to_json
from drivers.outcome import Recovered, SafeOutcome, SampleBlock
from drivers.permissive import Permissive
from drivers.stands_at import StandsAt
from valve.errors import NotFoundError
from valve.messages import message_of, say

_AGAIN_S: Final = 0.2
_QUICK_S: Final = 0.5
_STOPPED_S: Final = 30.0
_PATIENCE_S: Final = 2.0  # for a motion process that is just being started again
_RECOVERY_S: Final = 60.0  # a valve that was left alone is worth more waiting
_LOG = structlog.get_logger(__name__)


class MotionClient:
    """One connection, opened when it is needed and again where it broke; ends of motions come by ``folder``."""

    outlives_us = True

    def __init__(self, socket: Path, folder: Path) -> None:
        self._socket = socket
        self._spool = Spool(folder)
        self._line: _Line | None = None
        self._opening = asyncio.Lock()
        self._numbers = itertools.count(1)
        self._closed = False
        self._stops: dict[str, str] = {}  # that were asked for, until their motion has its end
        #: Whether the system allows the motion process real-time precedence; None where that was never heard.
        self.precedence: bool | None = None

    async def close(self) -> None:
        """End the connection; motions go on."""
        self._closed = True
        if self._line is not None:
            await self._line.close()

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection."""
        return self._line is not None and self._line.is_open

    async def connect(self, within_s: float = _PATIENCE_S) -> None:
        """Connect. Raises MotionLostError where nobody answers in time, BusyError where another service is there."""
        await self._connected(within_s)

    async def _connected(self, within_s: float) -> _Line:
        """Return a line that stands. Raises MotionLostError where there is none in time, BusyError."""
        why: str = say("does_not_answer", "it does not answer")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(within_s or _QUICK_S), self._opening:
                while self._line is None or not self._line.is_open:
                    if self._closed:
                        raise MotionLostError(say("service_ending", "the service is ending"))
                    try:
                        self._line = await self._opened()
                    except (OSError, MotionLostError) as error:
                        why = (error.strerror if isinstance(error, OSError) else message_of(error)) or why
                        await asyncio.sleep(_AGAIN_S)
                return self._line
        raise MotionLostError(
            say(
                "motion_process_missing",
                "the motion process does not answer at {socket} ({why}): start it (breakaway motion --config "
                "plant.toml); until then no valve can be moved",
                socket=str(self._socket),
                why=why,
            ),
            say("socket_and_why", "{socket}: {why}", socket=self._socket.name, why=why),
        )

    async def _opened(self) -> _Line:
        line = _Line(*await connected(self._socket))
        try:
            said = await line.ask(next(self._numbers), "own", protocol=PROTOCOL)
        except BaseException:
            await line.close()
            raise
        self.precedence = said["precedence"]
        for run_id, reason in self._stops.items():  # pressed while there was no line
            line.send({"say": "stop", "run_id": run_id, "reason": reason})
        _LOG.info("motion process connected", software=said["software"])
        return line

    async def _ask(self, name: str, *, within_s: float = _PATIENCE_S, **said: Any) -> Any:
        line = await self._connected(within_s)
        return await line.ask(next(self._numbers), name, **said)

    def _say(self, name: str, **said: Any) -> None:
        if self._line is not None and self._line.is_open:
            self._line.send({"say": name, **said})

    # ---- buses

    async def take_aside(self, buses: Iterable[str]) -> None:
        """Take all of them or none; what is held stays so. Raises BusyError where another process has one."""
        wanted = sorted(buses)
        try:
            await self._ask("take", buses=wanted)
        except asyncio.CancelledError:
            self.give_back(wanted)
            raise

    def give_back(self, buses: Iterable[str]) -> None:
        """Give them back, but for those that a motion uses."""
        self._say("give_back", buses=sorted(buses))

    @asynccontextmanager
    async def hold(self, buses: Iterable[str]) -> AsyncIterator[None]:
        """Hold them for the length of the block. Raises BusyError."""
        number = next(self._numbers)
        try:
            await self._ask("hold", buses=sorted(buses), held=number)
            yield
        finally:
            self._say("release", held=number)

    # ---- looks, which write nothing

    async def permissives(self, tag: str, permit: str | None, read: str) -> tuple[Permissive, ...]:
        """Read fresh what must hold before a valve may move, ``read`` as in an Order; nothing is written."""
        said = await self._ask("permissives", tag=tag, permit=permit, read=read)
        return tuple(of_json(Permissive, one) for one in said)

    async def stands(self, tag: str, *, safe_pa: float | None, confirmed: bool | None, after_s: float) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written."""
        return of_json(
            StandsAt, await self._ask("stands", tag=tag, safe_pa=safe_pa, confirmed=confirmed, after_s=after_s)
        )

    async def plant_read(self, digest: str) -> PlantRead | None:
        """Return what the motion process has read of plant.toml; None where that has this ``digest``."""
        said = await self._ask("plant_read", digest=digest)
        return None if said is None else of_json(PlantRead, said)

    # ---- motion

    async def play(self, order: Order, heard: Heard) -> MotionEnd:
        """Play a waveform; it goes on where the caller is cancelled. Raises ValveError only where nothing moved."""
        return await self._followed(order.run_id, heard, "play", order=to_json(order))

    async def rejoin(self, run_id: str, heard: Heard) -> MotionEnd:
        """Hear the rest of a motion that somebody else asked for, or its end. Raises NotFoundError, as ``play``."""
        try:
            return await self._followed(run_id, heard, "rejoin", run_id=run_id)
        except MotionLostError:
            if any(one.order.run_id == run_id for one in await asyncio.to_thread(self._spool.all)):
                return await asyncio.to_thread(self._spool.read, run_id)
            raise

    async def _followed(self, test: str, heard: Heard, name: str, **said: Any) -> MotionEnd:
        line = await self._connected(_PATIENCE_S)
        line.heard[test] = heard
        try:
            end = await line.ask(next(self._numbers), name, **said)
        finally:
            line.heard.pop(test, None)
        self._stops.pop(test, None)
        recording = None
        if end["recording"] is not None:
            try:
                recording = await asyncio.to_thread(self._spool.recording, test, end)
            except (OSError, ValueError, EOFError, BadZipFile) as error:  # the journal has what was sampled
                end["faults"].append(
                    say(
                        "recording_not_fetched",
                        "the recording could not be fetched from the motion process ({why})",
                        why=message_of(error),
                    )
                )
        return end_of_json(end, recording)

    def stop(self, run_id: str, reason: str) -> None:
        """Send a valve to its safe value at once, or as soon as there is a line; nothing where its motion has ended."""
        self._stops[run_id] = reason
        self._say("stop", run_id=run_id, reason=reason)

    def end_early(self, run_id: str, because: Mapping[str, float] | None = None) -> None:
        """Let a motion that may end early end as its waveform would; its end has the reason, numbers by name."""
        self._say("end_early", run_id=run_id, because=because)

    async def left(self) -> tuple[Left, ...]:
        """Return the motions that go on, and those whose end was not fetched; without a motion process these alone.

        Raises MotionLostError where there is neither.
        """
        try:
            said = await self._ask("left")
        except MotionLostError:
            kept = await asyncio.to_thread(self._spool.all)
            if kept:
                return kept
            raise
        return tuple(Left(of_json(Order, one["order"]), one["ended"]) for one in said)

    def forget(self, run_id: str) -> None:
        """Remove what was kept of a motion's end: whoever asked for it has stored it."""
        self._stops.pop(run_id, None)
        if self.is_connected:
            self._say("forget", run_id=run_id)
        else:
            self._spool.remove(run_id)

    async def recover(self, tag: str, run_number: int, entry_pa: float | None, *, commanded: bool | None) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now."""
        about = {"tag": tag, "run_number": run_number, "entry_pa": entry_pa, "commanded": commanded}
        said = await self._ask("recover", within_s=_RECOVERY_S, **about)
        return Recovered(of_json(SafeOutcome, said["safe"]), said["sent"])

    async def reload(self, kept: Iterable[str]) -> None:
        """Read the plant file anew; the ``kept`` valves stay until they are ``settled``. Raises ConfigurationError."""
        await self._ask("reload", kept=sorted(kept))

    async def settled(self, tag: str) -> None:
        """Let a valve that was kept become what the plant file said when it was read last."""
        await self._ask("settled", tag=tag)

    async def watched(self) -> Mapping[str, Mapping[str, int]]:
        """Return what became of the slots of each valve that is read in service: read, missed, failed, kept."""
        said: dict[str, dict[str, int]] = await self._ask("watched", within_s=0.0)
        return said

    async def unread(self) -> Mapping[str, Unread]:
        """Return the valves in service that cannot be read now, by tag."""
        said: dict[str, Any] = await self._ask("unread", within_s=0.0)
        return {tag: of_json(Unread, one) for tag, one in said.items()}


async def stopped_here(socket: Path, what: str, reason: str) -> tuple[tuple[Order, MotionEnd], ...]:
    """Stop the motions of a valve, or of a test, without the service; return how they ended, without recordings.

    Raises MotionLostError where the motion process does not answer.
    """
    try:
        async with asyncio.timeout(_STOPPED_S):
            line = _Line(*await connected(socket))
            try:
                return await _stopped(line, what, reason)
            finally:
                await line.close()
    except OSError as error:  # a timeout is one
        why = error.strerror or say("not_within", "not within {stopped_s:g s}", stopped_s=_STOPPED_S)
        raise MotionLostError(
            say(
                "motion_process_silent",
                "the motion process does not answer at {socket} ({why}): a valve whose motion process is "
                "gone goes to its safe value by the watchdog of its device",
                socket=str(socket),
                why=why,
            )
        ) from error


async def _stopped(line: _Line, what: str, reason: str) -> tuple[tuple[Order, MotionEnd], ...]:
    left = (await line.ask(1, "state"))["left"]
    going = [of_json(Order, one["order"]) for one in left if not one["ended"]]
    ends = []
    for number, order in enumerate((one for one in going if what in (one.tag, one.run_id)), 2):
        with contextlib.suppress(NotFoundError):  # it came to its end meanwhile
            # A plain text: a motion process of an earlier version takes no ``messages`` with a question.
            said = await line.ask(number, "stop_and_wait", run_id=order.run_id, reason=str(reason))
            ends.append((order, end_of_json(said, None)))
    return tuple(ends)


class _Line:
    """One connection that stands, and who waits for what on it."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer
        self._waiting: dict[int, asyncio.Future[Any]] = {}
        self.heard: dict[str, Heard] = {}
        self._listening = asyncio.create_task(self._listen())

    @property
    def is_open(self) -> bool:
        """Whether it stands."""
        return not self._listening.done()

    async def close(self) -> None:
        """End it."""
        self._writer.close()
        self._listening.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await self._listening

    def send(self, message: dict[str, Any]) -> None:
        """Say something."""
        self._writer.write(line_of(message))

    async def ask(self, number: int, name: str, **said: Any) -> Any:
        """Return the answer to a question. Raises what it was answered with, MotionLostError where the line broke."""
        if not self.is_open:
            raise MotionLostError(_BROKE, _BROKEN)
        answered: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._waiting[number] = answered
        self.send({"id": number, "ask": name, **said})
        try:
            return await answered
        finally:
            self._waiting.pop(number, None)

    async def _listen(self) -> None:
        try:
            async for text in self._reader:
                self._take(said_in(text))
        except (OSError, ValueError, KeyError) as error:
            _LOG.warning("connection to the motion process broke", reason=str(error))
        finally:
            self._writer.close()
            for waiting in self._waiting.values():
                if not waiting.done():
                    waiting.set_exception(MotionLostError(_BROKE, _BROKEN))

    def _take(self, said: dict[str, Any]) -> None:
        if "run" in said:
            heard = self.heard.get(said["run"])
            if heard is not None:
                try:
                    _EVENTS[said["event"]](heard, said["value"])
                except Exception as error:  # noqa: BLE001  - whoever listens must not end the line of all the others
                    _LOG.error("what a motion told was not taken", test=said["run"], exc_info=error)
            return
        waiting = self._waiting.get(said["id"])
        if waiting is None or waiting.done():
            return
        if "error" in said:
            waiting.set_exception(error_of(said))
        else:
            waiting.set_result(said["answer"])


_BROKE: Final = say(
    "motion_process_gone",
    "the motion process ended, or its connection broke: until it is back the device's watchdog alone acts",
)
_BROKEN: Final = say("its_connection_broke", "its connection broke")


def _armed(heard: Heard, value: dict[str, Any]) -> None:
    permissives = tuple(of_json(Permissive, one) for one in value["permissives"])
    heard.on_armed(Armed(value["entry_pa"], value["device"], permissives))


_EVENTS: Final[dict[str, Callable[[Heard, Any], None]]] = {
    "armed": _armed,
    "samples": lambda heard, value: heard.on_samples(of_json(SampleBlock, value)),
    "progress": lambda heard, value: heard.on_progress(value[0], value[1]),
    "commanded": lambda heard, _value: heard.on_commanded(),
}
