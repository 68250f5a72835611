"""A measured drive: EMPS, the electro-mechanical positioning benchmark of Janot, Gautier and Brunot (2019).

Force is gtau times the controller's output in volts; there is no spring and no phase at rest. The authors publish
M 95.1089 kg, F_v 203.5034 N s/m, F_c 20.3935 N and an offset of -3.1648 N.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from estimators.base import Estimate, Estimator, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import Recording

DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "emps" / "DATA_EMPS.mat"
PUBLISHED = {"m": 95.1089, "F_v": 203.5034, "F_c": 20.3935, "F_0": -3.1648}

pytestmark = pytest.mark.skipif(not DATA.exists(), reason="the EMPS records are not beside the checkout")


def estimated(estimator: Estimator) -> Estimate:
    data = {
        name: np.asarray(values, dtype=np.float64).ravel() for name, values in loadmat(DATA).items() if name[0] != "_"
    }
    recording = Recording(time_s=data["t"], position_m=data["qm"], force_n=data["gtau"][0] * data["vir"])
    return estimator.estimate(recording, Nameplate("EMPS", Actuator(travel_m=0.25, action=Action.DOUBLE)))


def test_regression_comes_within_4_percent_of_the_published_values_and_within_its_interval() -> None:
    estimate = estimated(RegressionEstimator())
    assert estimate.status is not Status.FAILED
    assert estimate.value("k") == 0.0
    for symbol, published in PUBLISHED.items():
        parameter = estimate.parameters[symbol]
        assert parameter.value == pytest.approx(published, rel=0.04), symbol
        assert parameter.ci95 is not None
        assert parameter.ci95[0] < published < parameter.ci95[1], symbol


def test_force_balances_come_within_12_percent() -> None:
    estimate = estimated(GarciaEstimator())
    for symbol, published in PUBLISHED.items():
        assert estimate.value(symbol) == pytest.approx(published, rel=0.12), symbol
