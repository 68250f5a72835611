from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import Engine

from service.store.database import open_database


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
