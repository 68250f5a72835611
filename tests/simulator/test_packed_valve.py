"""A software valve with a packing, real sensors and a hunting I/P: as it is read, and what it says of itself."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from simulator.faults import Fault, FaultKind
from simulator.plant import RECORD_PAUSE_S, RECORD_TAIL_S, SoftwareValve
from simulator.recorded import recorded
from simulator.samples import EndedRecord
from simulator.sensor import Sensor
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Hunting, Transducer
from tests.support.rough_valves import VALVES, case, rough_valve, sequence
from tests.support.simulated_plants import POSITION_SPAN_M, PRESSURE_SPAN_PA, RANGE_PA, valve
from valve.effects import EFFECTS, Effect, ValveScale
from valve.errors import ParameterError, WaveformError
from valve.packing import PACKINGS, Packing
from valve.recording import FloatArray
from valve.waveform import triangle

TRIANGLE = triangle(8.0, 1, *RANGE_PA)
EVERY_MS = np.arange(8001, dtype=np.float64) * 1.0e-3


def usual(**changes: Any) -> SimulatedValve:
    settings: dict[str, Any] = {"packing": PACKINGS["usual"], "packing_seed": 3, **changes}
    return valve(**settings)


def captured(settings: SimulatedValve, looks_s: list[float]) -> tuple[np.ndarray, EndedRecord]:
    """Sensed positions each ms of the triangle, looked at at these times as well, and the record's end."""
    ended: list[EndedRecord] = []
    software = SoftwareValve(settings)
    software.on_record = lambda _tag, record: ended.append(record)
    software.play(TRIANGLE.time_s, TRIANGLE.pressure_pa)
    found, taken = [], 0
    for edge_s in sorted({*looks_s, 8.0, 9.0}):
        until = int(np.searchsorted(EVERY_MS, edge_s, side="right"))
        samples = software.advance(edge_s, EVERY_MS[taken:until])
        taken = until
        if samples is not None:
            found.append(samples.sensed_m)
    assert len(ended) == 1
    return np.concatenate(found), ended[0]


def test_a_packed_valve_is_the_same_however_often_it_is_looked_at_and_tells_its_truth_at_the_records_end() -> None:
    settings = usual(
        position=Sensor(POSITION_SPAN_M, filter_s=0.005), transducer=Transducer(RANGE_PA, hunting=Hunting(200.0))
    )
    once, record = captured(settings, [])
    often, again = captured(settings, list(np.random.default_rng(4).uniform(0.0, 8.0, 40)))
    assert np.abs(often - once).max() < 2.0e-6
    assert (record.from_s, record.until_s) == (0.0, 8.0)
    assert again.truth.parameters.by_symbol() == pytest.approx(record.truth.parameters.by_symbol(), rel=1.0e-6)
    made = settings.parameters
    assert record.truth.parameters.coulomb_friction_n != made.coulomb_friction_n
    assert record.truth.parameters.coulomb_friction_n == pytest.approx(made.coulomb_friction_n, rel=0.05)
    assert np.abs(once - captured(valve(), [])[0]).max() > 1.0e-4


def test_a_valve_without_packing_and_filter_is_the_exact_one_and_says_what_it_was_made_with() -> None:
    found, record = captured(valve(packing=PACKINGS["ideal"]), [])
    assert np.array_equal(found, captured(valve(), [])[0])
    assert record.truth.parameters == valve().parameters
    assert record.truth.static_scatter_n == 0.0


def test_a_record_of_single_commands_ends_after_the_last_and_the_next_begins_after_a_pause() -> None:
    ended: list[EndedRecord] = []
    software = SoftwareValve(usual())
    software.on_record = lambda _tag, record: ended.append(record)
    for step in range(100):
        software.look(5.0 + 0.02 * step)
        software.ask(500.0 * step)
    software.look(8.0)
    assert [(record.from_s, record.until_s) for record in ended] == [(5.0, 5.0 + 0.02 * 99 + RECORD_TAIL_S)]
    software.ask(0.0)
    software.look(12.0)
    assert len(ended) == 1, "the way home is no record"
    software.look(12.0 + RECORD_PAUSE_S)
    software.ask(30_000.0)
    software.look(60.0)
    assert len(ended) == 2


def test_a_recording_made_without_a_wire_is_that_of_a_captured_test() -> None:
    settings = rough_valve("nominal", "usual", 2)
    wave = sequence("triangle", settings.nameplate)
    recording, truth = recorded(settings, wave, 2.0e-3)
    software = SoftwareValve(settings)
    software.look(1.0)
    software.play(wave.time_s, wave.pressure_pa)
    times_s = 1.0 + recording.time_s
    parts = [software.advance(30.0, times_s[times_s <= 30.0]), software.advance(62.0, times_s[times_s > 30.0])]
    shown_m = np.concatenate(
        [settings.position.readings(part.sensed_m, 0, part.sensed_at_s) for part in parts if part is not None]
    )
    noise_m = settings.position.noise_rms
    assert np.abs(shown_m - recording.position_m).max() < 8.0 * noise_m + 2.0 * settings.position.resolution
    assert truth.parameters.preload_n != 0.0
    again, _ = recorded(settings, wave, 2.0e-3)
    assert np.array_equal(again.position_m, recording.position_m)
    with pytest.raises(WaveformError, match="sample period"):
        recorded(settings, wave, 0.0)


def test_a_hunting_transducer_swings_the_true_pressure_and_not_the_command() -> None:
    hunting = Hunting(400.0, period_s=0.5, seed=6)
    times_s = np.arange(60_000, dtype=np.float64) * 1.0e-3
    added_pa = hunting.added_pa(times_s)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(added_pa))))
    assert turns.size == pytest.approx(2 * 60 / 0.5, abs=3)
    assert np.ptp(added_pa) == pytest.approx(400.0, rel=0.5)
    assert np.abs(np.diff(added_pa[turns + 1])).mean() == pytest.approx(400.0, rel=0.1)
    software = SoftwareValve(valve(transducer=Transducer(RANGE_PA, lag_s=0.1, hunting=hunting)))
    software.ask(40_000.0)
    samples = software.advance(20.0, np.arange(2000, 20_000, dtype=np.float64) * 1.0e-3)
    assert samples is not None
    assert np.ptp(samples.asked_pa) == 0.0
    expected_pa = hunting.added_pa(np.arange(2000, 20_000, dtype=np.float64) * 1.0e-3)
    assert np.abs(samples.pressure_pa - samples.asked_pa[0] - expected_pa).max() < 0.1
    assert software.pressure_pa == pytest.approx(40_000.0 + hunting.added_pa(np.array([20.0]))[0], abs=1.0)


def test_a_hunting_transducer_is_the_same_however_often_it_is_looked_at() -> None:
    settings = valve(transducer=Transducer(RANGE_PA, lag_s=0.05, hunting=Hunting(300.0)))
    once, often = SoftwareValve(settings), SoftwareValve(settings)
    once.ask(50_000.0)
    often.ask(50_000.0)
    for at_s in np.linspace(0.01, 9.0, 500):
        often.look(float(at_s))
    once.look(9.0)
    assert often.pressure_pa == pytest.approx(once.pressure_pa, abs=1.0e-3)
    assert often.stem.position_m == pytest.approx(once.stem.position_m, abs=1.0e-8)


def test_a_pressure_gauge_shows_the_pressure_behind_its_own_filter() -> None:
    gauge = Sensor(PRESSURE_SPAN_PA, adc_bits=24, filter_s=0.2)
    software = SoftwareValve(valve(pressure=gauge))
    software.look(1.0)
    software.ask(50_000.0)
    asked_pa = software.asked_pa
    for after_s in (0.05, 0.2, 0.7):
        software.look(1.0 + after_s)
        assert software.pressure_pa == asked_pa
        assert software.read_pressure_pa() == pytest.approx(asked_pa * (1.0 - math.exp(-after_s / 0.2)), abs=1.0)


def test_a_pressure_gauge_lags_a_ramp_by_its_filter() -> None:
    software = SoftwareValve(valve(pressure=Sensor(PRESSURE_SPAN_PA, adc_bits=24, filter_s=0.2)))
    software.play(TRIANGLE.time_s, TRIANGLE.pressure_pa)
    samples = software.advance(4.0, EVERY_MS[:4001])
    assert samples is not None
    slope = RANGE_PA[1] / 4.0
    expected_pa = slope * (EVERY_MS[:4001] - 0.2 * (1.0 - np.exp(-EVERY_MS[:4001] / 0.2)))
    assert np.abs(samples.gauge_pa - expected_pa).max() < 0.5
    assert np.abs(samples.pressure_pa - slope * EVERY_MS[:4001]).max() < 0.5


@pytest.mark.parametrize("changes", [{"delay_s": 0.03}, {"refresh_s": 0.1}, {"rate_ppm": 2000.0}])
def test_a_sensor_with_its_own_clock_shows_what_was_there_polled_and_captured(changes: dict[str, Any]) -> None:
    late = Sensor(POSITION_SPAN_M, adc_bits=24, **changes)
    exact = Sensor(POSITION_SPAN_M, adc_bits=24)
    software, prompt = SoftwareValve(valve(position=late)), SoftwareValve(valve(position=exact))
    for one in (software, prompt):
        one.look(0.5)
        one.play(TRIANGLE.time_s, TRIANGLE.pressure_pa)
    times_s = 0.5 + np.arange(1, 8001, dtype=np.float64) * 1.0e-3
    taken_s = late.taken_s(times_s, 0.5)
    true = prompt.advance(8.5, times_s)
    assert true is not None
    expected_m = np.interp(taken_s, times_s, true.position_m)
    polled_m = []
    for at_s in times_s[:4000:5]:
        software.look(float(at_s))
        polled_m.append(software.read_position_m())
    # what lies further back than the last look is straight between looks
    assert np.abs(np.array(polled_m) - expected_m[:4000:5]).max() < 3.0e-5
    samples = software.advance(8.5, times_s[3996:])
    assert samples is not None
    assert samples.sensed_at_s == pytest.approx(taken_s[3996:], abs=1.0e-9)
    assert np.abs(samples.sensed_m - expected_m[3996:]).max() < 3.0e-5
    assert np.abs(samples.sensed_m - samples.position_m).max() > 1.0e-4


def test_a_frozen_and_a_lost_sensor_stay_what_they_are_with_real_instruments() -> None:
    position = Sensor(POSITION_SPAN_M, 1.0e-5, filter_s=0.01, coloured_rms=1.0e-5, hum_rms=1.0e-5)
    settings = usual(position=position)
    settings = replace(
        settings, faults=(Fault(FaultKind.FROZEN_SENSOR, 3.0, 4.0), Fault(FaultKind.SENSOR_LOST, 5.0, 6.0))
    )
    software = SoftwareValve(settings)
    software.play(TRIANGLE.time_s, TRIANGLE.pressure_pa)
    software.look(3.1)
    shown_m = software.read_position_m()
    software.look(3.7)
    assert software.read_position_m() == shown_m
    software.look(5.5)
    assert math.isnan(software.read_position_m())
    software.look(7.0)
    assert software.read_position_m() == pytest.approx(software.stem.position_m, abs=1.0e-3)


def test_a_night_at_rest_costs_a_moment_and_the_wander_goes_on() -> None:
    software = SoftwareValve(usual(transducer=Transducer(RANGE_PA, hunting=Hunting(100.0))))
    software.ask(40_000.0)
    software.look(10.0)
    place_m = software.stem.position_m
    before_s = time.perf_counter()
    for at_s in np.arange(20.0, 3600.0, 2.0):
        software.look(float(at_s))
    assert time.perf_counter() - before_s < 20.0
    assert abs(software.stem.position_m - place_m) < 2.0e-3


# What each hides moves the stem, or what is read of it, in a rough valve as in an ideal one.
HIDDEN = {
    "friction_asymmetry": 2.0,
    "friction_gradient": 2.0,
    "local_friction": 4.0,
    "friction_drift": 3.0,
    "stribeck_friction": 2.0,
    "pressure_dependent_friction": 2.0,
    "presliding": 2.0,
    "spring_hardening": 1.0,
    "spring_preload": 1.0,
    "dual_rate_spring": 1.0,
    "diaphragm_area_change": 1.0,
    "flow_force": 1.0,
    "travel_stop_low": 3.0,
    "travel_stop_high": 8.0,
    "position_backlash": 1.0,
    "position_gain": 1.0,
    "position_nonlinearity": 1.0,
    "position_lag": 3.0,
    "transducer_lag": 1.0,
    "transducer_dead_time": 1.0,
    "supply_saturation": 2.5,
    "actuator_leak": 1.0,
}


def _shown_m(grade: str, *effects: Effect) -> FloatArray:
    # breakaways are alike, so that slips fall together: roughness, wander, filters and noise are those of usual
    alike: dict[str, Any] = {"packing": {"breakaway_scatter": 0.0}}
    return case("nominal", "triangle", grade, 2.0e-3, seed=4, effects=effects, **alike).recording.position_m


_bare_m = cache(_shown_m)


@pytest.mark.parametrize("cause", HIDDEN)
def test_an_effect_does_in_a_rough_valve_what_it_does_in_an_ideal_one(cause: str) -> None:
    parameters, nameplate = VALVES["nominal"]
    assert nameplate.actuator.diaphragm_area_m2 is not None
    scale = ValveScale.of(parameters, 0.1016, nameplate.actuator.diaphragm_area_m2 * RANGE_PA[1])
    effect = EFFECTS[cause].of_strength(HIDDEN[cause], scale)
    changes_m = ideal_m, rough_m = [_shown_m(grade, effect) - _bare_m(grade) for grade in ("ideal", "usual")]
    assert np.std(ideal_m) > 1.0e-4
    # a slip that comes a little later is not another effect: the rows inside slips do not count
    outside = np.all([np.abs(m) <= np.quantile(np.abs(m), 0.97) for m in changes_m], axis=0)
    assert np.corrcoef(ideal_m[outside], rough_m[outside])[0, 1] > 0.9
    assert np.median(np.abs(rough_m - ideal_m)) < 0.35 * np.std(ideal_m)


def test_a_case_has_all_that_a_finder_and_its_judge_need() -> None:
    found = case("small", "multi_rate", "usual", seed=5, effects=())
    assert found.recording.samples > 55_000
    assert found.recording.pressure_pa is not None
    assert found.recording.command_pa is not None
    assert found.nameplate == VALVES["small"][1]
    assert found.truth.breakaways_s.size > 25
    assert found.truth.parameters.coulomb_friction_n == pytest.approx(60.0, rel=0.06)
    polled = case("small", "multi_rate", "usual", 0.02, seed=5)
    assert polled.recording.sample_period_s == pytest.approx(0.02)
    assert polled.truth.parameters.by_symbol() == pytest.approx(found.truth.parameters.by_symbol(), rel=1.0e-4)
    other = case("small", "multi_rate", "usual", seed=6)
    assert other.truth.parameters.coulomb_friction_n != found.truth.parameters.coulomb_friction_n
    later = case("small", "multi_rate", "usual", seed=5, occasion=1)
    assert later.settings.packing_seed == found.settings.packing_seed
    # along the travel it is the same valve: without its wander F_0 is the same, and its breakaways are others
    assert later.truth.parameters.preload_n == pytest.approx(found.truth.parameters.preload_n, abs=0.05)
    assert later.truth.wander_n != found.truth.wander_n
    assert np.abs(later.truth.breakaways_n[:20] - found.truth.breakaways_n[:20]).max() > 0.5
    late = case("small", "triangle", "usual", 0.02, seed=5, jitter_s=0.01)
    assert 0.003 < np.std(np.diff(late.recording.time_s)) < 0.006
    with pytest.raises(WaveformError, match="jitter"):
        case("small", "triangle", "usual", 0.02, jitter_s=0.02)
    assert case("small", "sine").recording.duration_s == pytest.approx(32.0)
    rested = case("nominal", grade="ideal", packing={"first_rise": 0.3})
    assert rested.truth.breakaways_n[0] == pytest.approx(1.3 * 1708.1, rel=1.0e-3)
    with pytest.raises(KeyError, match="choose one"):
        case("nominal", "square")


def test_a_hunting_that_cannot_be_is_refused() -> None:
    with pytest.raises(ParameterError):
        Hunting(-1.0)
    with pytest.raises(ParameterError):
        Hunting(1.0, 0.0)
    with pytest.raises(ParameterError):
        Packing(wander=-1.0)
