"""Short clean courses of a valve with and without an effect, for the tests of what is hidden."""

from __future__ import annotations

from functools import cache

import numpy as np

from tests.bench.blind.oddities import Steps
from tests.bench.blind.plant import Course, Plant, drawn_plant, followed
from tests.bench.blind.sequences import held
from tests.bench.blind.strengths import STRENGTHS, Swept
from valve.extended_valve import ExtendedValve
from valve.waveform import Waveform, dwell, triangle

QUICK = Steps(1.0e-5, 1.0e-3)
NOISE_M = 5.0e-6


def plant_of(name: str) -> Plant:
    return drawn_plant(name, np.random.default_rng(11))


def short_wave(plant: Plant, *, resting: bool = False) -> Waveform:
    wave = dwell(4.0, plant.low, plant.high, (1.5,)) if resting else triangle(5.0, 1, plant.low, plant.high)
    return held(wave, 0.1)


@cache
def healthy_course(name: str, *, resting: bool) -> Course:
    plant = plant_of(name)
    return followed(ExtendedValve(plant.parameters), short_wave(plant, resting=resting), plant.area_m2, QUICK)


def course_with(cause: str, name: str, factor: float) -> tuple[Course, Course, Swept, dict[str, float]]:
    """The clean course with this effect, the same valve's without, what is swept, and the effect's parameters."""
    plant, resting = plant_of(name), cause == "dwell_dependent_breakaway"
    wave = short_wave(plant, resting=resting)
    swept = plant.swept(wave)
    effect = STRENGTHS[cause].effect(factor * STRENGTHS[cause].smallest, swept, np.random.default_rng(3))
    course = followed(effect.apply(ExtendedValve(plant.parameters)), wave, plant.area_m2, QUICK)
    return course, healthy_course(name, resting=resting), swept, effect.values()
