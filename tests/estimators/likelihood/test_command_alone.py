"""Maximum likelihood where only the command is recorded: its I/P's lag and F_v/k of the stem are lags in series."""

from __future__ import annotations

from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from tests.benchmarks.random_valves import what_is_wrong
from tests.estimators.random_valves import random_test


def test_a_lag_of_the_transducer_is_not_taken_for_damping_of_the_stem() -> None:
    # lag 0.28 s, F_v/k 0.004 s, 50 ms: a fit with F_v/k 0.28 s and no lag leaves hardly more, and lies far apart
    test = random_test(2246)
    estimate = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)
    assert what_is_wrong(estimate, test) == ()
    assert all(estimate.value(symbol) is not None for symbol in ("k", "F_c", "F_0")), estimate.message
