"""The usual step test brackets resolution and dead band of each published valve, and times large steps both ways."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.addresses import MotionLimits
from estimators.steps.response import step_figures
from service.model.sequences import build_waveform
from tests.support.published_recordings import VALVES, Recorded, recorded
from valve.parameter_sets import parameter_set
from valve.waveform import Waveform

LONGEST_S = 300.0


def usual(name: str, longest_s: float = LONGEST_S) -> Waveform:
    plate = parameter_set(name).nameplate
    assert plate.signal is not None
    limits = MotionLimits(plate.signal.range_pa, 1.0e4, longest_s, steps_allowed=True)
    return build_waveform("steps", {}, plate, limits)


def figures(test: Recorded) -> dict[str, Any]:
    found = step_figures(test.recording, test.nameplate)
    assert found is not None
    return found


def true_percent(test: Recorded) -> dict[str, float]:
    """(F_s - A) and (F_s + A) in percent of span, A = F_c + F_v DV what a damped stem rests with."""
    truth, signal, area_m2 = test.truth, test.nameplate.signal, test.nameplate.actuator.diaphragm_area_m2
    assert signal is not None
    assert area_m2 is not None
    rest_n = truth.coulomb_friction_n + truth.viscous_friction_n_s_per_m * truth.limit_velocity_m_per_s
    span_n = area_m2 * (signal.range_pa[1] - signal.range_pa[0])
    return {
        "resolution_percent": max(0.0, 100.0 * (truth.static_friction_n - rest_n) / span_n),
        "dead_band_percent": 100.0 * (truth.static_friction_n + rest_n) / span_n,
    }


@pytest.mark.parametrize(("period_s", "noise_m"), [(0.002, 0.0), (0.01, 20.0e-6), (0.05, 100.0e-6)])
@pytest.mark.parametrize("name", VALVES)
def test_resolution_and_dead_band_are_bracketed(name: str, period_s: float, noise_m: float) -> None:
    test = recorded(name, period_s=period_s, noise_m=noise_m, waveform=usual(name))
    summary = figures(test)["summary"]
    for key, true in true_percent(test).items():
        low, high = summary[key]["ci95"]
        assert low <= true <= high, key
        # no bracket reaches much further than a third of what it is of, or than noise hides
        assert high - low <= 0.45 * true + 0.3 + noise_m / 2.5e-4, key


@pytest.mark.parametrize("name", VALVES)
def test_large_steps_are_timed_both_ways(name: str) -> None:
    test = recorded(name, period_s=0.002, waveform=usual(name))
    found = figures(test)
    largest = max(abs(one["change_percent"]) for one in found["each"])
    for way in (1.0, -1.0):
        timed = [one for one in found["each"] if way * one["change_percent"] >= 0.5 * largest]
        assert timed
        assert all(one["t63_s"] is not None and one["t86_s"] > one["t63_s"] and one["settled"] for one in timed)
    lag_s = test.truth.viscous_friction_n_s_per_m / test.truth.spring_rate_n_per_m
    assert found["summary"]["t63_s"] == pytest.approx(lag_s, rel=0.25, abs=0.003)
    assert found["summary"]["dead_time_s"] is None  # there is none: a bound is what is told
    assert 0.0 < found["summary"]["dead_time_below_s"] <= 0.011


def test_it_takes_two_and_a_half_minutes_at_most_and_keeps_within_less() -> None:
    assert usual("rough").duration_s <= 150.0
    assert usual("rough", longest_s=60.0).duration_s == pytest.approx(60.0)
    assert usual("graphite").range_pa == parameter_set("graphite").nameplate.signal.range_pa  # type: ignore[union-attr]


def test_its_levels_and_its_hold_can_be_chosen() -> None:
    plate = parameter_set("nominal").nameplate
    limits = MotionLimits((0.0, 82737.0), 1.0e4, LONGEST_S, steps_allowed=True)
    assert build_waveform("steps", {"hold_s": 2}, plate, limits).duration_s == pytest.approx(72.0)
    chosen = build_waveform("steps", {"levels_percent": [0, 50, 100]}, plate, limits)
    assert chosen.duration_s == pytest.approx(12.0)


def test_a_step_hidden_by_noise_is_not_said_to_have_moved_nothing() -> None:
    # the vendor's valve moves at every step; one of 0.1 mm is lost in this noise
    test = recorded("vendor", period_s=0.05, noise_m=100.0e-6, waveform=usual("vendor"))
    low, _ = figures(test)["summary"]["resolution_percent"]["ci95"]
    assert low < 0.1
