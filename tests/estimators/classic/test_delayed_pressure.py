"""A delay between the channels that the recording allows for: the intervals hold what it does to the slips' fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.base import Estimate
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.estimators.recordings import Recorded, paper_triangle, recorded
from valve.recording import Acquisition, Provenance

PERIOD_S = 5.0e-3
LATE_S = 25.0e-6
METHODS: list[type[ClassicEstimator]] = [RegressionEstimator, GarciaEstimator]


def delayed(valve: str, noise_m: float, late_s: float) -> Recorded:
    """The paper's triangle with a pressure that is read this late, as late as the recording says that it may be."""
    one = recorded(valve, noise_m=noise_m, period_s=PERIOD_S)
    recording = replace(
        one.recording,
        pressure_pa=paper_triangle(valve).at(one.recording.time_s - late_s),
        provenance=Provenance(Acquisition.POLLED, requested_period_s=PERIOD_S, timing_uncertainty_s=LATE_S),
    )
    return replace(one, recording=recording)


def errors_off(estimate: Estimate, one: Recorded, symbol: str) -> float:
    """How many of its own standard errors a value is off."""
    entry = estimate.parameters[symbol]
    assert entry.value is not None, symbol
    assert entry.std_error is not None, symbol
    return abs(entry.value - one.truth.by_symbol()[symbol]) / entry.std_error


@pytest.mark.parametrize("method", METHODS)
def test_m_and_f_v_say_what_a_delay_does_where_the_limit_velocity_does_not_follow_it(
    method: type[ClassicEstimator],
) -> None:
    # with DV free in the whole motion a delay moves m a third as far: but the slips were fitted with DV where it was
    one = delayed("rough", 1.0e-6, LATE_S)
    estimate = method().estimate(one.recording, one.nameplate)
    assert estimate.value("DV") is None
    for symbol in ("m", "F_v"):
        assert 0.5 < errors_off(estimate, one, symbol) < 1.8, symbol


def test_spring_and_preload_say_what_a_delay_does() -> None:
    one = delayed("nominal", 0.3e-6, -LATE_S)
    estimate = RegressionEstimator().estimate(one.recording, one.nameplate)
    for symbol in ("k", "F_0"):
        assert errors_off(estimate, one, symbol) < 1.8, symbol
