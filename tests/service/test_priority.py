"""What works beside the service stands back behind it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from service.figures.drawer import Drawer
from service.recordings.conversion import Converter
from service.workers.priority import ANALYSIS, AWAITED
from valve.errors import RecordingError


def _own_priority() -> str:
    return str(os.getpriority(os.PRIO_PROCESS, 0))


@pytest.fixture
def lower() -> int:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    return min(19, own + AWAITED)


def test_what_somebody_waits_for_goes_before_the_analyses() -> None:
    assert 0 < AWAITED < ANALYSIS


async def test_pictures_are_drawn_below_the_service(lower: int) -> None:
    drawer = Drawer()
    assert await drawer.svg("priority", _own_priority) == str(lower)
    await drawer.close()


async def test_files_are_converted_below_the_service(lower: int, tmp_path: Path) -> None:
    (tmp_path / "damaged.parquet").write_bytes(b"no recording")
    converter = Converter()
    with pytest.raises(RecordingError):
        await converter.csv(tmp_path / "damaged.parquet")
    assert converter._pool is not None
    assert converter._pool.submit(os.getpriority, os.PRIO_PROCESS, 0).result() == lower
    await converter.close()
