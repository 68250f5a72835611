"""The I/P's dead band and hysteresis loop against what their equation says, and piece by piece as in one go."""

from __future__ import annotations

import numpy as np
import pytest

from simulator.loop import Loop, LoopState
from simulator.transducer import Transducer
from tests.simulator.test_transducer import pressures
from valve.errors import ParameterError

SPAN_PA = 80.0e3
UP_AND_DOWN_S = np.array([0.0, 10.0, 20.0])
UP_AND_DOWN_PA = np.array([0.0, SPAN_PA, 0.0])


def both_ways(loop: Loop, command_pa: float) -> tuple[float, float]:
    """Output at this command on the way up and on the way down, Pa."""
    time_s, output_pa = LoopState(loop, 0.0).follow(UP_AND_DOWN_S, UP_AND_DOWN_PA)
    rising_s = 10.0 * command_pa / SPAN_PA
    rising, falling = np.interp([rising_s, 20.0 - rising_s], time_s, output_pa)
    return float(rising), float(falling)


def test_behind_a_dead_band_the_output_stands_until_the_command_has_turned_back_by_it() -> None:
    loop = Loop(2.0e3, 0.0, SPAN_PA)
    rising_pa, falling_pa = both_ways(loop, 40.0e3)
    assert rising_pa == pytest.approx(39.0e3)
    assert falling_pa == pytest.approx(41.0e3)
    assert both_ways(loop, 78.5e3)[1] == pytest.approx(79.0e3)


def test_a_hysteresis_loop_is_as_wide_as_it_says_in_its_middle_and_closed_at_its_ends() -> None:
    loop = Loop(0.0, 1.6e3, SPAN_PA)
    rising_pa, falling_pa = both_ways(loop, 40.0e3)
    assert falling_pa - rising_pa == pytest.approx(1.6e3, rel=0.01)
    time_s, output_pa = LoopState(loop, 0.0).follow(UP_AND_DOWN_S, UP_AND_DOWN_PA)
    assert np.interp(UP_AND_DOWN_S, time_s, output_pa) == pytest.approx(UP_AND_DOWN_PA, abs=1.0)
    assert both_ways(loop, 78.0e3)[1] < 78.4e3


def test_a_loop_that_is_not_there_changes_nothing() -> None:
    time_s, output_pa = LoopState(Loop(0.0, 0.0, SPAN_PA), 0.0).follow(UP_AND_DOWN_S, UP_AND_DOWN_PA)
    assert time_s is UP_AND_DOWN_S
    assert output_pa is UP_AND_DOWN_PA


def test_it_is_followed_alike_however_often_somebody_looks() -> None:
    settings = Transducer((0.0, SPAN_PA), dac_bits=24, dead_band_pa=1.0e3, hysteresis_pa=2.0e3, lag_s=0.1)
    asked = [(1.0, 40.0e3), (3.0, 20.0e3), (5.0, 20.4e3)]
    ends_s = [2.9, 4.9, 6.9]
    looks_s = sorted([*np.linspace(1.05, 6.8, 40), *ends_s])
    often = dict(zip(looks_s, pressures(settings, asked, looks_s), strict=True))
    assert pressures(settings, asked, ends_s) == pytest.approx([often[at_s] for at_s in ends_s], abs=0.1)
    once = dict(zip(ends_s, pressures(settings, asked, ends_s), strict=True))
    assert once[4.9] == pytest.approx(once[6.9], abs=0.3e3)


def test_a_loop_that_would_fall_where_the_command_rises_is_refused() -> None:
    with pytest.raises(ParameterError, match="hysteresis_pa is 20000 Pa, give 0 to 10000 Pa"):
        Transducer((0.0, SPAN_PA), hysteresis_pa=20.0e3)
