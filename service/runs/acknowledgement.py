"""A test that ended badly: it stands as an alarm and bars the next test of its valve until somebody acknowledges it."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

from drivers.outcome import Ended
from drivers.permissives import Permissive
from service.runs.run import Run, RunState

ENDED_KEY: Final = "ended"  # of a run's quality: how the motion itself ended
NOT_CONFIRMED: Final = "SAFE STATE NOT CONFIRMED: go and look at the valve"


def ended_badly(run: Run) -> bool:
    """Whether a valve may stand otherwise than it should, or was moved until a fault ended it.

    A test that was stopped, or whose analysis failed after a good motion, did not end badly; nor did one that never
    moved the valve.
    """
    if not run.state.finished:
        return False
    if run.safe_confirmed is False:
        return True
    how = (run.quality or {}).get(ENDED_KEY)
    if run.state is RunState.FAILED:
        return run.safe_confirmed is not None and how != Ended.COMPLETED.value
    return run.state is RunState.INTERRUPTED and run.started_at is not None and how is None


def needs_acknowledgement(run: Run) -> bool:
    """Whether it ended badly and nobody has looked at it yet."""
    return ended_badly(run) and run.acknowledged_at is None


def alarm_of(run: Run | None) -> str:
    """Return the alarm that stands for a valve whose last test this is; "" where none does."""
    if run is None or not needs_acknowledgement(run):
        return ""
    unsafe = f"{NOT_CONFIRMED}; " if run.safe_confirmed is False else ""
    return f"{unsafe}test {run.id} {run.state.value}: {run.error}"


def acknowledged(run: Run, who: str, note: str) -> Run:
    """Return the run as somebody who looked at the valve leaves it; the first acknowledgement stays."""
    if run.acknowledged_at is not None:
        return run
    return replace(run, acknowledged_at=datetime.now(UTC), acknowledged_by=who, acknowledgement=note)


def last_end(run: Run | None) -> Permissive:
    """Return the permissive that the last test of a valve is."""
    name, limit = "last_test", "one that ended well or was acknowledged"
    if run is None:
        return Permissive(name, True, "none yet", limit)
    if not needs_acknowledgement(run):
        value = f"{run.id} {run.state.value}" + (", acknowledged" if run.acknowledged_at is not None else "")
        return Permissive(name, True, value, limit)
    remedy = f"acknowledge first: look at the valve, then say so on its page, or by breakaway acknowledge {run.valve}"
    unsafe = ", SAFE STATE NOT CONFIRMED" if run.safe_confirmed is False else ""
    return Permissive(name, False, f"{run.id} {run.state.value}{unsafe}", limit, remedy)
