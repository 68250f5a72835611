"""Travel stops are read from a stem that rests on them, also where its friction alone would hold it there."""

from __future__ import annotations

import pytest

from estimators.motion.recorded_motion import RecordedMotion, read_motion
from tests.support.random_valves import random_test
from valve.parameters import TravelStops


def stops_of(seed: int) -> TravelStops | None:
    test = random_test(seed)
    motion = read_motion(test.recording, test.nameplate)
    assert isinstance(motion, RecordedMotion)
    return motion.stops


def test_a_motion_that_ends_while_the_force_goes_on_ended_on_a_stop() -> None:
    # the force on either stop is at most 1.09 F_s, and 0.91 F_s on one: a rest that friction could hold
    stops, truth = stops_of(2447), random_test(2447).stops
    assert stops is not None
    assert truth is not None
    assert stops.low_m == pytest.approx(truth.low_m, abs=1.0e-6)
    assert stops.high_m == pytest.approx(truth.high_m, abs=1.0e-6)


@pytest.mark.parametrize("kind", ["multi_rate", "noisy_pressure", "polled", "sine"])
def test_a_stem_that_the_force_turns_has_no_stop(kind: str) -> None:
    for seed in (1, 2, 3):
        test = random_test(seed, kind)
        motion = read_motion(test.recording, test.nameplate)
        assert not isinstance(motion, RecordedMotion) or motion.stops is None, (kind, seed)


def test_a_stop_that_takes_a_little_more_than_the_friction_is_seen() -> None:
    # 7 % beyond the friction, which is known to 5 N of 2026; unseen, nothing explained the recording
    stops, truth = stops_of(2514), random_test(2514).stops
    assert stops is not None
    assert truth is not None
    assert stops.high_m == pytest.approx(truth.high_m, abs=1.0e-6)
