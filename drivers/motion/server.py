"""Motion on a local socket, as ``drivers.motion.wire_format`` has its lines.

Who connects first and says ``own`` is the service, the one owner of motions; others may look, and stop.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Iterable
from typing import Any, Final

import structlog

from drivers.motion.motion import Motion
from drivers.motion.orders import Armed, Heard, MotionEnd, Order
from drivers.motion.precedence import Precedence
from drivers.motion.spool import end_to_json
from drivers.motion.wire_format import PROTOCOL, line_of, of_json, said_in, to_json
from drivers.outcome import SampleBlock
from valve.errors import BusyError, InternalError, RequestError, ValveError
from valve.messages import message_of, report_it, say

_MOST_UNREAD: Final = 64 * 1024 * 1024  # bytes that somebody has not fetched: then it hangs, and is let go
_END_S: Final = 1.0  # for answers that are under way when the process ends
_LOG = structlog.get_logger(__name__)


class MotionServer:
    """Answers at a socket for a ``motion``. Belongs to its event loop."""

    def __init__(self, motion: Motion, software: str, precedence: Precedence | None = None) -> None:
        self.motion = motion
        self._software = software
        self._precedence = precedence
        self._owner: _Client | None = None
        self._taken: set[str] = set()  # buses that the owner asked to hold
        self._looked_at: list[set[str]] = []  # and those that it holds for the length of a look
        self._clients: set[_Client] = set()
        self._serving: set[asyncio.Future[None]] = set()
        motion.on_end = self._let_go

    def accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one connection until it ends; a motion that was asked for on it goes on."""
        serving = asyncio.ensure_future(self._serve(reader, writer))
        self._serving.add(serving)
        serving.add_done_callback(self._serving.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        client = _Client(writer)
        self._clients.add(client)
        try:
            async for line in reader:
                self._hear(client, said_in(line))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            _LOG.warning("connection to the motion process broke", reason=str(error))
        finally:
            self._clients.discard(client)
            client.close()
            if client is self._owner:
                self._owner = None
                self._let_go()
                _LOG.warning("service gone: motions go on, none begins", moves=self.motion.moves)

    async def close(self) -> None:
        """End every connection once what was said is on its way."""
        for client in tuple(self._clients):
            await client.settled()
            client.close()
        if self._serving:
            await asyncio.wait(self._serving, timeout=_END_S)

    def _hear(self, client: _Client, said: dict[str, Any]) -> None:
        # Both begin at the loop's next turn: an order that came behind a question is carried out behind its beginning.
        if "say" in said:
            asyncio.get_running_loop().call_soon(self._do, client, said.pop("say"), said)
            return
        number, name = said.pop("id"), said.pop("ask")
        client.spawn(self._answer(client, number, name, said))

    def _do(self, client: _Client, name: str, said: dict[str, Any]) -> None:
        try:
            self._done(client, name, said)
        except (KeyError, TypeError) as error:
            _LOG.warning("order to the motion process not understood", said=name, reason=str(error))

    def _done(self, client: _Client, name: str, said: dict[str, Any]) -> None:
        if name == "stop":
            self.motion.stop(said["run_id"], said["reason"])
        elif client is self._owner and name == "end_early":
            self.motion.end_early(said["run_id"], said.get("because"))
        elif client is self._owner and name == "forget":
            self.motion.forget(said["run_id"])
        elif client is self._owner and name == "give_back":
            self._taken -= set(said["buses"])
            self._let_go()
        elif client is self._owner and name == "release":
            client.release(said["held"])

    def _let_go(self) -> None:
        """Give the buses back that nobody wants any more; those that a motion uses stay until its end."""
        if self._owner is None:
            self._taken.clear()
        looked_at = set().union(*self._looked_at)
        self.motion.give_back(self.motion.held - self._taken - looked_at)

    async def _answer(self, client: _Client, number: int, name: str, said: dict[str, Any]) -> None:
        try:
            ask = _ASKED.get(name)
            if ask is None:
                raise InternalError(
                    say(
                        "question_unknown",
                        "motion process: {question} is unknown: it and the service differ in version",
                        question=repr(name),
                    )
                )
            if client is not self._owner and name not in _FOR_ALL:
                raise RequestError(
                    say(
                        "question_for_service_alone",
                        "motion process: {question} is asked by the service alone",
                        question=name,
                    )
                )
            answer = await ask(self, client, **said)
        except ValveError as error:
            client.send({"id": number, **to_json(error)})
        except (TypeError, KeyError) as error:
            client.send(
                {
                    "id": number,
                    **to_json(
                        InternalError(
                            say(
                                "question_not_understood",
                                "motion process: {question}: {why}",
                                question=name,
                                why=message_of(error),
                            )
                        )
                    ),
                }
            )
        except Exception as error:  # noqa: BLE001  - whoever asked must hear something
            _LOG.error("question not answered", asked=name, exc_info=error)
            client.send({"id": number, **to_json(InternalError(report_it(error)))})
        else:
            client.send({"id": number, "answer": answer})

    # ---- what can be asked

    async def _own(self, client: _Client, protocol: int) -> dict[str, Any]:
        if protocol != PROTOCOL:
            raise BusyError(
                say(
                    "other_protocol",
                    "motion process: it speaks version {spoken} and the service version {heard}: install the "
                    "same version of both, and restart the motion process when no valve moves",
                    spoken=PROTOCOL,
                    heard=protocol,
                )
            )
        if self._owner is not None:
            raise BusyError(
                say("other_service_connected", "motion process: another service is connected to it: end that one")
            )
        self._owner = client
        allowed = None if self._precedence is None else self._precedence.allowed
        return {"software": self._software, "precedence": allowed}

    async def _state(self, _client: _Client) -> dict[str, Any]:
        return {"software": self._software, "left": [to_json(one) for one in await self.motion.left()]}

    async def _left(self, _client: _Client) -> list[Any]:
        return [to_json(one) for one in await self.motion.left()]

    async def _stop_and_wait(self, _client: _Client, run_id: str, reason: str) -> Any:
        self.motion.stop(run_id, reason)
        return end_to_json(await self.motion.end_of(run_id))

    async def _take(self, client: _Client, buses: list[str]) -> None:
        fresh = set(buses) - self._taken
        self._taken |= fresh  # before they are: a motion that ends meanwhile must not give them back
        try:
            await self.motion.take_aside(buses)
        except BaseException:
            self._taken -= fresh
            raise
        if client is not self._owner:
            self._let_go()

    async def _hold(self, client: _Client, buses: list[str], held: int) -> None:
        """Hold buses until the owner says ``release``, or is gone."""
        taken, over = asyncio.get_running_loop().create_future(), asyncio.Event()
        client.holds[held] = over
        client.spawn(self._holding(buses, taken, over))
        try:
            await taken
        except ValveError:
            client.holds.pop(held, None)
            raise

    async def _holding(self, buses: list[str], taken: asyncio.Future[None], over: asyncio.Event) -> None:
        wanted = set(buses)
        self._looked_at.append(wanted)
        try:
            async with self.motion.hold(buses):
                if not taken.done():
                    taken.set_result(None)
                await over.wait()
        except ValveError as error:
            if not taken.done():
                taken.set_exception(error)
        finally:
            self._looked_at.remove(wanted)

    async def _permissives(self, _client: _Client, tag: str, permit: str | None, read: str) -> Any:
        return to_json(await self.motion.permissives(tag, permit, read))

    async def _plant_read(self, _client: _Client, digest: str) -> Any:
        return to_json(await self.motion.plant_read(digest))

    async def _stands(self, _client: _Client, tag: str, **about: Any) -> Any:
        return to_json(await self.motion.stands(tag, **about))

    async def _recover(self, _client: _Client, tag: str, run_number: int, entry_pa: float | None, **about: Any) -> Any:
        return to_json(await self.motion.recover(tag, run_number, entry_pa, **about))

    async def _reload(self, _client: _Client, kept: Iterable[str]) -> None:
        await self.motion.reload(kept)

    async def _settled(self, _client: _Client, tag: str) -> None:
        await self.motion.settled(tag)

    async def _watched(self, _client: _Client) -> dict[str, dict[str, int]]:
        return await self.motion.watched()

    async def _unread(self, _client: _Client) -> dict[str, Any]:
        return {tag: to_json(one) for tag, one in (await self.motion.unread()).items()}

    async def _play(self, client: _Client, order: dict[str, Any]) -> Any:
        carried = self.motion.begin(of_json(Order, order))
        return await self._followed(client, carried.order.run_id)

    async def _rejoin(self, client: _Client, run_id: str) -> Any:
        return await self._followed(client, run_id)

    async def _followed(self, client: _Client, run_id: str) -> Any:
        def tell(event: str, value: Any) -> None:
            client.send({"run": run_id, "event": event, "value": value})

        def on_samples(block: SampleBlock) -> None:
            tell("samples", to_json(block))

        def on_armed(armed: Armed) -> None:
            tell("armed", to_json(armed))

        heard = Heard(
            on_armed,
            on_samples,
            lambda share, phase: tell("progress", [share, phase]),
            lambda: tell("commanded", None),
        )
        end: MotionEnd = await self.motion.rejoin(run_id, heard)
        return end_to_json(end)


class _Client:
    """One connection."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        self._tasks: set[asyncio.Task[None]] = set()
        self.holds: dict[int, asyncio.Event] = {}

    def send(self, message: dict[str, Any]) -> None:
        """Say something; whoever does not fetch it for long is let go, so that nothing grows here."""
        if self._writer.is_closing():
            return
        if self._writer.transport.get_write_buffer_size() > _MOST_UNREAD:
            _LOG.error("a connection to the motion process does not read: it is closed")
            self._writer.transport.abort()
            return
        self._writer.write(line_of(message))

    async def settled(self) -> None:
        """Return when what was asked is answered, or takes too long."""
        if self._tasks:
            await asyncio.wait(set(self._tasks), timeout=_END_S)

    def spawn(self, work: Any) -> None:
        """Do something for this connection; it ends with it."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def release(self, held: int) -> None:
        """Let a look be over."""
        over = self.holds.pop(held, None)
        if over is not None:
            over.set()

    def close(self) -> None:
        """End it, and what only it waits for."""
        for over in self.holds.values():
            over.set()
        for task in self._tasks:
            task.cancel()
        with contextlib.suppress(OSError):
            self._writer.close()


_Ask = Callable[..., Awaitable[Any]]
_FOR_ALL: Final = ("own", "state", "stop_and_wait")
_ASKED: Final[dict[str, _Ask]] = {
    "own": MotionServer._own,
    "state": MotionServer._state,
    "left": MotionServer._left,
    "stop_and_wait": MotionServer._stop_and_wait,
    "take": MotionServer._take,
    "hold": MotionServer._hold,
    "permissives": MotionServer._permissives,
    "plant_read": MotionServer._plant_read,
    "stands": MotionServer._stands,
    "recover": MotionServer._recover,
    "reload": MotionServer._reload,
    "settled": MotionServer._settled,
    "watched": MotionServer._watched,
    "unread": MotionServer._unread,
    "play": MotionServer._play,
    "rejoin": MotionServer._rejoin,
}
