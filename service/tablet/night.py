"""The last night and the coming one as the pages show them."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Final
from urllib.parse import urlencode

from pydantic import BaseModel, Field

from service.config.plant import Plant
from service.model.check import CheckState
from service.model.past_test import PastTest
from service.model.schedule import next_occurrence
from service.schedules.views import NightEntry, night
from service.shown.history import diagnosis_words
from service.shown.words import BAD_END, NE107, NOT_ASSESSED, Condition
from service.store.store import Store
from service.tablet.choices import Chip, found_by
from service.words.names import named
from service.words.sentences import as_clause

_ROWS: Final = 50  # of each list on one page


class NightWish(BaseModel):
    """What the address of the night's page asks for; what is empty asks for nothing."""

    find: str = Field("", max_length=64)
    found: Annotated[list[Annotated[str, Field(max_length=64)]], Field(max_length=20)] = []
    page: int = Field(1, ge=1, le=10_000)
    coming: int = Field(1, ge=1, le=10_000)

    def address(self, **changes: object) -> str:
        """Return the address of the page with these changes; what was chosen stays, lists begin at their first page."""
        asked = {"find": self.find, "found": self.found, **changes}
        given = {key: value for key, value in asked.items() if value}
        return f"/ui/night?{urlencode(given, doseq=True)}" if given else "/ui/night"


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
    def words(self) -> str:
        """What came of it: how the valve was found, or what became of its check."""
        return named(self.state) if self.found is None else as_clause(self.found.words)

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
class Paged:
    """One page of a list of checks: how many fit what was asked, of how many, and the pages that they fill."""

    rows: Sequence[NightCheck]
    fitting: int
    all: int
    number: int
    pages: int


@dataclass(frozen=True, slots=True)
class Nights:
    """The last night's checks, worst first, with chips that choose by what was found; the coming ones by their turn."""

    last: Paged
    coming: Paged
    chips: Sequence[Chip]
    schedules: Sequence[NightSchedule]


async def night_of(plant: Plant, store: Store, wish: NightWish) -> Nights:
    """Return the last and the coming night valve by valve, and the schedules; all empty where none is planned."""
    now = datetime.now(UTC)
    entries = await asyncio.to_thread(night, plant, store.schedule_runs, now)
    ids = [one.test_id for one in entries if one.test_id is not None]
    figures = await asyncio.to_thread(store.figures.of_ids, ids)
    checks = [_check(one, figures.get(one.test_id or "")) for one in entries]
    last = sorted((one for one in checks if one.state != CheckState.PLANNED), key=lambda one: (one.rank, one.due_at))
    coming = [one for one in checks if one.state == CheckState.PLANNED]
    named = [one for one in last if _is_named(plant, wish, one.valve)]
    chosen = [one for one in named if not wish.found or one.words in wish.found]
    schedules = []
    for schedule in plant.schedules:
        due = next_occurrence(schedule, now)
        due_at = None if due is None else due.due_at
        schedules.append(NightSchedule(schedule.name, due_at, schedule.zone.key, schedule.sequence, schedule.valves))
    return Nights(
        _paged(chosen, len(last), wish.page),
        _paged([one for one in coming if _is_named(plant, wish, one.valve)], len(coming), wish.coming),
        _chips(named, wish),
        schedules,
    )


def _is_named(plant: Plant, wish: NightWish, tag: str) -> bool:
    """Whether a valve is found by the words that are looked for, in what the list of valves finds it by."""
    valve = plant.valves.get(tag)
    text = tag.lower() if valve is None else found_by(tag, valve)
    return all(word in text for word in wish.find.lower().split())


def _paged(fitting: Sequence[NightCheck], whole: int, wanted: int) -> Paged:
    pages = max(1, -(-len(fitting) // _ROWS))
    number = min(wanted, pages)
    return Paged(fitting[(number - 1) * _ROWS : number * _ROWS], len(fitting), whole, number, pages)


def _chips(checks: Sequence[NightCheck], wish: NightWish) -> list[Chip]:
    counts = Counter(one.words for one in checks)
    counts.update(dict.fromkeys(set(wish.found) - counts.keys(), 0))
    return [
        Chip(
            words,
            words,
            count,
            words in wish.found,
            wish.address(
                found=[one for one in wish.found if one != words] if words in wish.found else [*wish.found, words]
            ),
        )
        for words, count in counts.items()
    ]


def _check(entry: NightEntry, test: PastTest | None) -> NightCheck:
    found = None
    if entry.state is CheckState.COMPLETED:
        found = NOT_ASSESSED if test is None else NE107.get(test.ne107 or "", NOT_ASSESSED)
    diagnosis = "" if test is None or found is None else diagnosis_words(test)
    return NightCheck(entry.valve, entry.due_at, entry.state.value, entry.reason, entry.test_id, found, diagnosis)
