"""A delay between the channels that the recording allows for: the intervals hold what it does to the slips' fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.estimators.recordings import paper_triangle, recorded
from valve.recording import Acquisition, Provenance

PERIOD_S = 5.0e-3
LATE_S = 25.0e-6
METHODS: list[type[ClassicEstimator]] = [RegressionEstimator, GarciaEstimator]


@pytest.mark.parametrize("method", METHODS)
def test_m_and_f_v_say_what_a_delay_does_where_the_limit_velocity_does_not_follow_it(
    method: type[ClassicEstimator],
) -> None:
    # with DV free in the whole motion a delay moves m a third as far: but the slips were fitted with DV where it was
    one = recorded("rough", noise_m=1.0e-6, period_s=PERIOD_S)
    recording = replace(
        one.recording,
        pressure_pa=paper_triangle("rough").at(one.recording.time_s - LATE_S),
        provenance=Provenance(Acquisition.POLLED, requested_period_s=PERIOD_S, timing_uncertainty_s=LATE_S),
    )
    estimate = method().estimate(recording, one.nameplate)
    assert estimate.value("DV") is None
    for symbol in ("m", "F_v"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None, symbol
        off = abs(entry.value - one.truth.by_symbol()[symbol]) / entry.std_error
        assert 0.5 < off < 1.8, symbol
