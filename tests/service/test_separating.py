"""What a separating test is chosen from: sequences in the room of a valve, and nothing where nothing is ambiguous."""

from __future__ import annotations

import numpy as np

from service.analysis.separating import find_separating_test, planned, room_of_recordings
from service.model.sequences import Room
from tests.support.nominal_recordings import triangle_test
from valve.recording import Recording

WIDE = Room(1.0e4, 6.0e4, 1.0e5, 300.0)


def test_all_planned_sequences_stay_within_the_room() -> None:
    found = planned(WIDE)
    assert {"diagnostic", "multi_rate", "small_loops", "dwell"} == {one.name for one in found}
    for one in found:
        assert one.waveform.range_pa == (1.0e4, 6.0e4)
        assert one.overrides["low_pa"] == 1.0e4
        assert one.waveform.duration_s <= WIDE.longest_s


def test_a_short_or_slow_room_leaves_out_what_does_not_fit() -> None:
    assert {one.name for one in planned(Room(1.0e4, 6.0e4, 1.0e5, 70.0))} == {"diagnostic", "multi_rate", "small_loops"}
    assert planned(Room(1.0e4, 6.0e4, 10.0, 300.0)) == []


def test_the_room_of_recordings_is_their_range_of_pressure() -> None:
    room = room_of_recordings([triangle_test(0.01)])
    assert room is not None
    assert (room["low_pa"], room["high_pa"]) == (0.0, 82737.0)
    time_s = np.linspace(0.0, 1.0, 10)
    assert room_of_recordings([Recording(time_s, time_s, force_n=time_s)]) is None


def test_nothing_is_proposed_where_nothing_is_ambiguous() -> None:
    assert find_separating_test(None, room_of_recordings([triangle_test(0.01)])) is None
