"""What every registered estimator keeps, whatever it is given."""

from __future__ import annotations

import json
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from estimators.base import Estimate, Status
from estimators.registry import ESTIMATORS, estimate_all, estimator
from tests.support.published_recordings import SYMBOLS, VALVES, recorded
from valve.errors import NotFoundError
from valve.nameplate import Action, Actuator, Nameplate
from valve.recording import FloatArray, Recording

UNITS = {"m": "kg", "k": "N/m", "F_v": "N*s/m", "F_c": "N", "F_s": "N", "DV": "m/s", "F_0": "N"}
NAMEPLATES = [
    Nameplate("SPRING", Actuator(travel_m=0.1, diaphragm_area_m2=0.06)),
    Nameplate("DOUBLE", Actuator(travel_m=0.1, diaphragm_area_m2=0.06, action=Action.DOUBLE, moving_mass_kg=2.0)),
    Nameplate("NO-AREA", Actuator(travel_m=0.1)),
]


@cache
def _estimated(name: str, method: str) -> Estimate:
    """A first estimate, by an estimator of its own, of rows of 5 ms with a little noise."""
    test = recorded(name, period_s=5.0e-3, noise_m=2.0e-6)
    return estimator(method).estimate(test.recording, test.nameplate)


# The whole motion of these two is fitted for as long as that of all others together.
_LONG = {("graphite", "maximum_likelihood"), ("vendor", "maximum_likelihood")}


def require_contract(estimate: Estimate, method: str) -> None:
    """The shape of the analysis object, no NaN, and a reason for everything that is missing."""
    body: dict[str, Any] = json.loads(json.dumps(estimate.to_json(), allow_nan=False))
    assert list(body) == ["method", "status", "message", "residual_rms_m", "parameters"]
    assert body["method"] == method
    assert body["status"] in ("ok", "poor", "failed")
    assert body["status"] == "ok" or body["message"]
    assert body["residual_rms_m"] is None or body["residual_rms_m"] >= 0.0
    assert tuple(body["parameters"]) == SYMBOLS
    for symbol, parameter in body["parameters"].items():
        assert list(parameter) == ["value", "unit", "std_error", "ci95", "identifiable", "note", "scatter"]
        assert parameter["unit"] == UNITS[symbol]
        assert (parameter["value"] is not None) == parameter["identifiable"]
        assert parameter["scatter"] is None or parameter["scatter"] > 0.0
        if parameter["value"] is None:
            assert parameter["note"]
            assert parameter["scatter"] is None
            assert parameter["std_error"] is None
            assert parameter["ci95"] is None
        elif parameter["ci95"] is not None:
            low, high = parameter["ci95"]
            assert low <= parameter["value"] <= high


@pytest.mark.parametrize(
    ("name", "method"),
    [
        pytest.param(name, method, marks=pytest.mark.long if (name, method) in _LONG else ())
        for name in VALVES
        for method in ESTIMATORS
    ],
)
def test_an_estimate_has_the_shape_of_the_analysis_object(name: str, method: str) -> None:
    estimate = _estimated(name, method)
    require_contract(estimate, method)
    assert estimate.status is not Status.FAILED


@pytest.mark.parametrize("method", list(ESTIMATORS))
def test_an_estimate_does_not_depend_on_what_was_estimated_before(method: str) -> None:
    one, other = (recorded(name, period_s=5.0e-3, noise_m=2.0e-6) for name in ("nominal", "rough"))
    used = estimator(method)
    used.estimate(other.recording, other.nameplate)
    assert used.estimate(one.recording, one.nameplate).to_json() == _estimated("nominal", method).to_json()


@pytest.mark.parametrize("method", list(ESTIMATORS))
def test_the_origin_of_time_does_not_matter(method: str) -> None:
    test = recorded("nominal", period_s=5.0e-3, noise_m=1.0e-6)
    later = Recording(
        time_s=test.recording.time_s + 1000.0,
        position_m=test.recording.position_m,
        pressure_pa=test.recording.pressure_pa,
    )
    here = estimator(method).estimate(test.recording, test.nameplate)
    there = estimator(method).estimate(later, test.nameplate)
    for symbol in ("k", "F_c", "F_s", "F_0"):
        value = here.value(symbol)
        assert value is not None
        assert there.value(symbol) == pytest.approx(value, rel=1.0e-3), symbol


def test_estimate_all_gives_what_each_gives_alone() -> None:
    test = recorded("nominal", period_s=5.0e-3, noise_m=2.0e-6)
    together = estimate_all(test.recording, test.nameplate)
    assert [estimate.method for estimate in together] == list(ESTIMATORS)
    for estimate in together:
        assert estimate.to_json() == _estimated("nominal", estimate.method).to_json()


def test_an_unknown_estimator_is_named_with_those_that_there_are() -> None:
    with pytest.raises(NotFoundError, match=r"guess.*regression, garcia"):
        estimator("guess")


def channel(size: int, largest: float) -> st.SearchStrategy[Any]:
    """Anything that a recording accepts: plain numbers, steps, ramps and gaps."""
    finite = st.floats(-largest, largest, allow_nan=False, width=64)
    arbitrary = hnp.arrays(np.float64, size, elements=finite | st.just(math.nan))
    ramp = st.tuples(finite, finite).map(lambda ends: np.linspace(*ends, size))
    few = hnp.arrays(np.float64, size, elements=st.sampled_from([0.0, 1.0e-3, 0.05, largest]))
    wave = st.floats(0.1, 20.0).map(lambda cycles: 0.5 * largest * np.sin(cycles * np.linspace(0.0, 6.3, size)))
    return st.one_of(arbitrary, ramp, few, wave)


@st.composite
def odd_recordings(draw: st.DrawFn) -> Recording:
    """Short recordings that no valve made."""
    size = draw(st.integers(1, 300))
    step_s = draw(st.sampled_from([1.0e-9, 1.0e-3, 0.05, 1.0e4]))
    uneven = draw(st.booleans())
    steps_s: FloatArray = np.full(size, step_s)
    if uneven:
        steps_s = steps_s * draw(hnp.arrays(np.float64, size, elements=st.floats(0.1, 3.0)))
    largest = draw(st.sampled_from([1.0e-300, 1.0e-6, 0.1, 1.0e6, 1.0e300]))
    return Recording(
        time_s=np.asarray(np.cumsum(steps_s), dtype=np.float64),
        position_m=draw(channel(size, largest)),
        pressure_pa=draw(channel(size, draw(st.sampled_from([1.0e-300, 1.0, 1.0e5, 1.0e300])))),
    )


@pytest.mark.parametrize("method", list(ESTIMATORS))
@given(recording=odd_recordings(), nameplate=st.sampled_from(NAMEPLATES))
@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_odd_recordings_give_a_named_outcome_and_no_exception(
    method: str, recording: Recording, nameplate: Nameplate
) -> None:
    require_contract(estimator(method).estimate(recording, nameplate), method)


@pytest.mark.parametrize("method", list(ESTIMATORS))
@pytest.mark.parametrize("seed", range(5))
def test_random_walks_are_never_called_ok(method: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    count = 2000
    recording = Recording(
        time_s=np.arange(count, dtype=np.float64) * 1.0e-3,
        position_m=0.05 + np.cumsum(random.standard_normal(count)) * 1.0e-5,
        pressure_pa=40000.0 + np.cumsum(random.standard_normal(count)) * 100.0,
    )
    estimate = estimator(method).estimate(recording, NAMEPLATES[0])
    require_contract(estimate, method)
    assert estimate.status is not Status.OK
