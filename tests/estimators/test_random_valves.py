"""The random tests that the estimators are measured with are what their labels say, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.random_valves import KINDS, LEAST_MOVED, UNINFORMATIVE, random_test
from valve.motion import simulate_motion


@pytest.mark.parametrize("kind", KINDS)
def test_the_recording_is_the_exact_motion_of_the_truth_with_noise(kind: str) -> None:
    for seed in range(6):
        test = random_test(seed, kind)
        time_s, position_m = test.recording.time_s, test.recording.position_m
        # the corners go on from the recording's first time, where the motion is in test.initial
        force_s = np.concatenate([time_s[:1], test.force_time_s[test.force_time_s > time_s[0]]])
        force_n = np.interp(force_s, test.force_time_s, test.force_n)
        exact_m = simulate_motion(
            test.truth, force_s, force_n, time_s, stops=test.stops, initial=test.initial
        ).position_m
        away = (position_m - exact_m)[np.isfinite(position_m)] / test.noise_m
        assert np.sqrt(np.mean(away**2)) == pytest.approx(1.0, rel=0.1), (kind, seed)


def test_a_seed_gives_the_same_test_again_and_another_seed_another() -> None:
    first, again, other = random_test(3), random_test(3), random_test(4)
    np.testing.assert_array_equal(first.recording.position_m, again.recording.position_m)
    assert first.truth == again.truth
    assert first.truth != other.truth


def test_only_immobile_valves_move_less_than_the_limit() -> None:
    for kind in KINDS:
        test = random_test(11, kind)
        moved_m = np.nanmax(test.recording.position_m) - np.nanmin(test.recording.position_m) - 6.0 * test.noise_m
        assert (moved_m < LEAST_MOVED * test.nameplate.actuator.travel_m) == (kind == UNINFORMATIVE), kind
