"""Every effect, at two strengths on two valves, against a plain integration of its equations by fixed steps."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pytest

from tests.support.extended_reference import integrate
from valve.effects import EFFECTS, ValveScale
from valve.extended_motion import simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.parameter_sets import parameter_set
from valve.stem import StemState

# Up, half down, a rest, up again: both directions, two breakaways after rests of different length.
COURSE_S: Final = np.array([0.0, 0.8, 1.3, 1.5, 2.0])
COURSE: Final = np.array([0.0, 1.0, 0.35, 0.35, 0.9])
STEP_S: Final = 5.0e-6
# Largest and root-mean-square difference, um; most of it is the reference's own, which shrinks with its step.
ALLOWED_UM: Final = {"vendor": (0.8, 0.3), "nominal": (9.0, 0.7)}
# The bristles' own inertia is not followed (a slip begins some 0.5 ms off); Stribeck's slip is the most bent of all.
WIDER_UM: Final = {
    ("presliding", "vendor", 1.0): (120.0, 15.0),
    ("presliding", "vendor", 3.0): (200.0, 30.0),
    ("presliding", "nominal", 1.0): (250.0, 25.0),
    ("presliding", "nominal", 3.0): (330.0, 35.0),
    ("stribeck_friction", "nominal", 1.0): (12.0, 1.2),
    ("stribeck_friction", "nominal", 3.0): (20.0, 2.0),
}
SHAPES: Final = {
    "friction_asymmetry": {"viscous_asymmetry": 0.2},
    "dwell_dependent_breakaway": {"time_s": 0.1},
    "local_friction": {"static_share": 0.4},
    "friction_gradient": {"static_share": 1.3, "bend_n_per_m2": 1.0e4},
    "friction_drift": {"static_share": 1.6, "time_constant_s": 3.0, "span_s": 2.0},
    "pressure_dependent_friction": {"static_share": 2.0},
    "spring_hardening": {"bend_n_per_m3": 1.0e6, "middle_m": 0.04},
    "position_nonlinearity": {"skew": 0.4, "ends": -0.3},
    "travel_stop_high": {"position_m": 0.05},
}


def pair(cause: str, name: str, strength: float) -> tuple[ExtendedValve, npt.NDArray[np.float64]]:
    chosen = parameter_set(name)
    area_m2, travel_m = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.actuator.travel_m
    assert area_m2 is not None
    full_force_n = area_m2 * 82737.0
    scale = ValveScale.of(chosen.parameters, travel_m, full_force_n)
    effect = EFFECTS[cause].of_strength(strength, scale, **SHAPES.get(cause, {}))
    return effect.apply(ExtendedValve(chosen.parameters)), full_force_n * COURSE


@pytest.mark.parametrize("strength", [1.0, 3.0])
@pytest.mark.parametrize("name", ["vendor", "nominal"])
@pytest.mark.parametrize("cause", EFFECTS)
def test_an_effect_moves_the_stem_as_its_equation_says(cause: str, name: str, strength: float) -> None:
    valve, force_n = pair(cause, name, strength)
    time_s = np.arange(2001) * 1.0e-3
    _position_m, expected_m = integrate(valve, COURSE_S, force_n, 2.0, 1.0e-3, STEP_S)
    initial = ExtendedState(StemState(max(valve.stops.low_m, 0.0)))
    motion = simulate_extended(valve, COURSE_S, force_n, time_s, initial=initial)
    difference_um = 1.0e6 * np.abs(motion.sensed_m - expected_m)
    largest_um, rms_um = WIDER_UM.get((cause, name, strength), ALLOWED_UM[name])
    assert difference_um.max() <= largest_um
    assert np.sqrt(np.mean(difference_um**2)) <= rms_um
    without = simulate_extended(ExtendedValve(parameter_set(name).parameters), COURSE_S, force_n, time_s)
    unlike_um = 1.0e6 * np.abs(without.sensed_m - expected_m)
    assert unlike_um.max() > 1.1 * largest_um, "the effect must be seen: the comparison would say nothing"
