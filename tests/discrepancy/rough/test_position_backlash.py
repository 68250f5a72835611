"""A play between stem and sensor, also where the stem crosses it slowly."""

from __future__ import annotations

import numpy as np
import pytest

from discrepancy.rough.causes.position_backlash import PositionBacklash
from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.setting import Setting
from estimators.engine.laws import Where
from tests.support.rough_valves import VALVES, case
from valve.effects.position_backlash import PositionBacklash as PlayEffect


def test_a_play_that_a_damped_stem_crosses_slowly_is_named() -> None:
    play_m = 0.03 * VALVES["graphite"][1].actuator.travel_m
    made = case("graphite", "diagnostic", "ideal", seed=81, effects=[PlayEffect(play_m)])
    found = diagnose(made.recording, made.nameplate)
    assert [one.cause for one in found.causes] == ["position_backlash"]
    # at its limit velocity the stem also rests within the play, which the law does not say
    assert found.causes[0].parameters["play_m"].value == pytest.approx(play_m, rel=0.4)


def test_the_force_goes_on_while_a_damped_stem_crosses_the_play() -> None:
    rate = np.array([300.0, 3000.0])
    spring, late_s, jump_n, play_m = 2.0e5, 0.3, 250.0, 5.0e-4
    setting = Setting(0.03, 0.0, 0.03, 60.0, 1.0e-3, spring, 1000.0, 1250.0, 0.0, 1.0e4, None, late_s=late_s)
    cause = PositionBacklash(setting)
    nothing, one = np.zeros(2), np.ones(2)
    turns = Where(nothing, nothing, nothing, nothing, rate, one, one, -one)
    half_n = 0.5 * spring * play_m
    share = 1.0 + jump_n / (setting.friction_n - half_n)
    found_n = cause.breakaway_n(np.array([play_m]), turns, share)
    # x' = (J + r t - k x) / (k T), by small steps
    for expected_n, speed in zip(found_n, rate, strict=True):
        place_m, time_s, step_s = 0.0, 0.0, 1.0e-5
        while place_m < play_m:
            place_m += step_s * (jump_n + speed * time_s - spring * place_m) / (spring * late_s)
            time_s += step_s
        assert expected_n == pytest.approx(speed * time_s - half_n, abs=0.5)
    onward = Where(nothing, nothing, nothing, nothing, rate, one, one, one)
    assert cause.breakaway_n(np.array([play_m]), onward, share) == pytest.approx(half_n)
