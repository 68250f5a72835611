"""One check: one valve of one schedule on one night, as the store keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Any

from valve.messages import say


class CheckState(StrEnum):
    """Where a check stands. What is planned is in no table yet."""

    PLANNED = "planned"
    QUEUED = "queued"
    RUNNING = "running"
    COMPLETED = "completed"
    SKIPPED = "skipped"
    FAILED = "failed"
    INTERRUPTED = "interrupted"

    @property
    def ended(self) -> bool:
        """Whether nothing more will happen to the check."""
        return self not in (CheckState.PLANNED, CheckState.QUEUED, CheckState.RUNNING)


@dataclass(frozen=True, slots=True)
class Check:
    """``occurrence`` is the plant's own clock at which it was due (ISO 8601 without a zone); ``due_at`` the instant.

    ``attempt`` names the process that took it up: one that is found with another process's name was cut off.
    """

    schedule: str
    occurrence: str
    valve: str
    due_at: datetime
    window_s: float
    sequence: str
    bus: str
    gateway: str = ""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    requested_by: str = ""
    state: CheckState = CheckState.QUEUED
    reason: str = ""
    test_id: str | None = None
    attempt: str | None = None
    attempted_at: datetime | None = None
    ended_at: datetime | None = None
    until: Mapping[str, Any] | None = None
    id: int = 0

    @property
    def ends_at(self) -> datetime:
        """The last instant at which its test may start."""
        return self.due_at + timedelta(seconds=self.window_s)

    @property
    def key(self) -> str:
        """Under which its test is asked for: a check that is taken up twice has one test."""
        return f"nightly {self.id} of {self.schedule} {self.occurrence}"

    def missed(self, now: datetime) -> str:
        """Say that nobody looked at the clock in time."""
        return say(
            "check_missed",
            "no service looked at the clock within {window:g s} of {due} (it is {now}): nothing was moved",
            window=self.window_s,
            due=self.due_at,
            now=now,
        )

    def too_late(self, reason: str) -> str:
        """Say that its window has ended, and what was in the way."""
        return say(
            "window_ended",
            "its window of {window:g s} ended at {end}: {why}",
            window=self.window_s,
            end=self.ends_at,
            why=reason or say("turn_did_not_come", "its turn did not come"),
        )
