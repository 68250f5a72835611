"""The hyperparameters of friction that varies are found from fields that are seen with noise."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.engine.fields import Fields, fields_on
from estimators.engine.hyperparameters import FieldLikelihood, refined, spread, surprise
from estimators.engine.roughness import ROUGH, SMOOTH, Roughness, roughness_prior

_TRUE = Roughness(10.0, 14.0, 0.003, 5.0, 20.0, 1.0e-6)
_TRAVEL_M, _FRICTION_N = 0.1, 1000.0


def _seen(noise_n: float) -> tuple[Fields, FieldLikelihood]:
    """Fields drawn with the true sizes and seen with this noise; a function is the mean of the opening one."""
    travel_m, time_s = np.linspace(0.0, _TRAVEL_M, 101), np.linspace(0.0, 60.0, 61)
    fields = fields_on(travel_m, time_s, _TRUE, ROUGH)
    random = np.random.default_rng(5)
    drawn = np.linalg.cholesky(np.linalg.inv(fields.precision)) @ random.standard_normal(fields.count)
    seen_n = drawn + noise_n * random.standard_normal(fields.count)
    mean = np.zeros((1, fields.count))
    mean[0, :101] = 1.0 / 101
    information = np.eye(fields.count) / noise_n**2
    return fields, FieldLikelihood(information, seen_n / noise_n**2, mean, np.zeros(1))


@pytest.mark.parametrize("smoothness", [ROUGH, SMOOTH])
def test_the_slope_is_that_of_the_marginal_likelihood(smoothness: int) -> None:
    fields, likelihood = _seen(0.5)
    at = _TRUE.logarithms()[:5] + np.array([0.2, -0.1, 0.1, 0.3, -0.2])
    _, slope = surprise(fields, likelihood, at, smoothness)
    for number, unit in enumerate(1.0e-4 * np.eye(5)):
        sides = [surprise(fields, likelihood, at + sign * unit, smoothness)[0] for sign in (1.0, -1.0)]
        assert slope[number] == pytest.approx((sides[0] - sides[1]) / 2.0e-4, rel=2.0e-3, abs=1.0e-2)


def test_roughness_is_found_from_a_start_with_other_sizes_and_the_wrong_smoothness() -> None:
    fields, likelihood = _seen(0.5)
    wrong = Roughness(3.0, 4.0, 0.0015, 15.0, 5.0, 1.0e-6)
    start = fields_on(fields.travel_m, fields.time_s, wrong, SMOOTH)
    found = refined(start, likelihood, roughness_prior(_FRICTION_N, _TRAVEL_M))

    assert found.smoothness == ROUGH
    assert found.roughness is not None
    assert found.roughness.common_n == pytest.approx(_TRUE.common_n, rel=0.5)
    assert found.roughness.own_n == pytest.approx(_TRUE.own_n, rel=0.3)
    assert found.roughness.length_m == pytest.approx(_TRUE.length_m, rel=0.3)
    assert found.roughness.wander_n == pytest.approx(_TRUE.wander_n, rel=0.6)


def test_unknown_roughness_widens_what_is_hardly_seen() -> None:
    fields, likelihood = _seen(30.0)
    prior = roughness_prior(_FRICTION_N, _TRAVEL_M)
    found = refined(fields, likelihood, prior)
    given = np.linalg.inv(likelihood.information + found.precision)
    alone = float((likelihood.of_fields @ given @ likelihood.of_fields.T)[0, 0])
    wider = spread(found, likelihood, prior)

    assert wider is not None
    assert alone < wider[1][0] < 4.0 * alone


def test_a_recording_that_tells_nothing_of_the_fields_has_no_spread() -> None:
    fields, likelihood = _seen(0.5)
    # rounding has taken more from the information than there was
    information = -1.0e9 * np.max(np.diag(fields.precision)) * np.eye(fields.count)
    nothing = FieldLikelihood(information, likelihood.pull, likelihood.of_fields, likelihood.others)

    assert spread(fields, nothing, roughness_prior(_FRICTION_N, _TRAVEL_M)) is None
