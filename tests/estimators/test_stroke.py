"""The stroke of a test: the same however the stem stood when the test began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.motion.stroke import stroke_m
from tests.support.nominal_recordings import NOMINAL, recorded, triangle_test
from valve.motion import StemState, simulate_waveform
from valve.recording import Recording
from valve.waveform import Waveform

FULL_PA = 82737.0
NOISE_M = 2.0e-6


def second_test(first: Recording) -> Recording:
    """The same test once more, from where the first one left the stem."""
    wave = np.array([0.0, 5.0, 10.0, 15.0, 20.0]), np.array([0.0, FULL_PA, 0.0, FULL_PA, 0.0])
    area_m2 = NOMINAL.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    motion = simulate_waveform(
        NOMINAL.parameters,
        Waveform("triangle", *wave),
        area_m2,
        0.001,
        initial=StemState(float(first.position_m[-1])),
    )
    return replace(first, position_m=motion.position_m)


def test_a_second_test_of_a_sticky_valve_has_the_stroke_of_the_first() -> None:
    first = triangle_test()
    second = second_test(first)
    assert np.ptp(first.position_m) - np.ptp(second.position_m) > 0.02  # the stem did not come back to its seat
    assert stroke_m(second) == pytest.approx(stroke_m(first), abs=1.0e-5)


def test_a_stem_that_goes_one_way_shows_all_its_way() -> None:
    one_way = recorded(Waveform("up", np.array([0.0, 10.0]), np.array([0.0, FULL_PA])), 0.01, NOISE_M)
    assert stroke_m(one_way) == (one_way.position_m.min(), one_way.position_m.max())


def test_gaps_in_pressure_and_position_are_no_stroke() -> None:
    whole = triangle_test(0.01)
    assert whole.pressure_pa is not None
    rows = np.arange(whole.samples)
    gaps = replace(
        whole,
        position_m=np.where(rows % 7 == 0, np.nan, whole.position_m),
        pressure_pa=np.where(rows % 5 == 0, np.nan, whole.pressure_pa),
    )
    assert stroke_m(gaps) == pytest.approx(stroke_m(whole), abs=5.0e-4)


def test_a_recording_without_a_position_has_no_stroke() -> None:
    nothing = replace(triangle_test(0.01), position_m=np.full(2001, np.nan))
    assert stroke_m(nothing) is None
