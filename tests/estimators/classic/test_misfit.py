"""What an estimate's motion misses of the recorded one: followed once, by what judges the estimate where that does."""

from __future__ import annotations

import pytest

from estimators.base import Form
from estimators.classic import misfit
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.estimators.recordings import recorded
from valve.motion import Motion, simulate_motion

METHODS: list[type[ClassicEstimator]] = [RegressionEstimator, GarciaEstimator]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("form", "followed"), [(Form.ROBUST, 0), (Form.CORRECTED, 1)])
def test_an_estimate_that_the_whole_motion_judges_is_not_followed_once_more(
    method: type[ClassicEstimator], form: Form, followed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def counted(*arguments: object, **named: object) -> Motion:
        calls.append(arguments)
        return simulate_motion(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(misfit, "simulate_motion", counted)
    one = recorded("nominal", noise_m=20.0e-6, period_s=10.0e-3)
    estimate = method(form=form).estimate(one.recording, one.nameplate)
    assert len(calls) == followed
    assert estimate.residual_rms_m is not None
    assert estimate.residual_rms_m >= 19.0e-6
    assert form is Form.CORRECTED or estimate.residual_rms_m < 21.0e-6
    assert "stand_ins" in estimate.diagnostics
