"""A stem that only slips gives its friction too: from where it breaks away, and how each slip runs."""

from __future__ import annotations

import pytest

from estimators.base import Status
from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from estimators.engine.slips import balance_of_slips
from tests.support.random_valves import random_test
from tests.support.rough_valves import RoughCase, case
from valve.messages import messages_in


def _read(made: RoughCase) -> Reading:
    reading = read(measured_rows(made.recording).recording, made.nameplate)
    assert isinstance(reading, Reading)
    return reading


@pytest.mark.long
def test_a_usual_stem_that_only_slips_is_known_from_its_slips() -> None:
    # One slip ends just before the force turns back: it may come to rest before the corner.
    made = case("slipping", "triangle", "usual", seed=1)
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)
    truth = made.truth.parameters.by_symbol()

    assert estimate.status is Status.OK
    for symbol, most in (("k", 0.003), ("F_c", 0.02), ("F_s", 0.02), ("m", 0.03)):
        one = estimate.parameters[symbol]
        assert one.value is not None, one.note
        assert one.ci95 is not None
        assert abs(one.value / truth[symbol] - 1.0) < most
        assert one.ci95[0] <= truth[symbol] <= one.ci95[1]


def test_breakaways_alone_give_the_spring_rate_the_preload_and_a_bound_on_friction() -> None:
    made = case("slipping", "triangle", "usual", seed=3)
    found = balance_of_slips(_read(made))
    truth = made.truth.parameters.by_symbol()

    assert found is not None
    for symbol in ("k", "F_0", "F_c"):
        known = found.known(symbol)
        assert abs(known.value - truth[symbol]) < 3.0 * known.std_error
    assert found.known("k").std_error < 0.005 * truth["k"]


def test_a_stem_with_two_breakaways_gives_no_balance_of_slips() -> None:
    assert balance_of_slips(_read(case("vendor", "triangle", "mild", 5.0e-3, seed=1))) is None


@pytest.mark.long
def test_motions_in_which_a_stem_rested_unseen_draw_no_parameter_after_them() -> None:
    # a quarter of the motions are two slips in one: they left 7 times the noise, and F_c was 23 % too small
    made = random_test(2269)
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)

    assert estimate.residual_rms_m == pytest.approx(made.noise_m, rel=0.05)
    assert estimate.value("F_c") == pytest.approx(made.truth.coulomb_friction_n, rel=0.05)
    told = next(one for one in messages_in(estimate.message) if one.code == "motions_left_out")
    left, of = told.values["left"], told.values["count"]
    assert isinstance(left, int)
    assert isinstance(of, int)
    assert 0.05 < left / of < 0.5
