"""A measured cylinder with an O-ring (tests/data/cylinder, CC0): its friction beside a ruler's."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimators.base import Estimator, Outcome, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.signature.measure import measure_signature
from estimators.steps.response import step_figures
from service.config.nameplates import read_nameplate
from valve.recording_files import read_recording

DATA = Path(__file__).parents[1] / "data" / "cylinder"
BOTH: list[Estimator] = [RegressionEstimator(), GarciaEstimator()]


@pytest.mark.parametrize("estimator", [*BOTH, MaximumLikelihoodEstimator()], ids=lambda one: one.method)
@pytest.mark.parametrize(
    ("file", "friction_n", "offset_n"), [("eva_O-ring_1bar.csv", 3.96, 0.76), ("eva_O-ring_7bar.csv", 7.9, None)]
)
def test_measured_friction_is_that_of_a_ruler(
    file: str, friction_n: float, offset_n: float | None, estimator: Estimator
) -> None:
    estimate = estimator.estimate(read_recording(DATA / file), read_nameplate(DATA / "cylinder.toml"))
    coulomb = estimate.parameters["F_c"]
    assert coulomb.value == pytest.approx(friction_n, rel=0.05)
    assert coulomb.ci95 is not None
    assert coulomb.ci95[0] <= friction_n <= coulomb.ci95[1]
    assert coulomb.scatter is not None
    # at one speed F_c holds what of it grows with speed, and nothing shows a breakaway
    assert estimate.status is Status.POOR
    assert str(Outcome.ONE_SPEED) in estimate.message
    if offset_n is not None:
        assert estimate.value("F_0") == pytest.approx(offset_n, abs=0.05)


@pytest.mark.parametrize("file", ["eva_O-ring_1bar.csv", "eva_O-ring_7bar.csv"])
def test_a_driven_rod_that_is_turned_back_is_no_step_test(file: str) -> None:
    nameplate = read_nameplate(DATA / "cylinder.toml")
    assert step_figures(read_recording(DATA / file), nameplate) is None


@pytest.mark.parametrize("file", ["eva_O-ring_1bar.csv", "eva_O-ring_7bar.csv"])
def test_the_signature_of_a_driven_rod_is_its_measured_friction(file: str) -> None:
    nameplate = read_nameplate(DATA / "cylinder.toml")
    recording = read_recording(DATA / file)
    estimates = [estimator.estimate(recording, nameplate) for estimator in BOTH]
    friction = measure_signature(recording, nameplate, estimates).figures["friction_mean_n"]
    assert friction.value == pytest.approx(3.96 if "1bar" in file else 7.9, rel=0.05)
