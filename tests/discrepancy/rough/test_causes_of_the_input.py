"""Dead bands and hysteresis of positioner and I/P, and breakaways that scatter, hidden in valves with usual packing."""

from __future__ import annotations

from typing import Any

import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis, Verdict
from tests.support.rough_valves import VALVES, case
from valve.effects.local_friction import LocalFriction


def _span_pa(valve: str) -> float:
    signal = VALVES[valve][1].signal
    assert signal is not None
    return signal.range_pa[1] - signal.range_pa[0]


def _found(valve: str, sequence: str, seed: int, **changes: Any) -> RoughDiagnosis:
    made = case(valve, sequence, "usual", seed=seed, **changes)
    return diagnose(made.recording, made.nameplate)


@pytest.mark.parametrize(
    ("valve", "sequence", "share"),
    [
        ("large", "multi_rate", 0.008),
        pytest.param("nominal", "multi_rate", 0.03, marks=pytest.mark.long),
        pytest.param("small", "triangle", 0.03, marks=pytest.mark.long),
    ],
)
def test_a_dead_band_is_named_with_its_width(valve: str, sequence: str, share: float) -> None:
    found = _found(valve, sequence, 41, path={"dead_band_pa": share * _span_pa(valve)})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["positioner_dead_band"]
    assert found.causes[0].parameters["dead_band_pa"].value == pytest.approx(share * _span_pa(valve), rel=0.12)
    assert found.causes[0].sentence.startswith("The pressure follows only when the command has turned back by")


@pytest.mark.parametrize(
    ("valve", "sequence", "share"), [("large", "multi_rate", 0.006), ("nominal", "triangle", 0.02)]
)
def test_a_hysteresis_loop_is_named_with_its_width(valve: str, sequence: str, share: float) -> None:
    found = _found(valve, sequence, 42, path={"hysteresis_pa": share * _span_pa(valve)})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["transducer_hysteresis"]
    assert found.causes[0].parameters["width_pa"].value == pytest.approx(share * _span_pa(valve), rel=0.08)


@pytest.mark.parametrize("scatter", [0.2, pytest.param(0.3, marks=pytest.mark.long)])
def test_breakaways_that_scatter_more_than_packings_do_are_named(scatter: float) -> None:
    found = _found("nominal", "multi_rate", 43, packing={"breakaway_scatter": scatter})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["breakaway_scatter"]
    # a breakaway never needs less than motion does
    assert 0.5 * scatter < found.causes[0].parameters["scatter"].value < 1.2 * scatter
    assert found.causes[0].sentence.endswith("packings do up to 8 %.")


def test_a_tight_spot_is_named_beside_a_dead_band() -> None:
    spot = LocalFriction(0.35 * 1120.0, 0.024, 0.0015)
    found = _found("large", "multi_rate", 44, path={"dead_band_pa": 0.02 * _span_pa("large")}, effects=[spot])
    assert {one.cause for one in found.causes} == {"local_friction", "positioner_dead_band"}


@pytest.mark.parametrize(
    ("path", "named"),
    [({}, []), ({"lag_s": 0.3}, ["transducer_lag"]), ({"dead_time_s": 0.2}, ["transducer_dead_time"]),
     ({"leak": 0.04}, ["actuator_leak"]),
     ({"supply_pa": 92.0e3}, ["supply_saturation"])],
)  # fmt: skip
def test_a_path_that_is_late_or_short_has_no_dead_band_and_no_loop(path: dict[str, float], named: list[str]) -> None:
    found = _found("large", "triangle", 45, path=path)
    assert [one.cause for one in found.causes] == named


def test_a_poor_packing_is_no_fault_of_the_breakaways() -> None:
    made = case("nominal", "multi_rate", "hard", seed=46)
    found = diagnose(made.recording, made.nameplate)
    assert "breakaway_scatter" not in [one.cause for one in found.causes]
