"""In which order causes are fitted, and from where."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from discrepancy import rounds
from discrepancy.baseline import fit_baseline
from discrepancy.causes.channels import READING_LAG
from discrepancy.least_squares import Fit
from discrepancy.observed import Observed, observe
from discrepancy.registry import CAUSES
from discrepancy.screening import Candidate, distinct
from discrepancy.setting import setting_of
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


def test_a_lag_in_place_of_damping_begins_with_the_nameplates_mass(plain: Fit) -> None:
    setting = setting_of(plain)
    heavy = replace(setting, values={**setting.values, "m": 96.0})
    masses = {start["m"] for start in READING_LAG.starts(heavy)}
    assert masses == {96.0, setting.observed.nameplate.actuator.moving_mass_kg}


def test_starts_of_other_unknowns_are_not_alike() -> None:
    first, more, near = {"force_n": 10.0}, {"force_n": 10.0, "F_c": 40.0}, {"force_n": 10.01}
    assert distinct([first, more, near]) == [first, more]
    assert distinct([more, first]) == [more, first]
