"""Maximum likelihood on measured records: EMPS, the electro-mechanical positioning benchmark (see test_emps.py)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from estimators.base import Estimate, Status
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import Recording

FOLDER = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "emps"
PUBLISHED = {"m": 95.1089, "F_v": 203.5034, "F_c": 20.3935, "F_0": -3.1648}

pytestmark = pytest.mark.skipif(not FOLDER.exists(), reason="the EMPS records are not beside the checkout")


def estimated(file: str) -> Estimate:
    data = {
        name: np.asarray(values, dtype=np.float64).ravel()
        for name, values in loadmat(FOLDER / file).items()
        if name[0] != "_"
    }
    recording = Recording(time_s=data["t"], position_m=data["qm"], force_n=data["gtau"][0] * data["vir"])
    nameplate = Nameplate("EMPS", Actuator(travel_m=0.25, action=Action.DOUBLE))
    return MaximumLikelihoodEstimator().estimate(recording, nameplate)


def test_the_published_values_come_out_within_half_a_percent() -> None:
    estimate = estimated("DATA_EMPS.mat")
    assert estimate.status is Status.OK
    for symbol, limit in {"m": 0.005, "F_v": 0.005, "F_c": 0.005, "F_0": 0.02}.items():
        parameter = estimate.parameters[symbol]
        assert parameter.value == pytest.approx(PUBLISHED[symbol], rel=limit), symbol
        assert parameter.ci95 is not None
        assert parameter.ci95[0] < PUBLISHED[symbol] < parameter.ci95[1], symbol
    assert estimate.value("F_s") is None
    assert "never rested" in estimate.parameters["F_s"].note


def test_the_record_with_pulses_agrees_within_its_flexibility() -> None:
    # the pulses excite a flexible screw (the authors' words), which no rigid mass follows: 4 % is what that costs
    estimate = estimated("DATA_EMPS_PULSES.mat")
    for symbol, published in PUBLISHED.items():
        assert estimate.value(symbol) == pytest.approx(published, rel=0.04), symbol
