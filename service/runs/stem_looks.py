"""The look at a stem some seconds after its motion: the valve is kept until then, its buses are free meanwhile."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final

import structlog

from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink, MotionLostError
from drivers.stands_at import StandsAt, stands_at
from service.config.plant import PlantValve
from service.model.run import Run
from service.model.stands_words import stands_sentence
from service.runs.admission import Admission
from service.runs.bus_owners import Claim
from service.runs.live import LiveRun
from service.runs.tasks import Tasks
from service.store.store import Store
from valve.errors import BusyError, InternalError, NotFoundError
from valve.messages import report_it

_LOG = structlog.get_logger(__name__)
_TURN_S: Final = 0.05
_STORE_AGAIN_S: Final = 2.0
_MOTION_AGAIN_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Rest:
    """A valve after its motion: the run that left it, its claim, and what is known of it.

    ``at_s`` is when it came to rest or to its end (monotonic), ``safe_pa`` its safe value, None where unknown,
    ``confirmed`` whether that was read back; None where nothing was commanded. ``live`` is None for a run of a process
    that is gone.
    """

    run: Run
    valve: PlantValve
    claim: Claim
    at_s: float
    safe_pa: float | None
    confirmed: bool | None
    live: LiveRun | None = None

    @property
    def after_s(self) -> float:
        """How long the motion is over, s."""
        return time.monotonic() - self.at_s

    @property
    def due_in_s(self) -> float:
        """How long until the stem is to be looked at, s; 0 or less from then on."""
        return self.valve.wiring.rest.after_s - self.after_s

    def moving(self) -> StandsAt:
        """Return what is known before anybody looked."""
        rules, confirmed = self.valve.wiring.rest, self.confirmed
        signal_pa = self.safe_pa if confirmed else None
        return stands_at(
            rules, after_s=0.0, safe_pa=self.safe_pa, confirmed=confirmed, signal_pa=signal_pa, is_over=False
        )


class StemLooks:
    """Looks at stems, each in a task of its own. All methods belong to the event loop."""

    def __init__(
        self, store: Store, motion: MotionLink, admission: Admission, tasks: Tasks, audit: AuditLog | None = None
    ) -> None:
        self._store = store
        self._motion = motion
        self._admission = admission
        self._tasks = tasks
        self._audit = audit
        self._closing = asyncio.Event()
        self._under_way: dict[str, Rest] = {}  # by tag: a valve has one test

    def begin(self, rest: Rest) -> None:
        """Give the buses of a valve back and look at its stem when it is time; the valve is free after that."""
        wiring = rest.valve.wiring
        buses = {point.bus for point in (wiring.command, wiring.position) if point is not None}
        self._admission.owners.rest(rest.claim, buses)
        self._under_way[rest.run.valve] = rest
        self._tasks.spawn(self._look(rest))

    def close(self) -> None:
        """Begin no further look: stems whose time is not over are looked at after the next start."""
        self._closing.set()

    def due_in_s(self, tag: str) -> float:
        """How long until the stem of a valve is to be looked at, s; 0 or less where it is due, or nobody is to look."""
        rest = self._under_way.get(tag)
        return 0.0 if rest is None else rest.due_in_s

    async def _look(self, rest: Rest) -> None:
        try:
            if await self._its_turn(rest) and (stands := await self._seen(rest)) is not None:
                self._admission.owners.rest(rest.claim, ())  # the valve is kept until what was seen is stored
                await self._keep(rest, stands)
        finally:
            self._under_way.pop(rest.run.valve, None)
            self._admission.owners.release(rest.claim)

    async def _paused(self) -> None:
        with suppress(TimeoutError):
            await asyncio.wait_for(self._closing.wait(), _MOTION_AGAIN_S)

    async def _seen(self, rest: Rest) -> StandsAt | None:
        """Return where a stem stands; None where the service ends before there is a motion process to ask."""
        while not self._closing.is_set():
            try:
                return await self._looked(rest)
            except (MotionLostError, BusyError):
                await self._paused()
        return None

    async def _looked(self, rest: Rest) -> StandsAt:
        after_s = rest.after_s
        try:
            return await self._motion.stands(
                rest.run.valve, safe_pa=rest.safe_pa, confirmed=rest.confirmed, after_s=after_s
            )
        except (MotionLostError, BusyError):
            raise
        except Exception as error:  # noqa: BLE001  - whatever it is, the result must say that nobody saw the stem
            _LOG.error("stem not looked at", test=rest.run.id, valve=rest.run.valve, exc_info=error)
            why = report_it(error)
            rules = rest.valve.wiring.rest
            return stands_at(
                rules,
                after_s=after_s,
                safe_pa=rest.safe_pa,
                confirmed=rest.confirmed,
                signal_unread=why,
                stem_unread=why,
            )

    async def _its_turn(self, rest: Rest) -> bool:
        """Wait until it is time and the buses are free; False where the service ends before."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._closing.wait(), max(0.0, rest.due_in_s))
        while not self._closing.is_set():
            try:
                async with self._admission.turn(rest.valve):
                    await self._admission.owners.look(rest.claim)
                    return True
            except BusyError:
                await asyncio.sleep(_TURN_S)
            except MotionLostError:  # it comes back
                await self._paused()
        return False

    async def _keep(self, rest: Rest, stands: StandsAt) -> None:
        """Store where the valve stands, as soon as the store can, and let it be seen; it is logged and audited."""
        said = stands_sentence(stands)
        if stands.verdict.is_alarm:
            _LOG.error("stem not at its safe position", test=rest.run.id, valve=rest.run.valve, stands=said)
        else:
            _LOG.info("stem looked at", test=rest.run.id, valve=rest.run.valve, stands=said)
        await self._in_audit(rest.run, stands)
        while True:
            try:
                if rest.live is None:
                    await asyncio.to_thread(self._store.runs.note_stands, rest.run, stands)
                else:
                    await rest.live.keep_stands(self._store.runs, stands)
            except NotFoundError as error:
                _LOG.warning("stem's look not stored", test=rest.run.id, error=str(error))
                return
            except Exception as error:  # noqa: BLE001  - whatever the store lacks now it may have later
                _LOG.warning("stem's look not stored", test=rest.run.id, error=str(error))
                if rest.live is not None:
                    rest.live.show_stands(stands)
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._closing.wait(), _STORE_AGAIN_S)
                if self._closing.is_set():
                    return
            else:
                return

    async def _in_audit(self, run: Run, stands: StandsAt) -> None:
        if self._audit is None:
            return
        details = {"verdict": stands.verdict.value, "stem_m": stands.stem_m, "signal_pa": stands.signal_pa}
        append = partial(self._audit.append, "stem.read", who="service", valve=run.valve, test=run.id)
        try:
            await asyncio.to_thread(append, details=details)
        except InternalError as error:
            _LOG.error("not in the audit log", test=run.id, audit_event="stem.read", error=str(error))
