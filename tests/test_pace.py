from __future__ import annotations

import time

import pytest

from tests.pace import Pace


def test_what_disturbed_pieces_took_more_than_the_undisturbed_one_is_the_slowdown() -> None:
    pace = Pace()
    pace.pieces_s = [0.002, 0.002, 0.004, 0.004]
    assert pace.slowdown == pytest.approx(1.5)


def test_pieces_are_timed_beside_the_block_by_their_own_processor_time() -> None:
    with Pace() as pace:
        time.sleep(1.0)
    assert len(pace.pieces_s) >= 2
    assert sum(pace.pieces_s) < 0.5, "what a piece waited for was counted"
    assert pace.slowdown >= 1.0
