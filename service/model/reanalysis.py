"""A re-analysis: stored tests of a time that are analysed anew with the installed version, as the store keeps it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum


class RepeatState(StrEnum):
    """Where one test of a re-analysis stands."""

    QUEUED = "queued"
    RUNNING = "running"
    COMPLETED = "completed"
    SKIPPED = "skipped"
    FAILED = "failed"
    STOPPED = "stopped"

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen to the test."""
        return self not in (RepeatState.QUEUED, RepeatState.RUNNING)


class ReanalysisState(StrEnum):
    """Where a re-analysis stands."""

    QUEUED = "queued"
    RUNNING = "running"
    ENDED = "ended"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which tests are meant: asked for at ``since`` or later and before ``until``, of one valve or of all.

    ``older_only`` leaves out what the present engine analysed.
    """

    since: datetime
    until: datetime | None = None
    valve: str | None = None
    older_only: bool = False


@dataclass(frozen=True, slots=True)
class Reanalysis:
    """One request. ``stopped_by`` is who ended it before its time."""

    wanted: Wanted
    gateway: str
    software: str
    requested_by: str
    asked_at: datetime
    ended_at: datetime | None = None
    stopped_by: str | None = None
    id: int = 0


@dataclass(frozen=True, slots=True)
class Repeat:
    """One test of a re-analysis. ``attempt`` names the process that took it up."""

    id: int
    test_id: str
    valve: str
    state: RepeatState
    attempt: str | None
    begun_at: datetime | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ReanalysisProgress:
    """A re-analysis with how many of its tests stand where, and the first of those that came to nothing."""

    reanalysis: Reanalysis
    counts: Mapping[RepeatState, int]
    troubles: Sequence[Repeat] = field(default=())

    @property
    def total(self) -> int:
        """How many tests it has."""
        return sum(self.counts.values())

    @property
    def done(self) -> int:
        """How many of its tests have ended."""
        return sum(count for state, count in self.counts.items() if state.ended)

    @property
    def state(self) -> ReanalysisState:
        """Where it stands."""
        if self.reanalysis.ended_at is not None:
            return ReanalysisState.ENDED if self.reanalysis.stopped_by is None else ReanalysisState.STOPPED
        return ReanalysisState.QUEUED if self.counts.get(RepeatState.QUEUED) == self.total else ReanalysisState.RUNNING


@dataclass(frozen=True, slots=True)
class Found:
    """What the store has for a request: tests to analyse here, those of other gateways, those with no recording."""

    here: int
    elsewhere: Mapping[str, int]
    without_recording: int
    queued_already: int
