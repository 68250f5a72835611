"""A software valve hides effects, and is the same valve however it is looked at."""

from __future__ import annotations

import numpy as np
import pytest

from simulator.faults import Fault, FaultKind
from simulator.plant import RECORD_PAUSE_S, SoftwareValve
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from tests.support.simulated_plants import POSITION_SPAN_M, RANGE_PA, valve
from valve.effects import EFFECTS, Effect, ValveScale, with_effects
from valve.errors import ParameterError
from valve.extended_motion import simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.motion import StemState
from valve.parameter_sets import parameter_set

NOMINAL = parameter_set("nominal").parameters
AREA_M2 = 0.06452
SCALE = ValveScale.of(NOMINAL, 0.1016, AREA_M2 * RANGE_PA[1])
COURSE_S = np.array([0.0, 0.8, 1.3, 1.5, 2.0])
COURSE_PA = RANGE_PA[1] * np.array([0.0, 1.0, 0.35, 0.35, 0.9])
EVERY_MS = np.arange(1, 2001, dtype=np.float64) * 1.0e-3
FINE = Transducer(RANGE_PA, dac_bits=32)


def effect(cause: str, strength: float = 2.0, **shape: float) -> Effect:
    return EFFECTS[cause].of_strength(strength, SCALE, **shape)


def hiding(*effects: Effect) -> SimulatedValve:
    return valve(effects=effects, transducer=FINE, position=Sensor(POSITION_SPAN_M, adc_bits=24))


def captured(settings: SimulatedValve, looks_s: list[float], start_s: float = 0.0) -> np.ndarray:
    """Sensed positions each ms of the course, the valve being looked at at these times as well."""
    software = SoftwareValve(settings, start_s)
    software.play(COURSE_S, COURSE_PA)
    found, edges_s = [], sorted({*looks_s, 2.0})
    taken = 0
    for edge_s in edges_s:
        until = int(np.searchsorted(EVERY_MS, edge_s, side="right"))
        samples = software.advance(start_s + edge_s, start_s + EVERY_MS[taken:until])
        taken = until
        if samples is not None:
            found.append(samples.sensed_m)
    return np.concatenate(found)


@pytest.mark.parametrize("cause", EFFECTS)
def test_an_effect_is_hidden_as_it_is_simulated_however_often_somebody_looks(cause: str) -> None:
    hidden = effect(cause)
    extended = with_effects(ExtendedValve(NOMINAL), [hidden])
    initial = ExtendedState(StemState(max(extended.stops.low_m, 0.0)))
    times_s = np.concatenate(([0.0], EVERY_MS))
    expected = simulate_extended(extended, COURSE_S, AREA_M2 * COURSE_PA, times_s, initial=initial).sensed_m[1:]
    once = captured(hiding(hidden), [])
    assert np.abs(once - expected).max() < 1.0e-6
    looks_s = list(np.random.default_rng(4).uniform(0.0, 2.0, 25))
    often = captured(hiding(hidden), looks_s)
    # a breakaway of bristles moves by a part of its sub-step with where the steps fall
    assert np.abs(often - once).max() < (2.0e-5 if cause == "presliding" else 5.0e-6)
    if cause != "travel_stop_high":
        assert np.abs(once - captured(hiding(), [])).max() > 2.0e-5


def test_several_effects_add_up() -> None:
    spot, gain = effect("local_friction"), effect("position_gain")
    both = captured(hiding(spot, gain), [])
    assert both == pytest.approx(1.04 * captured(hiding(spot), []), abs=1.0e-12)


def test_a_valve_without_effects_is_the_exact_one() -> None:
    bare = captured(hiding(), [])
    filled = captured(hiding(effect("local_friction", 0.0)), [])
    assert np.abs(bare - filled).max() < 1.0e-12


def test_a_record_begins_with_a_waveform_and_with_a_command_after_a_pause() -> None:
    settings = hiding(effect("friction_drift", 3.0, time_constant_s=5.0))
    first = captured(settings, [])
    software = SoftwareValve(settings)
    software.advance(500.0)
    software.play(COURSE_S, COURSE_PA)
    samples = software.advance(502.0, 500.0 + EVERY_MS)
    assert samples is not None
    assert np.abs(samples.sensed_m - first).max() < 1.0e-9, "what drifts has recovered before the next test"

    def moved_m(pause_s: float) -> float:
        polled = SoftwareValve(settings)
        polled.ask(10_000.0)
        polled.look(pause_s)
        polled.ask(60_000.0)
        polled.look(pause_s + 1.0)
        return polled.stem.position_m

    assert moved_m(RECORD_PAUSE_S - 1.0) > moved_m(RECORD_PAUSE_S) + 5.0e-4


def test_a_jammed_stem_stays_while_its_sensor_settles() -> None:
    settings = hiding(effect("position_lag", lag_s=0.2))
    software = SoftwareValve(settings)
    software.inject(Fault(FaultKind.STUCK_STEM, 0.7))
    software.play(COURSE_S, COURSE_PA)
    software.look(0.7)
    jammed_m = software.stem.position_m
    assert software.read_position_m() < jammed_m - 1.0e-3
    software.look(1.9)
    assert software.stem.position_m == jammed_m
    assert software.read_position_m() == pytest.approx(jammed_m, rel=0.003)


def test_a_frozen_sensor_shows_what_it_showed() -> None:
    settings = hiding(effect("position_gain", 5.0))
    software = SoftwareValve(settings)
    software.inject(Fault(FaultKind.FROZEN_SENSOR, 0.7))
    software.play(COURSE_S, COURSE_PA)
    software.look(0.7)
    shown_m = software.read_position_m()
    assert shown_m == pytest.approx(1.1 * software.stem.position_m, abs=1.0e-7)
    software.look(1.2)
    assert software.stem.position_m != pytest.approx(shown_m / 1.1, abs=1.0e-3)
    assert software.read_position_m() == pytest.approx(shown_m, abs=1.0e-7)


def test_ten_minutes_of_shaking_while_nobody_looks_are_followed() -> None:
    software = SoftwareValve(hiding(effect("vibration", 20.0, frequency_hz=8.0)))
    software.ask(60_000.0)
    software.advance(600.0)
    assert software.stem.position_m > 0.02


def test_a_leak_lowers_the_pressure_that_everybody_sees() -> None:
    software = SoftwareValve(hiding(effect("actuator_leak", leak=0.1)))
    software.ask(50_000.0)
    software.look(2.0)
    assert software.asked_pa == pytest.approx(50_000.0, abs=0.01)
    assert software.pressure_pa == pytest.approx(45_000.0, abs=0.01)


def test_a_lag_beside_the_transducers_own_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"lag_s is 0\.5 s already and transducer_lag gives 0\.6 s"):
        valve(effects=(effect("transducer_lag"),), transducer=Transducer(RANGE_PA, lag_s=0.5))
