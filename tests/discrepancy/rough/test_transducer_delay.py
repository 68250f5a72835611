"""An I/P that lags or delays by more than one in good order is named, with its time; less is a remark."""

from __future__ import annotations

from typing import Any

import pytest

from discrepancy.rough.causes.transducer_delay import beyond_limit, delays
from discrepancy.rough.diagnose import diagnose
from tests.support.rough_valves import case


@pytest.mark.parametrize("grade", ["ideal", "usual"])
@pytest.mark.parametrize(
    ("path", "lag_s", "dead_s"), [({"lag_s": 0.3}, 0.3, 0.0), ({"dead_time_s": 0.15}, 0.0, 0.15), ({}, 0.0, 0.0)]
)
def test_lag_and_dead_time_are_those_of_the_converter(
    path: dict[str, Any], lag_s: float, dead_s: float, grade: str
) -> None:
    found = delays(case("nominal", "triangle", grade, seed=3, path=path).recording)
    assert found is not None
    gauge_s = 0.0 if grade == "ideal" else 0.01
    assert found.lag.value == pytest.approx(lag_s, abs=0.004)
    assert found.dead_time.value == pytest.approx(dead_s, abs=0.004 + gauge_s)
    assert beyond_limit(found.lag) == (lag_s > 0.04)
    assert beyond_limit(found.dead_time) == (dead_s > 0.04)


def test_a_dead_time_that_ends_between_polled_rows_is_known() -> None:
    # a lag of a millisecond looked like it: it was known to 0.1 s, another one to 1.6 s, and neither was named
    made = case("small", "diagnostic", "usual", 0.02, 1, path={"dead_time_s": 0.256})
    found = delays(made.recording)
    assert found is not None
    assert found.dead_time.value == pytest.approx(0.256, abs=0.014)
    assert found.dead_time.std_error < 0.005


def test_a_slow_converter_is_named_and_nothing_else() -> None:
    one = case("nominal", "triangle", "usual", seed=3, path={"lag_s": 0.3})
    said = diagnose(one.recording, one.nameplate)
    assert [cause.cause for cause in said.causes] == ["transducer_lag"]
    low_s, high_s = said.causes[0].parameters["lag_s"].ci95
    assert low_s < 0.3 < high_s
