from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from service.model.run import Run, RunState, new_run_id
from service.model.watched_day import WatchedDay
from service.store.store import Store
from tests.support.gateway import Gateway, gateway
from tests.support.made_analysis import FRICTION_N, made_analysis
from tests.support.tablets import Tablet, tablet
from tests.support.wired_plant import TAG


@pytest.fixture(scope="session")
def browser() -> Iterator[Tablet]:
    with tablet() as one:
        yield one


@pytest.fixture(scope="session")
def second_browser() -> Iterator[Tablet]:
    with tablet() as one:
        yield one


def _folder() -> tempfile.TemporaryDirectory[str]:
    memory = Path("/dev/shm")
    return tempfile.TemporaryDirectory(dir=memory if os.access(memory, os.W_OK) else None)


@pytest.fixture(scope="package")  # a process has one queue of jobs: the tests of other folders want theirs
def service() -> Iterator[Gateway]:
    """Return a service without sign-in, with three tests of a month and four days in service in its store."""
    with _folder() as folder, gateway(Path(folder)) as running:
        for days, friction_n in ((30, FRICTION_N), (15, FRICTION_N + 60.0), (1, FRICTION_N + 140.0)):
            store_test(running, days, friction_n)
        for days in range(1, 5):
            store_watched_day(running, days, FRICTION_N - 40.0)
        yield running


@pytest.fixture
def guarded_service(tmp_path: Path) -> Iterator[Gateway]:
    """Return a service that nobody uses without signing in."""
    with _folder() as folder, gateway(Path(folder), access="sign-in") as running:
        yield running


@pytest.fixture
def permit_service() -> Iterator[Gateway]:
    """Return a service whose valve is tested with a work permit alone."""
    with _folder() as folder, gateway(Path(folder), needs_permit=True) as running:
        yield running


@pytest.fixture
def judged_service() -> Iterator[Gateway]:
    """Return a service whose valve is to be closed 25 s after each motion, and is not at its safe value."""
    stem = "safe_position_m = 0.0\nsafe_position_tolerance_m = 0.002\nstem_read_after_s = 25.0"
    with _folder() as folder, gateway(Path(folder), stem=stem) as running:
        yield running


def store_test(running: Gateway, days: float, friction_n: float, *, state: RunState = RunState.COMPLETED) -> Run:
    """Put a test of some days ago into the store."""
    at = datetime.now(UTC) - timedelta(days=days)
    done = state is RunState.COMPLETED
    run = Run(
        id=new_run_id(at),
        valve=TAG,
        sequence="triangle",
        state=state,
        progress=1.0,
        created_at=at,
        started_at=at,
        motion_ended_at=at,
        finished_at=at,
        safe_confirmed=done,
        error="" if done else "the device stopped answering at 12.4 s: look at its wire",
        analysis=made_analysis(friction_n, ne107="M" if friction_n > 1.2 * FRICTION_N else "N") if done else None,
        software="breakaway 0",
        requested_by="nightly",
    )
    stored = running.part(Store).runs.insert(run)
    running.part(Store).runs.save(stored)
    return stored


def store_watched_day(running: Gateway, days: int, friction_n: float) -> None:
    """Put a day in service, of some days ago, into the store."""
    ended_at = datetime.now(UTC) - timedelta(days=days)
    known = {"unit": "N", "value": friction_n, "ci95": [friction_n - 50.0, friction_n + 50.0], "scatter": None}
    figures = {"friction": {**known, "count": 30, "note": ""}}
    figures["breakaway"] = {**known, "value": None, "ci95": None, "count": 2, "note": "2 of these, 4 are needed"}
    travel = {"unit": "m", "total": 0.5345, "cycles": 15}
    document = {"schema": "breakaway/watch/1", "moves": 39, "figures": figures, "travel": travel}
    began_at = ended_at - timedelta(hours=7)
    day = WatchedDay(TAG, began_at.date(), began_at, ended_at, 9000, ended_at, "breakaway 0", document)
    running.part(Store).watched.add(day, "")
