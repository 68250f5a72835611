"""A file that does not say how its channels were read: a delay and a parameter that takes its place."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.base import NORMAL_95, Status
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.mixture import reaching
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from tests.estimators.random_valves import random_test

SEED = 2103  # the pressure is read 0.18 periods late; without a delay a DV 15 times too large fits nearly as well


def test_the_intervals_hold_the_delay_and_what_stands_for_it_where_only_the_odds_beforehand_decide() -> None:
    test = random_test(SEED)
    estimate, truth = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate), test.truth.by_symbol()
    assert estimate.status is Status.OK, estimate.message
    assert 0.01 < estimate.diagnostics["weight_of_delay"] < 0.5
    assert estimate.diagnostics["fitted"]["DV"] > 10.0 * truth["DV"]
    assert estimate.value("DV") is None
    for symbol in ("m", "k", "F_v", "F_c", "F_s", "F_0"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None
        assert abs(entry.value - truth[symbol]) < 3.0 * entry.std_error, symbol
        assert entry.value == pytest.approx(truth[symbol], rel=0.02), symbol


def test_intervals_reach_the_other_hypothesis_along_the_line_between_both() -> None:
    here = Knowledge(("k", "m"), (100.0, 2.0), np.diag([1.0, 0.01]))
    there = Knowledge(("k", "m"), (100.0 + 20.0, 2.0 - 1.0), np.diag([9.0, 9.0]))
    knows = reaching(here, there)
    assert knows.values == here.values
    assert knows.std_error("k") == pytest.approx(np.hypot(1.0, 20.0 / NORMAL_95))
    assert knows.std_error("m") == pytest.approx(np.hypot(0.1, 1.0 / NORMAL_95))
    # m + k/20 is the same in both, and as well known as before
    along = np.array([0.05, 1.0])
    assert along @ knows.covariance @ along == pytest.approx(along @ here.covariance @ along)
