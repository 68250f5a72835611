"""What every effect keeps, so that adding one needs no test of its own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from valve.effects import EFFECTS, ValveScale, effect_from_values, with_effects
from valve.errors import NotFoundError, ParameterError
from valve.extended_motion import ExtendedMotion, simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.parameter_sets import parameter_set
from valve.stem import StemState

NOMINAL = parameter_set("nominal").parameters
FULL_FORCE_N = 0.06452 * 82737.0
SCALE = ValveScale.of(NOMINAL, 0.1016, FULL_FORCE_N)
TIME_S = np.arange(401) * 5.0e-3
FORCE_N = FULL_FORCE_N * np.interp(TIME_S, [0.0, 0.8, 1.3, 1.5, 2.0], [0.0, 0.95, 0.35, 0.35, 0.9])


def moved(valve: ExtendedValve) -> ExtendedMotion:
    initial = ExtendedState(StemState(max(valve.stops.low_m, 0.0)))
    return simulate_extended(valve, TIME_S, FORCE_N, TIME_S, initial=initial)


def test_every_cause_of_the_catalogue_has_its_effect() -> None:
    assert set(EFFECTS) == {
        "friction_asymmetry", "stribeck_friction", "local_friction", "friction_gradient", "friction_drift",
        "pressure_dependent_friction", "dwell_dependent_breakaway", "presliding", "spring_preload", "spring_hardening",
        "dual_rate_spring", "diaphragm_area_change", "travel_stop_low", "travel_stop_high", "flow_force",
        "transducer_lag", "transducer_dead_time", "supply_saturation", "actuator_leak", "position_backlash",
        "position_gain", "position_nonlinearity", "position_lag", "vibration",
    }  # fmt: skip


@pytest.mark.parametrize("cause", EFFECTS)
def test_at_strength_0_nothing_changes(cause: str) -> None:
    effect = EFFECTS[cause].of_strength(0.0, SCALE)
    assert np.array_equal(moved(effect.apply(ExtendedValve(NOMINAL))).sensed_m, moved(ExtendedValve(NOMINAL)).sensed_m)


@pytest.mark.parametrize("cause", EFFECTS)
def test_it_says_what_it_is_with_a_physical_range(cause: str) -> None:
    kind = EFFECTS[cause]
    assert kind.cause == cause
    assert kind.__module__ == f"valve.effects.{cause}"
    assert kind.equation
    assert kind.source
    assert len({entry.symbol for entry in kind.parameters}) == len(kind.parameters)
    assert any(entry.is_strength for entry in kind.parameters)
    for entry in kind.parameters:
        low, high = entry.range(SCALE)
        assert low < high
        assert low <= entry.typical * SCALE.unit(entry.per) <= high
        assert math.isfinite(low)
        assert math.isfinite(high)
        assert entry.meaning
        assert entry.unit


@pytest.mark.parametrize("cause", EFFECTS)
def test_its_typical_strength_lies_in_its_range_and_moves_the_stem_otherwise(cause: str) -> None:
    effect = EFFECTS[cause].of_strength(1.0, SCALE)
    for entry in effect.parameters:
        low, high = entry.range(SCALE)
        assert low <= effect.values()[entry.name] <= high
    # this course does not reach the typical high stop
    seen = effect if cause != "travel_stop_high" else EFFECTS[cause].of_strength(8.0, SCALE)
    difference_m = np.abs(moved(seen.apply(ExtendedValve(NOMINAL))).sensed_m - moved(ExtendedValve(NOMINAL)).sensed_m)
    assert difference_m.max() > 5.0e-6


@pytest.mark.parametrize("cause", EFFECTS)
def test_it_is_made_from_its_values_and_refuses_what_it_does_not_know(cause: str) -> None:
    effect = EFFECTS[cause].of_strength(1.0, SCALE)
    assert effect_from_values(cause, effect.values()) == effect
    with pytest.raises(ParameterError, match=r"strenth: no such parameter; there are"):
        effect_from_values(cause, {**effect.values(), "strenth": 1.0})
    with pytest.raises(ParameterError, match=cause):
        effect_from_values(cause, dict.fromkeys(effect.values(), math.nan))
    with pytest.raises(ParameterError, match="missing"):
        effect_from_values(cause, {})


def test_an_unknown_cause_is_refused_with_those_there_are() -> None:
    with pytest.raises(NotFoundError, match="'bent_stem' is unknown: choose one of friction_asymmetry"):
        effect_from_values("bent_stem", {})


def test_effects_add_up_and_one_slot_is_filled_once() -> None:
    spot, drift = (EFFECTS[cause].of_strength(1.0, SCALE) for cause in ("local_friction", "friction_drift"))
    both = with_effects(ExtendedValve(NOMINAL), [spot, drift])
    assert both == with_effects(ExtendedValve(NOMINAL), [drift, spot])
    assert both.friction.spot_n == spot.values()["rise_n"]
    assert both.friction.drift_n == drift.values()["change_n"]
    with pytest.raises(ParameterError, match=r"local_friction: spot_n is .* already"):
        with_effects(ExtendedValve(NOMINAL), [spot, replace(spot)])
