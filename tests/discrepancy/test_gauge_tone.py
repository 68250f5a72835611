"""A periodic force that undoes a tone of the measured pressure is the gauge's; any other is not."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from discrepancy.gauge_tone import gauge_tone
from discrepancy.least_squares import Fit
from discrepancy.model import Model
from discrepancy.unknowns import Unknown, Unknowns
from estimators.samples import FloatArray

AREA_M2 = 0.0323


def shaken(
    force_n: float, phase_rad: float, *, tone_n: float = 1.3, hz: float = 3.1, is_commanded: bool = False
) -> Fit:
    """A fit with a periodic force, on ramps whose force swings by ``tone_n`` sin(2 pi 3.1 t + 1)."""
    time_s: FloatArray = np.arange(0.0, 40.0, 1.0e-3)
    ramps_n = np.interp(time_s, [0.0, 10.0, 20.0, 30.0, 40.0], [0.0, 2000.0, 0.0, 2000.0, 0.0])
    pressed_n = ramps_n + tone_n * np.sin(2.0 * math.pi * 3.1 * (time_s + 0.7) + 1.0)
    # a segment that begins 0.7 s after its recording does
    segment = SimpleNamespace(time_s=time_s, elapsed_s=0.7, corner_s=time_s, corner_n=pressed_n)
    plate = SimpleNamespace(actuator=SimpleNamespace(diaphragm_area_m2=AREA_M2))
    observed: Any = SimpleNamespace(segments=(segment,), command_only=is_commanded, nameplate=plate)
    own = {"vibration.force_n": force_n, "vibration.frequency_hz": hz, "vibration.phase_rad": phase_rad}
    unknowns = Unknowns(tuple(Unknown(name, -100.0, 100.0, unit=1.0) for name in own))
    model = Model(observed, unknowns, ("vibration",))
    return Fit(model, unknowns.point(own), np.zeros(1), None, 0.0)


def test_a_force_that_undoes_the_pressures_tone_is_the_gauges() -> None:
    told = gauge_tone(shaken(1.28, 1.0 - math.pi + 0.02))
    assert f"swings by {1.3 / AREA_M2:.0f} Pa" in told
    assert "3.10 Hz" in told


@pytest.mark.parametrize(
    ("force_n", "phase_rad", "hz"),
    [(1.3, 1.0, 3.1), (1.3, 1.0 - 0.5 * math.pi, 3.1), (5.0, 1.0 - math.pi, 3.1), (1.3, 1.0 - math.pi, 7.0)],
)
def test_another_phase_size_or_frequency_shakes_the_stem(force_n: float, phase_rad: float, hz: float) -> None:
    assert gauge_tone(shaken(force_n, phase_rad, hz=hz)) == ""


def test_a_quiet_pressure_and_a_command_have_no_tone() -> None:
    assert gauge_tone(shaken(1.3, 1.0 - math.pi, tone_n=0.0)) == ""
    assert gauge_tone(shaken(1.3, 1.0 - math.pi, is_commanded=True)) == ""
