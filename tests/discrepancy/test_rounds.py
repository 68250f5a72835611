"""In which order causes are fitted, and from where."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from discrepancy import rounds, selection
from discrepancy.baseline import STATIC_SCAN, fit_baseline, scanned
from discrepancy.causes.channels import READING_LAG
from discrepancy.choice import Choice
from discrepancy.diagnose import unexplained_message
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Tally
from discrepancy.observed import Observed, observe
from discrepancy.registry import CAUSES
from discrepancy.screening import Candidate, distinct
from discrepancy.setting import setting_of
from discrepancy.walking import walked
from tests.discrepancy.hidden import hidden


@pytest.fixture(scope="module")
def plain() -> Fit:
    case = hidden("nominal", seed=1)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed)
    assert fit is not None
    return fit


@pytest.mark.parametrize(
    ("promised", "order"),
    [
        ({"position_lag": 0.7, "friction_gradient": 0.1, "position_backlash": 0.01}, (0, 1, 2)),
        ({"flow_force": 0.9, "dual_rate_spring": 0.8, "travel_stop_low": 0.6}, (2, 0, 1)),
        ({"flow_force": 0.9, "dual_rate_spring": 0.8, "travel_stop_low": 0.3}, (0, 1, 2)),
    ],
    ids=["a shy one that promises most", "a quick one that promises much", "a quick one that promises little"],
)
def test_causes_are_fitted_by_promise_and_quick_ones_before_the_work_is_used_up(
    promised: dict[str, float], order: tuple[int, ...], plain: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted: list[str] = []

    def noted(fit: Fit, candidate: Candidate, *_others: Any) -> Fit:
        fitted.append(candidate.cause.name)
        return replace(fit, cost=math.inf)

    monkeypatch.setattr(rounds, "refit", noted)
    candidates = [Candidate(CAUSES[name], (), promise) for name, promise in promised.items()]
    rounds.refits(plain, candidates, setting_of(plain), 9, math.inf)
    names = list(promised)
    assert fitted == [names[place] for place in order]


@pytest.mark.parametrize(("found", "left", "is_refined"), [(0.0, 0.1, False), (0.5, 0.1, True), (0.0, 0.01, True)])
def test_beside_a_cause_that_leaves_noise_alone_none_but_a_kin_is_refined_from_far_off(
    found: float, left: float, is_refined: bool, plain: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of the work of a search went into the refinement of causes that were 200 noises off and stayed there."""
    searched: list[str] = []
    shares: dict[str, float] = {"dual_rate_spring": found, "flow_force": left, "spring_hardening": left}
    far = replace(plain, residual=30.0 * plain.residual, cost=900.0 * plain.cost)

    def fitted(_fit: Fit, candidate: Candidate, *_others: Any) -> Fit:
        share = shares[candidate.cause.name]
        model = replace(plain.model, causes=(candidate.cause.name,))
        size = math.sqrt(1.0 + 899.0 * share)
        return replace(plain, model=model, residual=size * plain.residual, cost=size**2 * plain.cost)

    def noted(fit: Fit) -> Fit:
        searched.extend(fit.model.causes)
        return fit

    monkeypatch.setattr(rounds, "refit", fitted)
    monkeypatch.setattr(rounds, "refined", noted)
    monkeypatch.setattr(rounds, "may_ring", lambda _fit, _setting: False)
    candidates = [Candidate(CAUSES[name], (), 0.9) for name in ("dual_rate_spring", "flow_force")]
    rounds.refits(far, candidates, setting_of(plain), 9, math.inf)
    assert searched == ["flow_force"] * is_refined
    searched.clear()
    candidates = [Candidate(CAUSES[name], (), 0.9) for name in ("dual_rate_spring", "spring_hardening")]
    rounds.refits(far, candidates, setting_of(plain), 9, math.inf)
    assert searched == ["spring_hardening"]


def test_a_lag_in_place_of_damping_begins_with_the_nameplates_mass(plain: Fit) -> None:
    setting = setting_of(plain)
    heavy = replace(setting, values={**setting.values, "m": 96.0})
    masses = {start["m"] for start in READING_LAG.starts(heavy)}
    assert masses == {96.0, setting.observed.nameplate.actuator.moving_mass_kg}


def test_starts_of_other_unknowns_are_not_alike() -> None:
    first, more, near = {"force_n": 10.0}, {"force_n": 10.0, "F_c": 40.0}, {"force_n": 10.01}
    assert distinct([first, more, near]) == [first, more]
    assert distinct([more, first]) == [more, first]


def test_no_fit_is_led_further_once_all_work_is_done(plain: Fit) -> None:
    tally = Tally()
    start = start_fit(replace(plain.model, tally=tally), plain.point + 10.0 * plain.model.unknowns.steps)
    assert descend(start, most_steps=1).cost < start.cost
    tally.most = tally.work
    assert descend(start, most_steps=1).cost == start.cost
    assert scanned(start, "d", STATIC_SCAN) is start
    assert walked(start, lambda _here: pytest.fail("a step was taken")) is start


def test_a_search_ends_where_its_work_is_done_and_says_so(plain: Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selection, "WHOLE_WORK", 1.0)
    tally = Tally()
    # what no cause explains: every other block lies 20 noises off
    residual = plain.residual + 20.0 * (-1.0) ** np.arange(plain.residual.size)
    odd = replace(plain, model=replace(plain.model, tally=tally), residual=residual, cost=float(residual @ residual))
    choice = selection.choose(odd, [CAUSES["friction_gradient"]], lambda _share, _phase: None)
    assert choice.is_cut
    assert choice.causes == ()
    assert tally.most == math.inf
    assert "ended early" in unexplained_message(choice)
    whole = Choice(odd, odd, (), (), (), ())
    assert "ended early" not in unexplained_message(whole)


def test_what_a_search_for_other_places_led_hardly_lower_is_not_searched_again(
    plain: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[float] = []

    def slightly_lower(fit: Fit) -> Fit:
        searched.append(fit.cost)
        return replace(fit, cost=0.99 * fit.cost)

    monkeypatch.setattr(rounds, "refined", slightly_lower)
    far = replace(plain, cost=100.0 * plain.cost, residual=10.0 * plain.residual)
    once = rounds.closer(far, [(READING_LAG, far)], math.inf)
    assert len(searched) == 1
    twice = rounds.closer(far, once, math.inf)
    assert len(searched) == 1
    assert twice[0][1].cost == once[0][1].cost
    # a fit that came lower since is worth another search
    rounds.closer(far, [(READING_LAG, replace(once[0][1], cost=0.5 * far.cost))], math.inf)
    assert len(searched) == 2


def test_a_friction_may_change_by_more_than_the_coulomb_part_that_damping_left(plain: Fit) -> None:
    """A fit without the cause may hold next to all friction in F_v and a wide DV (graphite, a drift of a fifth)."""
    values = plain.values
    kinetic_n = values["F_c"] + values["F_v"] * setting_of(plain).sliding_m_per_s
    viscous = 0.9 * kinetic_n / setting_of(plain).sliding_m_per_s
    point = plain.model.unknowns.point({**values, "F_c": 0.1 * kinetic_n, "F_v": viscous})
    change = CAUSES["friction_drift"].unknowns(setting_of(replace(plain, point=point)))[0]
    assert change.upper > 0.2 * kinetic_n
