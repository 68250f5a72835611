"""Polled rows: the work is short, and what comes near first is followed before what hardly shows in them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from discrepancy import rounds
from discrepancy.causes.friction import LOCAL, STRIBECK
from discrepancy.diagnose import Diagnosis, Verdict, diagnose
from discrepancy.least_squares import Fit
from discrepancy.screening import Candidate
from estimators.exact_motion import ExactMotionEstimator
from tests.blind.cases import blind_case

pytestmark = pytest.mark.long


def product(seed: int) -> Diagnosis:
    """As the product asks, without the methods that the diagnosis does not begin at."""
    case = blind_case(seed, "polled")
    estimate = ExactMotionEstimator().estimate(case.recordings[0], case.nameplate)
    return diagnose(case.recordings, case.nameplate, estimate=estimate)


def test_a_polled_stop_is_named_though_the_short_fits_take_all_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    # the stop that this test was made for, counted from the end of what the force could sweep
    monkeypatch.setattr("tests.blind.cases.STOPS", ())
    found = product(7004)
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["travel_stop_low"]


def test_friction_that_grows_with_travel_is_not_named_before_friction_that_grows_with_pressure_was_fitted() -> None:
    """Far from the valve's own values the pressure promises a hundredth of what the travel does."""
    assert [one.cause for one in product(7313).causes] == ["pressure_dependent_friction"]


@pytest.mark.parametrize(("period_s", "left", "tried"), [(20.0e-3, 0.1, 1), (20.0e-3, 0.5, 2), (1.0e-3, 0.1, 2)])
def test_polled_rows_are_fitted_with_no_hard_cause_where_another_took_the_work_and_nearly_all(
    period_s: float, left: float, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = []
    samples = SimpleNamespace(period_s=period_s, time_s=np.array([0.0, 60.0]))
    observed = SimpleNamespace(motions=(SimpleNamespace(samples=samples),), count=1)
    model: Any = SimpleNamespace(tally=SimpleNamespace(work=1.0), observed=observed)
    best = Fit(model, np.zeros(1), np.array([10.0]), None, 100.0)

    def refit(fit: Fit, candidate: Candidate, *_rest: Any) -> Fit:
        names.append(candidate.cause.name)
        model.tally.work = 2.0
        return replace(fit, residual=np.array([np.sqrt(1.0 + 99.0 * left)]))

    monkeypatch.setattr(rounds, "may_ring", lambda _fit, _setting: False)
    monkeypatch.setattr(rounds, "refit", refit)
    monkeypatch.setattr(rounds, "refined", lambda fit: fit)
    monkeypatch.setattr(rounds, "is_settled", lambda _best, _fit: False)
    candidates = [Candidate(cause, ({},), 0.5) for cause in (LOCAL, STRIBECK)]
    rounds.refits(best, candidates, setting=SimpleNamespace(), most=9, last=1.5)  # type: ignore[arg-type]
    assert len(names) == tried
