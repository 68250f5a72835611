"""Each effect is in the recording, and as large as its strength says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import pytest

from tests.bench.blind.plant import Course, followed
from tests.bench.blind.short_courses import NOISE_M, QUICK, course_with, plant_of, short_wave
from tests.bench.blind.strengths import LARGEST, STRENGTHS, Swept
from valve.effects import EFFECTS
from valve.extended_motion import simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.recording import FloatArray
from valve.stem import StemState


def test_every_cause_of_the_catalogue_can_be_hidden() -> None:
    assert list(STRENGTHS) == list(EFFECTS)


def changed_m(cause: str, name: str, factor: float) -> float:
    course, healthy, _swept, _values = course_with(cause, name, factor)
    return float(np.sqrt(np.mean((course.sensed_m - healthy.sensed_m) ** 2)))


@pytest.mark.parametrize("cause", STRENGTHS)
def test_the_smallest_strength_is_seen_beyond_noise_and_a_large_one_more(cause: str) -> None:
    smallest_m, largest_m = changed_m(cause, "nominal", 1.0), changed_m(cause, "nominal", LARGEST)
    assert smallest_m > NOISE_M
    assert largest_m > 1.5 * smallest_m


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """A strength n in a valve of these sizes w with these parameters v, at travels x under forces F."""

    n: float
    w: Swept
    v: dict[str, float]
    x: FloatArray
    F: FloatArray

    @property
    def friction_n(self) -> float:
        return self.n * self.w.scale.friction_n

    @property
    def from_middle(self) -> FloatArray:
        return (self.x - 0.5 * (self.w.low_m + self.w.high_m)) / self.w.scale.travel_m


Shift = Callable[[Stated], FloatArray]
# How much more force the stem needs, N: either way, and for friction on the way up (as much less on the way down).
MIDDLE: Final[dict[str, Shift]] = {
    "friction_asymmetry": lambda s: s.friction_n * np.sign(s.v["asymmetry"]) * np.ones_like(s.x),
    "spring_preload": lambda s: s.n * s.w.scale.full_force_n * np.sign(s.v["offset_n"]) * np.ones_like(s.x),
    "spring_hardening": lambda s: s.n * s.w.scale.spring_rate_n_per_m * s.x**2 / s.w.scale.travel_m,
    "dual_rate_spring": lambda s: s.n * s.w.scale.spring_rate_n_per_m * np.maximum(s.x - s.v["knee_m"], 0.0),
    "diaphragm_area_change": lambda s: -s.n * np.sign(s.v["slope_per_m"]) * s.F * s.from_middle,
    "flow_force": lambda s: -s.n * s.w.scale.full_force_n * np.sign(s.v["force_n"]) * np.exp(-s.x / s.v["decay_m"]),
}
FRICTION: Final[dict[str, Shift]] = {
    "local_friction": lambda s: s.friction_n * np.exp(-0.5 * ((s.x - s.v["centre_m"]) / s.v["width_m"]) ** 2),
    "friction_gradient": lambda s: s.friction_n * np.sign(s.v["gradient_n_per_m"]) * s.from_middle,
    "pressure_dependent_friction": lambda s: s.friction_n * s.F / s.w.scale.full_force_n,
}


def force_over_travel(course: Course, viscous: float, position_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Actuator force less F_v v at these travels on the way up and on the way down, N."""
    top = int(np.argmax(course.sensed_m))
    force_n = course.force_at(course.time_s) - viscous * np.gradient(course.sensed_m, QUICK.output_s)
    up_n = np.interp(position_m, course.sensed_m[:top], force_n[:top])
    down_n = np.interp(position_m, course.sensed_m[:top:-1], force_n[:top:-1])
    return up_n, down_n


@pytest.mark.parametrize("cause", [*MIDDLE, *FRICTION])
def test_the_stem_needs_as_much_more_force_as_the_strength_says(cause: str) -> None:
    factor = 8.0
    course, healthy, swept, values = course_with(cause, "vendor", factor)
    at_m = swept.low_m + np.linspace(0.2, 0.8, 61) * swept.range_m
    viscous = plant_of("vendor").parameters.viscous_friction_n_s_per_m
    found = [force_over_travel(one, viscous, at_m) for one in (course, healthy)]
    ways = zip((1.0, -1.0), *found, strict=True)
    for way, force_n, healthy_n in ways:
        stated = Stated(factor * STRENGTHS[cause].smallest, swept, values, at_m, force_n)
        stated_n = MIDDLE[cause](stated) if cause in MIDDLE else way * FRICTION[cause](stated)
        assert np.abs(force_n - healthy_n - stated_n).max() < 0.2 + 0.02 * np.abs(stated_n).max()
        assert np.abs(stated_n).max() > 2.5, "it says something"


def test_ends_of_travel_are_where_the_strength_says() -> None:
    for cause in ("travel_stop_high", "supply_saturation"):
        course, _healthy, swept, _values = course_with(cause, "nominal", 5.0)
        end_m = swept.high_m - 5.0 * STRENGTHS[cause].smallest * swept.range_m
        assert course.sensed_m.max() == pytest.approx(end_m, abs=3.0e-4), cause
    course, _healthy, swept, _values = course_with("travel_stop_low", "nominal", 5.0)
    end_m = swept.low_m + 5.0 * STRENGTHS["travel_stop_low"].smallest * swept.range_m
    assert course.sensed_m[-1] == pytest.approx(end_m, abs=1.0e-6)


def test_channels_err_by_what_the_strength_says() -> None:
    course, healthy, swept, values = course_with("position_gain", "vendor", 4.0)
    assert abs(values["error"]) == pytest.approx(0.04)
    assert np.abs(course.sensed_m - (1.0 + values["error"]) * healthy.sensed_m).max() < 1.0e-9
    course, healthy, swept, _values = course_with("position_nonlinearity", "vendor", 4.0)
    assert np.abs(course.sensed_m - healthy.sensed_m).max() == pytest.approx(0.016 * swept.scale.travel_m, rel=1.0e-3)
    for cause, delay_s in (("position_lag", 4.0 * 0.013), ("transducer_dead_time", 4.0 * 0.03)):
        course, healthy, swept, _values = course_with(cause, "vendor", 4.0)
        rising = slice(1200, 2200)
        late_m = healthy.sensed_m[rising] - course.sensed_m[rising]
        speed_m_per_s = np.gradient(healthy.sensed_m, QUICK.output_s)[rising]
        assert np.mean(late_m) == pytest.approx(delay_s * np.mean(speed_m_per_s), rel=0.02), cause
    course, healthy, swept, _values = course_with("actuator_leak", "vendor", 4.0)
    at_s = healthy.time_s
    assert np.allclose(course.force_at(at_s), 0.98 * healthy.force_at(at_s), rtol=1.0e-6)


# The fitted model beside the fixed steps: what counts time, and the command's way to the actuator.
@pytest.mark.parametrize(
    "cause",
    [
        "friction_drift",
        "vibration",
        "transducer_lag",
        "transducer_dead_time",
        "supply_saturation",
        "actuator_leak",
        "position_lag",
        "local_friction",
        "stribeck_friction",
    ],
)
def test_with_the_truth_in_it_the_fitted_model_leaves_less_than_any_noise(cause: str) -> None:
    plant = plant_of("nominal")
    wave = short_wave(plant)
    effect = STRENGTHS[cause].effect(4.0 * STRENGTHS[cause].smallest, plant.swept(wave), np.random.default_rng(3))
    course = followed(effect.apply(ExtendedValve(plant.parameters)), wave, plant.area_m2, QUICK)
    asked_n = plant.area_m2 * wave.pressure_pa
    motion = simulate_extended(
        effect.apply(ExtendedValve(plant.parameters)),
        wave.time_s,
        asked_n,
        course.time_s,
        initial=ExtendedState(StemState(float(course.sensed_m[0]))),
    )
    difference_m = course.sensed_m - motion.sensed_m
    assert np.sqrt(np.mean(difference_m**2)) < 0.2 * NOISE_M
