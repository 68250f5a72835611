"""Days in service are judged once they are over, behind everything else; what they say of a valve's state is noted."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Final, Protocol

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.motion.watch_file import WatchDay, days_in
from service.config.plant import Plant, PlantValve
from service.health.changes import facts_of
from service.health.staleness import Staleness
from service.health.watched import HISTORY_DAYS, friction_changed, present_nameplate
from service.model.watched_day import ChangedInService, DayJudged, WatchedDay
from service.runs.tasks import Background
from service.schedules.left_samples import tidy_left
from service.store.store import Store
from valve.errors import InternalError, RecordingError, ValveError
from valve.messages import message_of
from valve.nameplate import Nameplate

_LOG = structlog.get_logger(__name__)
_NOTED_AGAIN: Final = timedelta(hours=1)  # a baseline may be new
_FIRST_S: Final = 30.0  # after the start: first of all the valves are looked at
_PERIOD_S: Final = 300.0
_SETTLED: Final = timedelta(minutes=1)  # what was read last is on disk by then
_MOST_TRIES: Final = 3  # of a day whose worker dies


class JudgesDays(Protocol):
    """Judges a day in service somewhere else than on the event loop, behind everything else."""

    async def judge_day(self, path: Path, nameplate: Nameplate) -> DayJudged:
        """Return what the file says. Raises RecordingError, InternalError."""


class WatchedDays(Background):
    """Judges the days of this gateway's valves. All methods belong to the event loop.

    A day that is under way at the end is judged anew after the next start.
    """

    def __init__(self, plant: Plant, store: Store, stale: Staleness, judge: JudgesDays | None, software: str) -> None:
        super().__init__(self._keep_judging)
        self._plant = plant
        self._store = store
        self._stale = stale
        self._judge = judge
        self._software = software
        self._tries: dict[Path, int] = {}
        self._noted: datetime | None = None

    async def _keep_judging(self) -> None:
        pause_s = 0.0
        while True:
            try:
                await (self.look() if pause_s else asyncio.to_thread(self.note_states))
            except (SQLAlchemyError, OSError, ValveError) as error:
                _LOG.warning("days in service wait", reason=str(error))
            pause_s = _PERIOD_S if pause_s else _FIRST_S
            await asyncio.sleep(pause_s)

    async def look(self, now: datetime | None = None) -> int:
        """Judge every day that is over and was not judged; return how many there were."""
        now, judged = now or datetime.now(UTC), 0
        days = await asyncio.to_thread(self._open, now)
        for valve, day in days:
            found = await self._judged(valve, day)
            if found is not None:
                await asyncio.to_thread(self._store.watched.add, found, self._store.gateway)
                judged += 1
        await asyncio.to_thread(self._tidy, {day.path for _, day in days}, now)
        if judged or self._noted is None or abs(now - self._noted) >= _NOTED_AGAIN:
            self._noted = now  # it reads more than a year of all valves
            await asyncio.to_thread(self.note_states)
        return judged

    def note_states(self, today: date | None = None) -> None:
        """Note what friction in service says of each valve's state. Reads the database and blocks."""
        today = today or datetime.now(UTC).date()
        said: dict[str, ChangedInService] = {}
        for tag, days in self._store.watched.frictions(today - timedelta(days=HISTORY_DAYS)).items():
            valve = self._plant.valves.get(tag)
            if valve is None:
                continue
            baseline = self._store.figures.baseline(tag)
            since = date.min if baseline is None else baseline.test.at.astimezone(self._plant.zone).date()
            present = present_nameplate(valve)
            of_now = [one for one in days if since <= one.day <= today and one.judged_by.is_like(present)]
            changed = friction_changed(of_now, today, valve.health, facts_of(valve))
            if changed is not None:
                said[tag] = changed
        self._stale.note_watched(said)

    def _open(self, now: datetime) -> list[tuple[PlantValve, WatchDay]]:
        """Return the days that are over and were not judged, with their valves."""
        ours = {tag: valve for tag, valve in self._plant.valves.items() if self._plant.is_ours(tag)}
        folder = self._store.folder / "watched"
        if not folder.is_dir():
            return []
        there = {tag: days_in(folder, tag) for tag in ours}
        oldest = min((day.day for days in there.values() for day in days), default=now.date())
        known = self._store.watched.judged([tag for tag, days in there.items() if days], oldest)
        found = [
            (ours[tag], day)
            for tag, days in there.items()
            for day in days
            if day.day not in known[tag] and _is_over(ours[tag], day, now)
        ]
        return sorted(found, key=lambda one: one[1].day)

    def _tidy(self, unjudged: Collection[Path], now: datetime) -> None:
        """Remove samples of valves that are no longer watched; those of others go as their rules say."""
        watched = [tag for tag, valve in self._plant.valves.items() if valve.wiring.watch and self._plant.is_ours(tag)]
        tidy_left(self._store.folder / "watched", watched, unjudged, now.date())

    async def _judged(self, valve: PlantValve, day: WatchDay) -> WatchedDay | None:
        """Return what a day says; None where nobody could judge it yet."""
        if self._judge is None:
            return None
        present = present_nameplate(valve)  # the plant file may be read again meanwhile
        try:
            found = await self._judge.judge_day(day.path, valve.nameplate)
        except RecordingError as error:
            at = datetime.fromtimestamp(_written_s(day.path), UTC)
            found = DayJudged(0, at, at, reason=message_of(error))
        except InternalError as error:
            self._tries[day.path] = self._tries.get(day.path, 0) + 1
            _LOG.error("day in service not judged", valve=day.tag, day=str(day.day), error=str(error))
            if self._tries[day.path] < _MOST_TRIES:
                return None
            at = datetime.fromtimestamp(_written_s(day.path), UTC)
            found = DayJudged(0, at, at, reason=message_of(error))
        about: Mapping[str, object] = {"valve": day.tag, "day": str(day.day), "rows": found.rows}
        _LOG.info("day in service judged", **about, reason=found.reason)
        return WatchedDay(
            day.tag,
            day.day,
            found.began_at,
            found.ended_at,
            found.rows,
            datetime.now(UTC),
            self._software,
            found.document,
            found.reason,
            present,
        )


def _is_over(valve: PlantValve, day: WatchDay, now: datetime) -> bool:
    rules = valve.wiring.watch
    ends = rules.span_of(day.day).ends if rules is not None else datetime.fromtimestamp(_written_s(day.path), UTC)
    return now >= ends + _SETTLED


def _written_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
