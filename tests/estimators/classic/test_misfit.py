"""What an estimate's motion misses of the recorded one."""

from __future__ import annotations

import pytest

from estimators.base import Form
from estimators.classic import misfit
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.support.published_recordings import recorded
from valve.motion import Motion, simulate_motion

METHODS: list[type[ClassicEstimator]] = [RegressionEstimator, GarciaEstimator]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("form", [Form.ROBUST, Form.CORRECTED])
def test_an_estimates_motion_is_followed_once(
    method: type[ClassicEstimator], form: Form, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def counted(*arguments: object, **named: object) -> Motion:
        calls.append(arguments)
        return simulate_motion(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(misfit, "simulate_motion", counted)
    one = recorded("nominal", noise_m=20.0e-6, period_s=10.0e-3)
    estimate = method(form=form).estimate(one.recording, one.nameplate)
    assert len(calls) == 1
    assert estimate.residual_rms_m is not None
    assert estimate.residual_rms_m >= 19.0e-6
    assert form is Form.CORRECTED or estimate.residual_rms_m < 50.0e-6
    assert "stand_ins" in estimate.diagnostics
