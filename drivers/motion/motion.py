"""All that moves: orders are carried out here, one a valve, each from its journal on disk to its end on disk."""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import structlog

from drivers.addresses import BusAddress, ValveWiring
from drivers.motion.audit_log import AuditError, AuditLog
from drivers.motion.bus_lock import BusLocks
from drivers.motion.kept_samples import KeptSamples
from drivers.motion.orders import Armed, Heard, Left, MotionEnd, Order, Unread
from drivers.motion.plant_read import PlantRead, plant_read, same_plant, valve_read
from drivers.motion.rig import Rig, Watcher
from drivers.motion.spool import Spool
from drivers.motion.watching import Watching
from drivers.outcome import Ended, PlayOutcome, Recovered, SampleBlock
from drivers.permissive import Permissive, require_met
from drivers.stands_at import StandsAt
from drivers.waveform_check import check_waveform
from valve.errors import BusyError, InternalError, MeasurementError, NotFoundError, ValveError
from valve.messages import joined, message_of, report_it, say

_LOG = structlog.get_logger(__name__)
_CANCELLED_S: Final = 5.0
_NOBODY: Final = Heard()
_REMEMBERED: Final = 64  # stops that came before their motion


class MovedPlant(Protocol):
    """The valves that can be moved, and the plant file that says so."""

    @property
    def wirings(self) -> Mapping[str, ValveWiring]:
        """The valves by tag, as they are at this moment."""

    @property
    def buses(self) -> Mapping[str, BusAddress]:
        """The buses by name, as they are used."""

    def read(self) -> Any:
        """Read the plant file; nothing changes. Blocks. Raises ConfigurationError."""

    def take(self, fresh: Any, kept: frozenset[str]) -> None:
        """Become what was read, but for the ``kept`` valves."""

    def settle(self, tag: str) -> None:
        """Let a valve that was kept become what was read last."""


class Motion:
    """Carries orders out by a rig, and keeps their journals and ends in ``folder``. Belongs to one event loop.

    ``plant`` has the valves by tag as they are at this moment.
    """

    outlives_us = False
    precedence: bool | None = None

    def __init__(
        self,
        plant: MovedPlant,
        rig: Rig,
        folder: Path,
        *,
        locks: BusLocks,
        audit: AuditLog | None = None,
    ) -> None:
        self._plant = plant
        self._rig = rig
        self._locks = locks
        self._audit = audit
        self._spool = Spool(folder)
        self._carried: dict[str, _Carried] = {}
        self._closing = False
        self._stopped_before: OrderedDict[str, str] = OrderedDict()  # reasons of stops that came before their motion
        self._recovering: dict[asyncio.Task[Recovered], frozenset[str]] = {}  # and the buses that each uses
        self._removing: set[asyncio.Future[None]] = set()
        #: Called whenever a motion has ended.
        self.on_end: Callable[[], None] = lambda: None
        #: What reads valves in service behind all motions; None where nothing does.
        self.watching: Watching | None = None

    def _wiring(self, tag: str) -> ValveWiring:
        wiring = self._plant.wirings.get(tag)
        if wiring is None:
            raise NotFoundError(
                say(
                    "valve_unknown_to_motion",
                    "valve {valve} is unknown to the motion process: breakaway reload",
                    valve=repr(tag[:64]),
                )
            )
        return wiring

    # ---- buses

    async def take_aside(self, buses: Iterable[str]) -> None:
        """Take all of them or none; what is held stays so. Raises BusyError where another process has one."""
        await self._locks.take_aside(buses)

    @property
    def held(self) -> frozenset[str]:
        """The buses that this process holds."""
        return self._locks.held

    def give_back(self, buses: Iterable[str]) -> None:
        """Give them back, but for those that a motion uses."""
        self._locks.give_back(set(buses) - self.buses_in_use)

    @asynccontextmanager
    async def hold(self, buses: Iterable[str]) -> AsyncIterator[None]:
        """Hold them for the length of the block. Raises BusyError."""
        async with self._locks.hold(buses):
            yield

    @property
    def buses_in_use(self) -> frozenset[str]:
        """The buses of the valves that move, or are brought to rest after a crash."""
        moving = [one.wiring.buses for one in self._carried.values() if not one.is_over]
        return frozenset().union(*moving, *self._recovering.values())

    # ---- looks, which write nothing

    async def permissives(self, tag: str, permit: str | None, read: str) -> tuple[Permissive, ...]:
        """Read fresh what must hold before a valve may move; nothing is written.

        ``read`` is the valve's fingerprint as whoever asks has read plant.toml (``plant_read.valve_read``).
        """
        wiring = self._free(tag)
        same = same_plant(tag, read, valve_read(wiring, self._plant.buses))
        return (*await self._rig.permissives(wiring, permit), same)

    async def plant_read(self, digest: str) -> PlantRead | None:
        """Return what was read of plant.toml; None where that has this ``digest``."""
        read = plant_read(self._plant.wirings.values(), self._plant.buses)
        return None if read.digest == digest else read

    async def stands(self, tag: str, *, safe_pa: float | None, confirmed: bool | None, after_s: float) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written."""
        return await self._rig.stands(self._free(tag), safe_pa=safe_pa, confirmed=confirmed, after_s=after_s)

    def _free(self, tag: str) -> ValveWiring:
        """Return a valve that does not move, on buses that nobody uses. Raises NotFoundError, BusyError."""
        wiring = self._wiring(tag)
        for one in self._carried.values():
            if not one.is_over and (one.order.tag == tag or wiring.buses & one.wiring.buses):
                raise BusyError(
                    say(
                        "other_test_moves",
                        "{tag}: test {test} of {valve} moves: wait for its end, or stop it",
                        tag=tag,
                        test=one.order.run_id,
                        valve=one.order.tag,
                    )
                )
        return wiring

    # ---- motion

    async def play(self, order: Order, heard: Heard = _NOBODY) -> MotionEnd:
        """Play a waveform; however it ends, the valve is sent to its safe value. A cancelled caller ends it, too.

        Raises ValveError only where nothing was sent that can move the valve.
        """
        carried = self.begin(order)
        try:
            return await self._followed(carried, heard)
        except asyncio.CancelledError:
            carried.cancel()
            await asyncio.wait({carried.task})
            if carried.task.cancelled():
                raise
            return carried.task.result()

    def begin(self, order: Order) -> _Carried:
        """Begin a motion. Raises NotFoundError, WaveformError, BusyError.

        Raises PermissiveError where whoever asks has read another plant.toml than this process.
        """
        wiring = self._free(order.tag)
        if order.read:
            require_met(order.tag, [same_plant(order.tag, order.read, valve_read(wiring, self._plant.buses))])
        check_waveform(order.tag, order.waveform, wiring.limits)
        if self._closing:
            raise BusyError(
                say(
                    "motion_process_ending",
                    "{tag}: the motion process is ending: repeat the request when it is back",
                    tag=order.tag,
                )
            )
        carried = _Carried(order, wiring, self._rig, self._spool, audit=self._audit)
        if order.run_id in self._stopped_before:
            carried.request_stop(self._stopped_before.pop(order.run_id))
        self._carried[order.run_id] = carried
        carried.start(self._locks)
        carried.task.add_done_callback(lambda _: self.on_end())
        return carried

    async def _followed(self, carried: _Carried, heard: Heard) -> MotionEnd:
        carried.tell(heard)
        try:
            return await asyncio.shield(carried.task)
        finally:
            carried.tell(None)

    async def rejoin(self, run_id: str, heard: Heard = _NOBODY) -> MotionEnd:
        """Hear the rest of a motion that somebody else asked for, or its end. Raises NotFoundError, as ``play``."""
        carried = self._carried.get(run_id)
        if carried is not None:
            return await self._followed(carried, heard)
        return await asyncio.to_thread(self._spool.read, run_id)

    def stop(self, run_id: str, reason: str) -> None:
        """Send a valve to its safe value at once; nothing happens where its motion has ended.

        One that comes before its motion is kept for it.
        """
        carried = self._carried.get(run_id)
        if carried is not None:
            carried.request_stop(reason)
            return
        self._stopped_before[run_id] = reason
        while len(self._stopped_before) > _REMEMBERED:
            self._stopped_before.popitem(last=False)

    def end_early(self, run_id: str, because: Mapping[str, float] | None = None) -> None:
        """Let a motion that may end early end as its waveform would; the first reason counts."""
        carried = self._carried.get(run_id)
        if carried is not None and carried.enough is not None and not carried.enough.is_set():
            carried.early = because
            carried.enough.set()

    async def left(self) -> tuple[Left, ...]:
        """Return the motions that go on, and those whose end was not fetched."""
        if self._removing:
            await asyncio.wait(self._removing)
        here = {run_id: Left(one.order, one.is_over) for run_id, one in self._carried.items()}
        spooled = await asyncio.to_thread(self._spool.all)
        return tuple({**{one.order.run_id: one for one in spooled}, **here}.values())

    def forget(self, run_id: str) -> None:
        """Remove what was kept of a motion's end: whoever asked for it has stored it."""
        carried = self._carried.get(run_id)
        if carried is not None and not carried.is_over:
            return
        self._carried.pop(run_id, None)
        removing = asyncio.ensure_future(asyncio.to_thread(self._spool.remove, run_id))
        self._removing.add(removing)
        removing.add_done_callback(self._removing.discard)

    async def recover(self, tag: str, run_number: int, entry_pa: float | None, *, commanded: bool | None) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now.

        It goes on where the caller is cancelled. A motion of that valve that goes on here is stopped first.
        """
        for one in self._carried.values():
            if one.order.tag == tag and not one.is_over:
                one.request_stop(say("stopped_asker_lost_it", "stopped: whoever asked for it lost it"))
                await asyncio.wait({one.task})
        wiring = self._free(tag)
        task = asyncio.create_task(self._recovered(wiring, run_number, entry_pa, commanded))
        self._recovering[task] = wiring.buses
        task.add_done_callback(self._recovering.pop)
        return await asyncio.shield(task)

    async def _recovered(
        self, wiring: ValveWiring, run_number: int, entry_pa: float | None, commanded: bool | None
    ) -> Recovered:
        async with self._locks.hold(wiring.buses):
            return await self._rig.recover(wiring, run_number, entry_pa, commanded=commanded)

    async def reload(self, kept: Iterable[str]) -> None:
        """Read the plant file anew; the ``kept`` valves and those that move stay until they are ``settled``.

        Raises ConfigurationError.
        """
        fresh = await asyncio.to_thread(self._plant.read)
        moving = {one.order.tag for one in self._carried.values() if not one.is_over}
        self._plant.take(fresh, frozenset(kept) | moving)
        self._refresh_watching()

    async def settled(self, tag: str) -> None:
        """Let a valve that was kept become what the plant file said when it was read last."""
        self._plant.settle(tag)
        self._refresh_watching()

    def _refresh_watching(self) -> None:
        if self.watching is not None:
            self.watching.refresh()

    async def watched(self) -> dict[str, dict[str, int]]:
        """Return what became of the slots of each valve that is read in service, by tag."""
        return {} if self.watching is None else self.watching.counted()

    async def unread(self) -> dict[str, Unread]:
        """Return the valves in service that cannot be read now, by tag."""
        return {} if self.watching is None else self.watching.unread()

    async def connect(self, within_s: float) -> None:
        """Connect: this is the same process."""

    async def close(self) -> None:
        """Nothing ends with a connection here: there is none."""

    @property
    def tags(self) -> frozenset[str]:
        """The valves that can be moved."""
        return frozenset(self._plant.wirings)

    @property
    def moves(self) -> bool:
        """Whether a motion is under way."""
        return any(not one.is_over for one in self._carried.values())

    async def end_of(self, run_id: str) -> MotionEnd:
        """Wait for the end of a motion beside whoever asked for it. Raises NotFoundError, as ``play``."""
        carried = self._carried.get(run_id)
        if carried is None:
            raise NotFoundError(
                say("motion_of_test_unknown", "test {test}: the motion process knows nothing of it", test=run_id)
            )
        return await asyncio.shield(carried.task)

    def begin_shutdown(self, reason: str) -> None:
        """Begin no further motion and stop those that go on."""
        self._closing = True
        for one in self._carried.values():
            one.request_stop(reason)

    async def shut_down(self, reason: str, timeout_s: float) -> None:
        """Stop every motion and wait until each has its end on disk; those that are late are cancelled."""
        self.begin_shutdown(reason)
        tasks: set[asyncio.Task[Any]] = {one.task for one in self._carried.values() if not one.is_over}
        tasks |= self._recovering.keys()
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=timeout_s)
            for task in late:
                _LOG.error("a motion did not end in time", seconds=timeout_s)
                task.cancel()
            if late:  # what is cancelled still sends its valve to safe
                await asyncio.wait(late, timeout=_CANCELLED_S)


class _Carried:
    """One order under way: its journal, its entries in the audit log, and who hears of it."""

    def __init__(self, order: Order, wiring: ValveWiring, rig: Rig, spool: Spool, *, audit: AuditLog | None) -> None:
        self.order = order
        self.wiring = wiring
        self.enough = asyncio.Event() if order.may_end_early else None
        self.early: Mapping[str, float] | None = None  # why it is to end early, where that was said
        self._rig = rig
        self._spool = spool
        self._audit = audit
        self._heard = _NOBODY
        self._stop = asyncio.Event()
        self._stopped = ""
        self._kept: KeptSamples | None = None
        self._disk_error = ""
        self._commanded = False
        self._intended = False  # the journal says that the valve may be commanded
        self._permissives: tuple[Permissive, ...] = ()
        self._armed: Armed | None = None
        self._phase: tuple[float, str] | None = None
        self.task: asyncio.Task[MotionEnd]

    def start(self, locks: BusLocks) -> None:
        """Begin, in a task of its own that holds the buses."""
        self.task = asyncio.create_task(self._on_its_buses(locks))
        self.task.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody may wait for it

    @property
    def is_over(self) -> bool:
        """Whether the motion has its end."""
        return self.task.done()

    def tell(self, heard: Heard | None) -> None:
        """Tell somebody from now on what happens, and at once how far it is; None: nobody."""
        self._heard = heard or _NOBODY
        if self._armed is not None and not self.is_over:
            self._heard.on_armed(self._armed)
        if self._intended and not self.is_over:
            self._heard.on_commanded()
        if self._phase is not None and not self.is_over:
            self._heard.on_progress(*self._phase)

    def request_stop(self, reason: str) -> None:
        """Throw the switch; the first reason counts."""
        if not self._stop.is_set():
            self._stopped = reason
            self._stop.set()

    def cancel(self) -> None:
        """End the motion in the hardest way that still sends the valve to its safe value."""
        self.request_stop(say("stopped_asker_ended", "stopped: whoever asked for it ended"))
        self.task.cancel()

    async def _on_its_buses(self, locks: BusLocks) -> MotionEnd:
        async with locks.hold(self.wiring.buses):
            return await self._carry_out()

    async def _carry_out(self) -> MotionEnd:
        watcher = Watcher(
            self._on_ready,
            self._on_samples,
            self._on_progress,
            self._on_permissives,
            self._on_intent,
            self._on_commanded,
        )
        try:
            outcome = await self._rig.play(self.wiring, self.order, watcher, self._stop, self.enough)
        except ValveError as error:
            if not self._commanded:
                self._close()
                raise
            outcome = await self._rescued(_reason(error))
        except asyncio.CancelledError:
            if not self._commanded:
                self._close()
                raise
            outcome = await self._rescued(
                say("cancelled_as_service_ended", "the test was cancelled as the service ended")
            )
        except Exception as error:
            _LOG.error("motion failed unexpectedly", test=self.order.run_id, valve=self.order.tag, exc_info=error)
            if not self._commanded:
                self._close()
                raise InternalError(_reason(error)) from error
            outcome = await self._rescued(_reason(error))
        outcome = replace(outcome, commanded=outcome.commanded or self._commanded)
        if self._kept is not None:
            await self._kept.drained()
        return await self._ended(outcome)

    async def _rescued(self, reason: str) -> PlayOutcome:
        """Send a valve to safe that a fault left alone; return that as the end of its motion."""
        found = await self._rig.go_safe(self.wiring, self.order.run_number, self._entry_pa)
        why = "" if found.confirmed else found.reason
        told = MeasurementError(joined("; ", [text for text in (reason, found.reason) if text]))
        return PlayOutcome(None, Ended.FAILED, found.confirmed, told, why_unsafe=why)

    async def _ended(self, outcome: PlayOutcome) -> MotionEnd:
        unwritten = await self._end_in_audit(outcome)
        faults = tuple(text for text in (self._disk_error, unwritten) if text)
        stopped = self._stopped if outcome.ended is Ended.STOPPED else ""
        early = None if outcome.ended_early_s is None else self.early
        end = MotionEnd(outcome, self._entry_pa, faults, stopped, early)
        try:
            await asyncio.to_thread(self._spool.write, self.order, end)
        except OSError as error:  # what was sampled stands in the journal, and whoever waits hears it all the same
            _LOG.error("end of motion not on disk", test=self.order.run_id, valve=self.order.tag, error=str(error))
        self._close()
        return end

    def _close(self) -> None:
        if self._kept is not None:
            self._kept.close()

    @property
    def _entry_pa(self) -> float | None:
        return None if self._armed is None else self._armed.entry_pa

    # ---- what the rig tells

    async def _on_ready(self, entry_pa: float, device: str) -> None:
        order = self.order
        armed = Armed(entry_pa if math.isfinite(entry_pa) else None, device, self._permissives)
        header = {
            "test": order.run_id,
            "valve": order.tag,
            "sequence": order.sequence,
            "run_number": order.run_number,
            "started_at": order.started_at,
            "software": order.software,
            "device": device,
            "entry_pa": armed.entry_pa,
        }
        self._kept = KeptSamples(self._spool.path(order.run_id, ".journal"), self._on_written, self._abort_for_disk)
        try:
            await self._kept.begin(header)
        except OSError as error:
            raise self._without_journal(error) from error
        about = {"read_at": datetime.now(UTC).isoformat(), "may_start": True, "permit": order.permit}
        shown = {**about, "permissives": [one.to_json() for one in self._permissives]}
        details = {"sequence": order.sequence, "run_number": order.run_number, "device": device, "permissives": shown}
        await self._in_audit("motion.armed", {**details, "entry_pa": armed.entry_pa, "permit": order.permit})
        self._armed = armed
        self._heard.on_armed(armed)

    async def _on_intent(self) -> None:
        """Write that the valve may move from now on; it is on disk when this returns."""
        assert self._kept is not None  # on_ready came before
        try:
            await self._kept.note_commanded()
        except OSError as error:
            raise self._without_journal(error) from error
        self._intended = True

    def _without_journal(self, error: OSError) -> MeasurementError:
        return MeasurementError(
            say(
                "journal_not_written",
                "{tag}: the journal cannot be written ({why}), nothing moves without it: free some disk space",
                tag=self.order.tag,
                why=message_of(error),
            )
        )

    def _on_commanded(self) -> None:
        self._commanded = True
        self._heard.on_commanded()

    def _on_permissives(self, permissives: tuple[Permissive, ...]) -> None:
        self._permissives = permissives

    def _on_samples(self, block: SampleBlock) -> None:
        # Nobody sees a sample that a crash could undo: first to the journal, then to who listens.
        if self._kept is not None and not self._disk_error:
            self._kept.add(block)

    def _on_written(self, block: SampleBlock) -> None:
        if not self._disk_error:
            self._heard.on_samples(block)

    def _on_progress(self, share: float, phase: str) -> None:
        self._phase = (share, phase)
        self._heard.on_progress(share, phase)

    def _abort_for_disk(self, error: OSError) -> None:
        if not self._disk_error:
            _LOG.error("samples not written", test=self.order.run_id, valve=self.order.tag, error=str(error))
        self._disk_error = say(
            "samples_not_written",
            "samples can no longer be written ({why}): the test was stopped",
            why=error.strerror or message_of(error),
        )
        self.request_stop("")

    # ---- the audit log

    async def _in_audit(self, event: str, details: Mapping[str, Any]) -> None:
        """Write an event of this motion; it is on disk when this returns. Raises AuditError: then nothing may move."""
        order = self.order
        if self._audit is not None:
            append = partial(self._audit.append, event, valve=order.tag, test=order.run_id, details=details)
            await asyncio.to_thread(append, who=order.requested_by or "local")

    async def _end_in_audit(self, outcome: PlayOutcome) -> str:
        """Write how the motion ended; return why that could not be written."""
        details = {"ended": outcome.ended.value, "safe_confirmed": outcome.safe_confirmed, "writes": outcome.writes}
        early: dict[str, Any] = {}
        if outcome.ended_early_s is not None:
            early["ended_early_s"] = round(outcome.ended_early_s, 3)
            if self.early is not None:
                early["out_of_family"] = dict(self.early)
        reason = {} if outcome.error is None else {"error": str(outcome.error)}
        if self._stopped:
            reason["stopped"] = self._stopped
        try:
            await self._in_audit("motion.ended", {**details, **early, **reason})
        except AuditError as error:
            return say(
                "end_not_in_audit_log", "the end of the motion is not in the audit log: {why}", why=message_of(error)
            )
        return ""


def _reason(error: Exception) -> str:
    if isinstance(error, ValveError):
        return message_of(error)
    return report_it(error)
