"""A force that shakes the stem keeps its own clock; slips, a bracket and a pressure that shakes do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.rough.causes.vibration import clock_of
from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.observations import as_measured
from discrepancy.rough.result import Verdict
from estimators.base import Outcome
from estimators.engine.engine import RoughFrictionEstimator
from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case as judged
from tests.support.rough_valves import VALVES, RoughCase, case
from valve.effects.stribeck_friction import StribeckFriction
from valve.effects.vibration import PeriodicForce


def shaken(valve: str, sequence: str, period_s: float, force_n: float, frequency_hz: float) -> RoughCase:
    return case(valve, sequence, "usual", period_s, 41, effects=[PeriodicForce(force_n, frequency_hz, 0.7)])


@pytest.mark.parametrize(
    ("valve", "sequence", "period_s", "force_n", "frequency_hz"),
    [
        ("graphite", "triangle", 1.0e-3, 90.0, 7.31),  # it slides on, now quicker and now slower
        ("large", "multi_rate", 0.02, 250.0, 13.27),  # it goes from peak to peak
        ("nominal", "diagnostic", 0.02, 60.0, 18.63),
    ],
)
def test_the_force_is_named_with_its_frequency_and_as_much_of_its_size_as_shows(
    valve: str, sequence: str, period_s: float, force_n: float, frequency_hz: float
) -> None:
    made = shaken(valve, sequence, period_s, force_n, frequency_hz)
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)
    found = diagnose(made.recording, made.nameplate, estimate)
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["vibration"]
    fitted = found.causes[0].parameters
    assert fitted["frequency_hz"].value == pytest.approx(frequency_hz, abs=5.0e-3)
    low_n, high_n = fitted["force_n"].ci95
    assert low_n <= force_n <= high_n
    assert "stop what shakes it" in found.not_looked_for  # what friction it has by itself does not show
    assert found.gain is None or not found.gain.is_far_worse


def test_a_healthy_stem_keeps_no_clock() -> None:
    for valve, sequence in (("graphite", "triangle"), ("large", "multi_rate"), ("nominal", "diagnostic")):
        made = case(valve, sequence, "usual", 0.02, 41)
        reading = as_measured(made.recording, made.nameplate)
        assert not isinstance(reading, Outcome)
        assert clock_of(reading) is None


def test_slips_that_repeat_with_the_test_are_no_clock() -> None:
    effect = StribeckFriction(4.0e-3, 0.3 * VALVES["large"][0].coulomb_friction_n)
    made = case("large", "triangle", "ideal", 1.0e-3, 7, effects=[effect])
    reading = as_measured(made.recording, made.nameplate)
    assert not isinstance(reading, Outcome)
    assert len(reading.segmentation.breakaways) > 50
    assert clock_of(reading) is None


@pytest.mark.parametrize("frequency_hz", [9.4, 50.0])
def test_what_a_reading_picks_up_shakes_no_stem(frequency_hz: float) -> None:
    made = case("large", "multi_rate", "usual", 1.0e-3, 41)
    tone_m = 1.0e-4 * np.sin(2.0 * np.pi * frequency_hz * made.recording.time_s)
    found = diagnose(replace(made.recording, position_m=made.recording.position_m + tone_m), made.nameplate)
    assert "vibration" not in [one.cause for one in found.causes]


@pytest.mark.parametrize(
    ("sequence", "force_n", "frequency_hz"), [("multi_rate", 150.0, 9.3), ("diagnostic", 60.0, 18.63)]
)
def test_a_pressure_that_shakes_is_none_of_the_stems_causes(sequence: str, force_n: float, frequency_hz: float) -> None:
    made = shaken("nominal", sequence, 0.02, force_n, frequency_hz)
    area_m2 = made.nameplate.actuator.diaphragm_area_m2
    assert made.recording.pressure_pa is not None
    assert area_m2 is not None
    tone_pa = force_n / area_m2 * np.sin(2.0 * np.pi * frequency_hz * made.recording.time_s + 0.7)
    shaking = replace(made.recording, pressure_pa=made.recording.pressure_pa + tone_pa)
    reading = as_measured(shaking, made.nameplate)
    assert not isinstance(reading, Outcome)
    assert clock_of(reading) is not None
    found = diagnose(shaking, made.nameplate)
    assert "vibration" not in [one.cause for one in found.causes]


@pytest.mark.long
@pytest.mark.parametrize(("seed", "size"), [(836, 0.0031014074339868664), (857, 0.05)])  # they were told as a play
def test_it_is_found_in_another_generators_valve(seed: int, size: float) -> None:
    analysis, _ = diagnosed(judged("hidden", seed, only="vibration", sizes=(size,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == ["vibration"]
