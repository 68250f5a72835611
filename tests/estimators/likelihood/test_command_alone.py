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


def test_every_share_of_lag_and_damping_is_tried_before_damping_is_given() -> None:
    # lag 0.043 s, F_v/k 0.022 s: the search came to 0.025 and 0.043 s, whose cost is 220 higher, and gave their values
    test = random_test(2481)
    estimate = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)
    assert what_is_wrong(estimate, test) == ()
    for symbol in ("F_v", "F_c", "F_s"):
        entry, truth = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert entry.value is not None, estimate.message
        assert entry.std_error is not None
        assert abs(entry.value - truth) < 4.0 * entry.std_error < 0.5 * truth
