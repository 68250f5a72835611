"""A schedule and when it is due: cron on the plant's own clock, daylight saving included.

A time that the spring's change leaves out is due at the first minute after it; one that the autumn's change brings
twice is one occurrence, at its first coming. So an occurrence is named by the plant's clock, not by the instant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any
from zoneinfo import ZoneInfo

from cronsim import CronSim


@dataclass(frozen=True, slots=True)
class Schedule:
    """When which valves are checked: ``cron`` in ``zone``, each start at most ``window_s`` late.

    ``until`` is how well each test is to know figures to end before its sequence does, as a request says it.
    """

    name: str
    cron: str
    zone: ZoneInfo
    valves: tuple[str, ...]
    sequence: str
    window_s: float
    overrides: Mapping[str, Any] = field(default_factory=dict)
    until: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class Occurrence:
    """``name`` is the plant's clock (``2026-10-25T02:30``), ``due_at`` the instant in UTC."""

    name: str
    due_at: datetime


def occurrences(schedule: Schedule, after: datetime) -> Iterator[Occurrence]:
    """Return what comes after an instant, in order, without end."""
    seen = ""
    for local in CronSim(schedule.cron, after.astimezone(schedule.zone)):
        name = f"{local:%Y-%m-%dT%H:%M}"
        if name <= seen or _came_before(local, after):
            continue  # the hour that comes twice
        seen = name
        yield Occurrence(name, local.astimezone(UTC))


def _came_before(local: datetime, after: datetime) -> bool:
    """Whether this is the second coming of a clock time whose first is no later than ``after``."""
    return local.fold == 1 and local.replace(fold=0).astimezone(UTC) <= after.astimezone(UTC)


def occurrences_between(schedule: Schedule, after: datetime, until: datetime) -> list[Occurrence]:
    """Return what comes after ``after`` and not after ``until``."""
    found = []
    for one in occurrences(schedule, after):
        if one.due_at > until:
            break
        found.append(one)
    return found


def next_occurrence(schedule: Schedule, after: datetime) -> Occurrence | None:
    """Return what comes first after an instant; None where nothing comes."""
    return next(occurrences(schedule, after), None)


def nth_last_due(schedule: Schedule, before: datetime, count: int) -> datetime | None:
    """Return when the ``count``-th last occurrence before an instant was due; None where there were not so many."""
    seen: set[str] = set()
    for local in CronSim(schedule.cron, before.astimezone(schedule.zone), reverse=True):
        seen.add(f"{local:%Y-%m-%dT%H:%M}")  # the hour that comes twice counts once
        if len(seen) == count:
            return local.replace(fold=0).astimezone(UTC)
    return None
