from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from sqlalchemy import Engine

from service.config.settings import load_plant
from service.store.database import open_database
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service


class Clock:
    """An instant that stands still until it is moved."""

    def __init__(self) -> None:
        self.at = datetime(2026, 11, 21, 3, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.at

    def move(self, **by: float) -> None:
        self.at += timedelta(**by)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def engine(quick_path: Path) -> Iterator[Engine]:
    engine = open_database(f"sqlite:///{quick_path / 'breakaway.db'}")
    yield engine
    engine.dispose()


@pytest.fixture
async def open_client(plant_file: Path) -> AsyncIterator[httpx.AsyncClient]:
    """Return a client of a service without sign-in."""
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        yield client
