"""After a crash: what was cut off is marked, its samples are kept, its valve is looked at; nothing resumes.

A valve goes to safe only where its test commanded it, its device does not show the safe value and the permissives hold
at that moment; else it stays as it stands, and that is said.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

import structlog

from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink
from drivers.outcome import Recovered, SafeOutcome
from drivers.stands_at import unseen
from service.config.plant import Plant
from service.model.analysis import is_to_be_taken_up
from service.model.run import Run, RunState
from service.model.stands_words import NOT_CONFIRMED
from service.runs.admission import Admission
from service.runs.left_journal import entry_pressure_pa, keep_journals_of_ended_runs, kept_as_recording, shown_commanded
from service.runs.stem_looks import Rest, StemLooks
from service.runs.tasks import Tasks
from service.store.store import Store
from valve.errors import InternalError, ValveError
from valve.messages import joined, message_of, parts_of, say

_LOG = structlog.get_logger(__name__)
_NOTHING_MOVED: Final = say("nothing_was_moved_then", "nothing was moved")
_UNFINISHED: Final = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)


def mark_interrupted(store: Store, run: Run) -> Run:
    """Turn an unfinished run of a dead process into an interrupted one; its journal becomes its recording. Blocks."""
    changes: dict[str, Any] = {"state": RunState.INTERRUPTED, "finished_at": datetime.now(UTC)}
    if run.state is RunState.ANALYZING:
        reasons = [
            say("service_ended_meanwhile", "the service ended while this test was under way"),
            say("recording_complete", "the recording is complete: analyse it again"),
        ]
    else:
        reasons = [say("motion_process_ended_meanwhile", "the motion process ended while this test was under way")]
    kept = False
    changes["commanded"] = shown_commanded(store, run)
    try:
        if store.journal_path(run.id).exists():
            changes |= kept_as_recording(store, run)
    except (OSError, ValveError) as error:
        kept = True
        reasons.append(
            say(
                "journal_kept",
                "its journal is kept as no recording could be made of it: {why}",
                why=message_of(error),
            )
        )
    interrupted = replace(run, error=joined("; ", reasons), **changes)
    store.runs.save(interrupted)
    if not kept:
        store.journal_path(run.id).unlink(missing_ok=True)
    _LOG.warning("test was interrupted", test=run.id, valve=run.valve, was=run.state.value)
    return interrupted


def _may_stand_elsewhere(run: Run) -> bool:
    """Whether the valve of an unfinished run was not seen at its safe value when the motion ended."""
    return run.safe_confirmed is not True


@dataclass(frozen=True, slots=True)
class _Recovered:
    """What was done with a valve, and the valve as it rests now."""

    found: Recovered
    rest: Rest


class Recovery:
    """Brings what a dead process left behind to rest; its tasks go on among ``tasks``."""

    def __init__(
        self,
        plant: Plant,
        store: Store,
        motion: MotionLink,
        admission: Admission,
        tasks: Tasks,
        *,
        looks: StemLooks,
        audit: AuditLog | None = None,
    ) -> None:
        self._looks = looks
        self._plant = plant
        self._store = store
        self._motion = motion
        self._admission = admission
        self._tasks = tasks
        self._audit = audit

    async def begin(self, alive: Collection[str] = ()) -> list[Run]:
        """Look at the valves that a dead process left, each in a task of its own, and mark its tests.

        The valves come first: neither a long journal nor a full disk holds them up. Returns the tests that lack nothing
        but their analysis; these are left as they are. The motions of tests that are ``alive`` go on.
        """
        gateway = self._plant.service.gateway
        unfinished = await asyncio.to_thread(self._store.runs.in_states, _UNFINISHED, gateway=gateway)
        left = [run for run in unfinished if run.id not in alive]
        whole = [run for run in left if run.valve in self._plant.valves and self._lacks_analysis_alone(run)]
        unfinished = [run for run in left if run not in whole]
        recovered = await self._interrupt(unfinished)
        await asyncio.to_thread(keep_journals_of_ended_runs, self._store)
        for run in await asyncio.to_thread(self._store.runs.with_moving_stems, gateway):
            if run.id not in recovered and run.id not in alive:
                await self._look_again(run)
        return whole

    def _lacks_analysis_alone(self, run: Run) -> bool:
        return is_to_be_taken_up(run, is_kept=self._store.recording_path(run.id).is_file())

    async def interrupt(self, run: Run) -> Run:
        """Do the same with one test whose motion was lost while this process lived; return it as it was marked."""
        await self._interrupt([run])
        return await asyncio.to_thread(self._store.runs.get, run.id)

    async def _interrupt(self, runs: Sequence[Run]) -> Collection[str]:
        """Mark unfinished tests as interrupted, and have their valves looked at; return the tests of those valves."""
        recovered: dict[str, asyncio.Task[_Recovered]] = {}
        for run in runs:
            if run.valve in self._plant.valves and _may_stand_elsewhere(run):
                commanded = await asyncio.to_thread(shown_commanded, self._store, run)
                entry_pa = await asyncio.to_thread(entry_pressure_pa, self._store, run)
                recovered[run.id] = self._tasks.spawn(self._recover(run, commanded, entry_pa))
        marked = [await asyncio.to_thread(mark_interrupted, self._store, run) for run in runs]
        for run in marked:
            if run.id in recovered:
                self._tasks.spawn(self._note(run.id, recovered[run.id]))
            elif _may_stand_elsewhere(run) and run.commanded is not False:
                why = say("no_longer_named", "plant.toml no longer names it")
                error = joined("; ", (*parts_of(run.error), _not_confirmed(why)))
                await asyncio.to_thread(self._store.runs.save, replace(run, error=error, safe_confirmed=False))
        return recovered.keys()

    async def _recover(self, run: Run, commanded: bool | None, entry_pa: float | None) -> _Recovered:
        valve = self._plant.valves[run.valve]
        claim = await self._admission.claim_when_free(run, valve)
        try:
            details = {"run_number": run.number, "entry_pa": entry_pa, "commanded": commanded}
            await self._note_in_audit("motion.recovery", run, details)
            found = await self._found(run, commanded, entry_pa)
        except BaseException:
            self._admission.owners.release(claim)
            raise
        safe = valve.wiring.safe_value_pa
        safe_pa = entry_pa if isinstance(safe, str) else safe
        # A valve that may still be on its way there has its time; one that stands anywhere is looked at now.
        waited_s = 0.0 if found.safe.confirmed else _since_s(run.created_at)
        confirmed = None if commanded is False else found.safe.confirmed
        return _Recovered(found, Rest(run, valve, claim, time.monotonic() - waited_s, safe_pa, confirmed))

    async def _found(self, run: Run, commanded: bool | None, entry_pa: float | None) -> Recovered:
        """Have the valve looked at; a motion process that does not come back leaves it to the device's watchdog."""
        try:
            return await self._motion.recover(run.valve, run.number, entry_pa, commanded=commanded)
        except ValveError as error:
            return Recovered(SafeOutcome(False, reason=message_of(error)))

    async def _note(self, run_id: str, recovering: asyncio.Task[_Recovered]) -> None:
        """Store what became of a valve, and look at its stem."""
        left = await recovering
        found, rest = left.found, left.rest
        try:
            run = await asyncio.to_thread(self._store.runs.get, run_id)
            details = {"safe_confirmed": found.safe.confirmed, "sent": found.sent, "reason": found.safe.reason}
            await self._note_in_audit("motion.ended", run, details)
            run = await asyncio.to_thread(self._store.runs.get, run_id)  # as an acknowledgement left it meanwhile
            error = joined("; ", (*parts_of(run.error), *_told(found, rest.confirmed)))
            run = replace(run, error=error, safe_confirmed=rest.confirmed, stands=rest.moving())
            await asyncio.to_thread(self._store.runs.save, run)
        except BaseException:
            self._admission.owners.release(rest.claim)
            raise
        _LOG.warning("valve recovered", test=run.id, valve=run.valve, **details)
        self._looks.begin(rest)

    async def _look_again(self, run: Run) -> None:
        """Look at a stem that the last process did not live to look at."""
        stands, valve = run.stands, self._plant.valves.get(run.valve)
        assert stands is not None  # it is said to move
        if valve is None:
            gone = unseen(stands, say("valve_no_longer_named", "plant.toml no longer names this valve"))
            await asyncio.to_thread(self._store.runs.note_stands, run, gone)
            return
        claim = self._admission.owners.claim(run.id, run.valve, ())
        at_s = time.monotonic() - _since_s(run.motion_ended_at or run.created_at)
        self._looks.begin(Rest(run, valve, claim, at_s, stands.safe_pa, stands.signal_confirmed))

    async def _note_in_audit(self, event: str, run: Run, details: Mapping[str, Any]) -> None:
        """Write what is done for safety's sake; where that cannot be written it is done all the same."""
        if self._audit is None:
            return
        try:
            await asyncio.to_thread(
                partial(self._audit.append, event, who="service", valve=run.valve, test=run.id, details=details)
            )
        except InternalError as error:
            _LOG.error("not in the audit log", test=run.id, audit_event=event, error=str(error))


def _since_s(at: datetime) -> float:
    """Return how long an instant is past by this machine's clock, s."""
    return max(0.0, (datetime.now(UTC) - at).total_seconds())


def _not_confirmed(reason: str) -> str:
    if not reason:
        return NOT_CONFIRMED
    return say("not_confirmed_as", "{alarm}: {why}", alarm=NOT_CONFIRMED, why=reason)


def _told(found: Recovered, confirmed: bool | None) -> tuple[str, ...]:
    """Return what became of the valve, as it is added to why its test has no result."""
    reason = found.safe.reason
    if confirmed is None:
        return (_NOTHING_MOVED,)
    if found.sent and not confirmed:
        return (_not_confirmed(reason),)
    if found.sent:
        sent = say("sent_to_safe", "the valve was sent to its safe value")
        return (say("sent_to_safe_as", "{sent}: {why}", sent=sent, why=reason) if reason else sent,)
    if confirmed:
        return (say("safe_value_shown", "its device showed the safe value, nothing was written"),)
    nothing = say("nothing_was_written", "nothing was written")
    if reason:
        nothing = say("nothing_was_written_as", "{nothing}: {why}", nothing=nothing, why=reason)
    return NOT_CONFIRMED, nothing
