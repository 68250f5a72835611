"""The last night and the coming one as the pages show them."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from service.health.results import PastTest
from service.parts import Parts
from service.schedules.calendar import next_occurrence
from service.schedules.check import CheckState
from service.schedules.nightly import wall_clock
from service.schedules.views import NightEntry, night
from service.tablet.history import diagnosis_words
from service.tablet.words import BAD_END, NE107, NOT_ASSESSED, Condition


@dataclass(frozen=True, slots=True)
class NightCheck:
    """One valve in the night's list; ``found`` is how its test found it, None where there is no result."""

    valve: str
    due_at: datetime
    state: str
    reason: str
    test_id: str | None
    found: Condition | None
    diagnosis: str

    @property
    def rank(self) -> int:
        """How early it is listed: what gave no result first, then by what was found."""
        if self.found is not None:
            return self.found.rank
        return BAD_END.rank if CheckState(self.state).ended else NOT_ASSESSED.rank


@dataclass(frozen=True, slots=True)
class NightSchedule:
    """One schedule and when it is due next."""

    name: str
    next_due: datetime | None
    zone: str
    sequence: str | None
    valves: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Nights:
    """The last night's checks, worst first, and how many found what; the coming night's by their turn."""

    last: Sequence[NightCheck]
    coming: Sequence[NightCheck]
    schedules: Sequence[NightSchedule]

    @property
    def summary(self) -> str:
        """How many valves the last night found in which state."""
        counts = Counter(
            one.state if one.found is None else one.found.words.lower()
            for one in sorted(self.last, key=lambda one: one.rank)
        )
        return ", ".join(f"{count} {words}" for words, count in counts.items())


async def night_of(parts: Parts) -> Nights:
    """Return the last and the coming night valve by valve, and the schedules; all empty where none is planned."""
    now = wall_clock()
    entries = await asyncio.to_thread(night, parts.plant, parts.store.schedule_runs, now)
    ids = [one.test_id for one in entries if one.test_id is not None]
    figures = await asyncio.to_thread(parts.store.figures.of_ids, ids)
    checks = [_check(one, figures.get(one.test_id or "")) for one in entries]
    last = [one for one in checks if one.state != CheckState.PLANNED]
    schedules = []
    for schedule in parts.plant.schedules:
        due = next_occurrence(schedule, now)
        due_at = None if due is None else due.due_at
        schedules.append(NightSchedule(schedule.name, due_at, schedule.zone.key, schedule.sequence, schedule.valves))
    return Nights(
        sorted(last, key=lambda one: (one.rank, one.due_at)),
        [one for one in checks if one.state == CheckState.PLANNED],
        schedules,
    )


def _check(entry: NightEntry, test: PastTest | None) -> NightCheck:
    found = None
    if entry.state is CheckState.COMPLETED:
        found = NOT_ASSESSED if test is None else NE107.get(test.ne107 or "", NOT_ASSESSED)
    diagnosis = "" if test is None or found is None else diagnosis_words(test)
    return NightCheck(entry.valve, entry.due_at, entry.state.value, entry.reason, entry.test_id, found, diagnosis)


def due_checks(parts: Parts) -> dict[str, datetime]:
    """Return when each valve is due next; valves without a schedule are left out."""
    now = wall_clock()
    due: dict[str, datetime] = {}
    for schedule in parts.plant.schedules:
        coming = next_occurrence(schedule, now)
        if coming is not None:
            for tag in schedule.valves:
                due[tag] = min(coming.due_at, due.get(tag, coming.due_at))
    return due
