"""The first test of each published valve, measured well: what the service says of a valve that nobody has hurt."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers.addresses import MotionLimits
from service.analysis.analysis import analyze_recordings
from service.health.assess import assess
from service.health.changes import ValveFacts
from service.health.results import Case, Health
from service.model.health_figures import figures_of
from service.model.health_limits import HealthLimits
from service.model.past_test import Baseline, PastTest
from service.model.sequences import build_waveform
from valve.motion import simulate_waveform
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Acquisition, Provenance, Recording

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
SEED = 3
PERIOD_S, NOISE_M = 0.01, 2.0e-5


@cache
def _analysis(name: str) -> tuple[dict[str, Any], ValveFacts]:
    chosen = PARAMETER_SETS[name]
    actuator, signal = chosen.nameplate.actuator, chosen.nameplate.signal
    assert signal is not None
    assert actuator.diaphragm_area_m2 is not None
    span_pa = signal.range_pa[1] - signal.range_pa[0]
    limits = MotionLimits(signal.range_pa, pressure_rate_pa_per_s=span_pa, longest_test_s=300.0)
    waveform = build_waveform("multi_rate", {}, chosen.nameplate, limits)
    motion = simulate_waveform(chosen.parameters, waveform, actuator.diaphragm_area_m2, PERIOD_S)
    noise_m = NOISE_M * np.random.default_rng(SEED).standard_normal(motion.position_m.size)
    recording = Recording(
        motion.time_s,
        motion.position_m + noise_m,
        pressure_pa=waveform.at(motion.time_s),
        provenance=Provenance(Acquisition.SIMULATED),
    )
    return analyze_recordings([recording], chosen.nameplate), ValveFacts(actuator.travel_m, span_pa, span_pa)


def _judged(found: dict[str, Any], facts: ValveFacts, baseline: Baseline | None = None) -> Health:
    return assess(Case(found, NOW, facts, HealthLimits(), baseline))


@pytest.mark.parametrize(
    "name",
    [pytest.param("vendor", marks=pytest.mark.long), pytest.param("graphite", marks=pytest.mark.long)],
)
def test_a_valve_that_has_its_margin_is_normal_from_its_first_test(name: str) -> None:
    health = _judged(*_analysis(name))
    assert health.ne107 == "N", health.to_json()["reasons"]


@pytest.mark.parametrize(
    ("name", "open_mm", "reached", "dead_band"),
    [("nominal", "27", "74.6", "58.6"), pytest.param("rough", "42.6", "59", "92", marks=pytest.mark.long)],
)
def test_a_valve_that_its_friction_keeps_from_both_ends_has_failed_until_a_person_takes_it_as_it_is(
    name: str, open_mm: str, reached: str, dead_band: str
) -> None:
    found, facts = _analysis(name)
    first = _judged(found, facts)
    assert first.ne107 == "F"
    assert not first.is_accepted
    reasons = " ".join(first.to_json()["reasons"])
    assert f"At 0 % signal the stem stays {open_mm} mm open" in reasons
    assert f"At 100 % signal the stem reaches {reached} mm of 101.6 mm" in reasons
    assert f"Dead band is {dead_band} % of the signal, 30 % is allowed" in reasons
    assert "of the actuator's force, 15 % is allowed" in reasons
    unmet = tuple(one.name for one in first.checks if one.met is False)
    known = PastTest("first", NOW, figures_of(found), unmet=unmet)
    assert _judged(found, facts, Baseline(known)).ne107 == "F"
    assert _judged(found, facts, Baseline(known, "anna")).ne107 == "N"
