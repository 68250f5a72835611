"""A run: one test of one valve, as the store keeps it."""

from __future__ import annotations

import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Final

from drivers.stands_at import StandsAt
from valve.errors import NotFoundError
from valve.messages import say

ENDED_KEY: Final = "ended"  # of a run's quality: how the motion itself ended
ENDED_EARLY_KEY: Final = "ended_early"  # of it, too: why the test ended before its sequence did
RUN_ID: Final = re.compile(r"[0-9]{8}T[0-9]{6}Z-[0-9a-f]{8}")

_NO_FILE_NAME: Final = re.compile(r"[^A-Za-z0-9._-]+")


class RunState(StrEnum):
    """Where a run stands; the names are the contract's."""

    QUEUED = "queued"
    RUNNING = "running"
    ANALYZING = "analyzing"
    COMPLETED = "completed"
    FAILED = "failed"
    STOPPED = "stopped"
    INTERRUPTED = "interrupted"

    @property
    def finished(self) -> bool:
        """Whether nothing more will happen to the run."""
        return self not in (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)


class Label(StrEnum):
    """What a test stands for beside a repair: how the valve was found, how it was left."""

    AS_FOUND = "as_found"
    AS_LEFT = "as_left"


@dataclass(frozen=True, slots=True)
class Run:
    """One test. ``number`` is the store's own count and the run number that fences the device; 0 before it is stored.

    ``safe_confirmed`` is None while the valve has not moved or still moves, then whether its safe value was read back.
    ``commanded`` is whether anything was sent that can move the valve; None while that is open, or was never kept.
    ``note`` and ``work_order`` are what people said of it, ``described_by`` at ``described_at``, its label included.
    ``stands`` is where it was seen to stand after its motion; None while it moves, and where nobody looked.
    ``until`` is what the test was to know to end early, in percent by symbol; it is stored with ``quality``.
    """

    id: str
    valve: str
    sequence: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    number: int = 0
    state: RunState = RunState.QUEUED
    progress: float = 0.0
    created_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    started_at: datetime | None = None
    motion_ended_at: datetime | None = None
    finished_at: datetime | None = None
    error: str = ""
    commanded: bool | None = None
    safe_confirmed: bool | None = None
    idempotency_key: str | None = None
    recording_file: str | None = None
    recording_sha256: str | None = None
    quality: Mapping[str, Any] | None = None
    analysis: Mapping[str, Any] | None = None
    software: str = ""
    requested_by: str = ""
    schedule: str | None = None
    gateway: str = ""
    label: Label | None = None
    permissives: Mapping[str, Any] | None = None
    acknowledged_at: datetime | None = None
    acknowledged_by: str | None = None
    acknowledgement: str | None = None
    stands: StandsAt | None = None
    note: str | None = None
    work_order: str | None = None
    described_at: datetime | None = None
    described_by: str | None = None
    until: Mapping[str, str] | None = None

    @property
    def ended_early(self) -> Mapping[str, Any] | None:
        """Why the test ended before its sequence did, and the time that saved, s; None where it did not.

        What it knew stands under ``until``, a breakaway out of its family under ``out_of_family``.
        """
        return (self.quality or {}).get(ENDED_EARLY_KEY)

    @property
    def file_stem(self) -> str:
        """What a file of it is called when it is downloaded: tag, date and time, UTC: ``FV-101_2026-11-21_031502Z``."""
        return f"{file_words(self.valve)}_{self.created_at.astimezone(UTC):%Y-%m-%d_%H%M%SZ}"


def file_words(text: str) -> str:
    """Return a tag as it can stand in the name of a file on every system."""
    return _NO_FILE_NAME.sub("-", text).strip("-.") or "valve"


def new_run_id(now: datetime | None = None) -> str:
    """Return an id that sorts by time and cannot be guessed from another: ``20261121T031502Z-9f3c01ab``."""
    return f"{(now or datetime.now(UTC)):%Y%m%dT%H%M%SZ}-{secrets.token_hex(4)}"


def checked_run_id(text: str) -> str:
    """Return ``text`` where it has the form of an id. Raises NotFoundError otherwise, so that no other text goes on."""
    if RUN_ID.fullmatch(text) is None:
        raise NotFoundError(say("test_unknown", "test {test} is unknown: GET /tests lists all", test=repr(text[:64])))
    return text
