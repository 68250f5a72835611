"""A fit whose DV is far too large is led to the right one, though the first steps there lead higher."""

from __future__ import annotations

import math
from dataclasses import replace

from estimators.likelihood.all_rows import certified
from estimators.likelihood.descent import descend
from estimators.likelihood.limit_exchange import with_other_limits
from estimators.likelihood.search import Found
from tests.estimators.likelihood.posed import at_truth, posed
from tests.estimators.random_valves import random_test


def test_a_fit_with_a_limit_velocity_ninety_times_too_large_is_led_to_the_right_one() -> None:
    # a stem that rings at 4 Hz on ramps of two rates
    problem, _motion = posed(4105)
    model, truth = at_truth(problem, random_test(4105))
    model = replace(model, most_events=4_000)
    number = model.coordinates.names.index("DV")
    off = truth.copy()
    off[number] += math.log(90.0)
    held = descend(model, off, most_steps=6, held=("DV",), one_sided=True)
    before = Found(model, held.point, held.cost, certified(model, held.point), (), 1.0, 1, 1, 1.0)
    assert not before.certificate.is_good
    after = with_other_limits(before, 169.0)
    assert after.certificate.is_good
    assert after.cost < model.cost(truth) + 1.0
    # what is good stays as it is
    assert with_other_limits(after, 169.0) is after
    # a DV near the ramps' speed is one of a comb
    assert with_other_limits(before, 0.01) is before
