"""When the garbage collector makes its full rounds: over little, and not while a valve moves."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from service.server.server import settle_memory


@pytest.fixture
def own_collector() -> Iterator[None]:
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("own_collector")
def test_a_service_that_has_started_makes_its_full_rounds_over_little() -> None:
    settle_memory()
    assert gc.get_freeze_count() > 10_000
