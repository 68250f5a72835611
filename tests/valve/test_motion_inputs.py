"""What the motion is given: sound inputs, recordings and batches, and each refusal in one sentence."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valve.errors import MotionError, ParameterError, RecordingError, WaveformError
from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.kernel.follow import follow
from valve.kernel.follow_extended import follow_extended
from valve.motion import (
    Mode,
    StemIntegrator,
    StemState,
    simulate_batch,
    simulate_motion,
    simulate_recording,
    simulate_waveform,
)
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops
from valve.recording import Recording
from valve.waveform import steps, triangle

NOMINAL = parameter_set("nominal")
P = NOMINAL.parameters
AREA_M2 = 0.06452


@pytest.mark.parametrize(
    ("force_time_s", "force_n", "output_time_s", "words"),
    [
        ([0.0, 1.0], [0.0], [0.0], "2 times and 1 values"),
        ([], [], [0.0], "at least 1"),
        ([0.0, 2.0, 1.0], [0.0, 0.0, 0.0], [0.0], "corner 3 is 1 s"),
        ([0.0, math.nan], [0.0, 0.0], [0.0], "corner 2"),
        ([0.0, 1.0], [0.0, math.inf], [0.0], "corner 2 is inf N"),
        ([0.0, 1.0], [0.0, 1.0], [0.0, 0.5, 0.4], "number 3 is 0.4 s"),
        ([1.0, 2.0], [0.0, 1.0], [0.5, 2.0], "begin at 0.5 s and the force at 1 s"),
        ([0.0, 1.0], [0.0, 1.0], [[0.0]], "2 dimensions"),
    ],
)
def test_malformed_arrays_are_refused_with_their_place(
    force_time_s: list[float], force_n: list[float], output_time_s: list[float], words: str
) -> None:
    with pytest.raises(WaveformError, match=words):
        simulate_motion(P, force_time_s, force_n, output_time_s)


def test_a_start_beyond_a_stop_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"0\.2 m lies outside the travel stops of 0 to 0\.1 m"):
        simulate_motion(P, [0.0], [0.0], [0.0], stops=TravelStops(0.0, 0.1), initial=StemState(0.2))


@pytest.mark.parametrize("state", [(math.nan, 0.0), (0.0, math.inf)])
def test_a_state_that_is_not_finite_is_refused(state: tuple[float, float]) -> None:
    with pytest.raises(ParameterError, match="finite"):
        StemState(*state)


@pytest.mark.parametrize("period_s", [0.0, -1.0, math.nan, math.inf])
def test_a_sample_period_must_be_above_zero(period_s: float) -> None:
    with pytest.raises(WaveformError, match="sample period"):
        simulate_waveform(P, triangle(1.0, 1, 0.0, 1.0), AREA_M2, period_s)


def test_integers_and_lists_do_as_well_as_floats_and_arrays() -> None:
    simulate_motion(P, [0.0], [0.0], [0.0])
    compiled = len(follow.signatures)
    whole = simulate_motion(P, [0, 1, 2], [0, 4000, 0], [0, 1, 2], initial=StemState(0, 0))
    same = simulate_motion(P, np.array([0.0, 1.0, 2.0]), np.array([0.0, 4000.0, 0.0]), np.array([0.0, 1.0, 2.0]))
    assert np.array_equal(whole.position_m, same.position_m)
    assert StemIntegrator(P).ramp(StemState(0, 0), 1, 0, 4000) == simulate_motion(P, [0, 1], [0, 4000], [1]).final_state
    simulate_batch([P], [0, 1], [0, 4000], [0, 1], initial=[StemState(0, 0)])
    assert len(follow.signatures) == compiled, "another compilation costs seconds"


def test_columns_of_a_table_run_the_kernel_that_is_there() -> None:
    # the first diagnosis of a measured record compiled the largest kernel again, for a view of its rows
    stem, table = ExtendedStem(ExtendedValve(P)), np.array([[0.0, 0.0], [1.0, 4000.0], [2.0, 0.0]])
    time_s, force_n = table.T.copy()
    whole = stem.motion(ExtendedState(), time_s, force_n, time_s)
    compiled = len(follow_extended.signatures)
    same = stem.motion(ExtendedState(), table[:, 0], table[:, 1], table[:, 0])
    assert np.array_equal(whole.sensed_m, same.sensed_m)
    assert len(follow_extended.signatures) == compiled, "another compilation costs ten seconds"


def test_arrays_that_must_not_be_written_are_taken() -> None:
    time_s, force_n = np.array([0.0, 1.0]), np.array([0.0, 4000.0])
    for array in (time_s, force_n):
        array.setflags(write=False)
    motion = simulate_motion(P, time_s, force_n, time_s)
    assert motion.position_m[-1] > 0.0


def test_a_waveform_is_sampled_from_its_start_to_its_end() -> None:
    motion = simulate_waveform(P, triangle(0.3, 1, 0.0, 82737.0), AREA_M2, 0.1)
    assert motion.time_s == pytest.approx([0.0, 0.1, 0.2, 0.3])
    stepped = simulate_waveform(P, steps([0.0, 50000.0], 1.0), AREA_M2, 0.5)
    assert stepped.force_n == pytest.approx(np.array([0.0, 0.0, 3226.0, 3226.0, 3226.0]))


def test_without_outputs_the_motion_ends_with_the_force() -> None:
    motion = simulate_motion(P, [0.0, 1.0], [0.0, 4000.0], [])
    assert motion.position_m.size == 0
    assert motion.final_state == simulate_motion(P, [0.0, 1.0], [0.0, 4000.0], [1.0]).final_state


def recorded(pressure_pa: object, position_m: object, count: int) -> Recording:
    return Recording(
        time_s=np.arange(count, dtype=np.float64) * 0.01,
        position_m=np.asarray(position_m, dtype=np.float64),
        pressure_pa=np.asarray(pressure_pa, dtype=np.float64),
    )


def test_a_recorded_pressure_is_held_straight_between_its_samples() -> None:
    waveform = triangle(4.0, 1, 0.0, 82737.0)
    truth = simulate_waveform(P, waveform, AREA_M2, 0.01)
    recording = recorded(waveform.at(truth.time_s), truth.position_m, truth.time_s.size)
    again = simulate_recording(P, recording, NOMINAL.nameplate)
    assert np.abs(again.position_m - truth.position_m).max() < 1.0e-13


def test_a_recording_starts_where_its_stem_was_first_seen() -> None:
    recording = recorded(np.zeros(5), [math.nan, 0.02, 0.02, 0.02, 0.02], 5)
    assert simulate_recording(P, recording, NOMINAL.nameplate).position_m == pytest.approx(0.02)
    held = simulate_recording(P, recording, NOMINAL.nameplate, stops=TravelStops(0.0, 0.01))
    assert held.position_m == pytest.approx(0.01)
    given = simulate_recording(P, recording, NOMINAL.nameplate, initial=StemState(0.005))
    assert given.position_m == pytest.approx(0.005)
    blind = recorded(np.zeros(3), [math.nan] * 3, 3)
    assert simulate_recording(P, blind, NOMINAL.nameplate).position_m == pytest.approx(0.0)


def test_a_gap_in_the_recorded_input_is_refused_with_its_remedy() -> None:
    recording = recorded([0.0, 0.0, math.nan, math.nan, 0.0], np.zeros(5), 5)
    with pytest.raises(RecordingError, match=r"missing in 2 of 5 samples, first at 0\.02 s.*cut the recording"):
        simulate_recording(P, recording, NOMINAL.nameplate)


def test_one_force_moves_a_whole_batch() -> None:
    others = [parameter_set(name).parameters for name in ("vendor", "rough")]
    batch = simulate_batch(others, [0.0, 2.0], [0.0, 4000.0], [0.0, 1.0, 2.0], initial=[StemState(), StemState(0.001)])
    assert batch.velocity_m_per_s is None
    for i, parameters in enumerate(others):
        single = simulate_motion(parameters, [0.0, 2.0], [0.0, 4000.0], [0.0, 1.0, 2.0], initial=StemState(0.001 * i))
        assert np.array_equal(batch.position_m[i], single.position_m)


def test_a_batch_says_which_valve_fails_and_what_does_not_match() -> None:
    with pytest.raises(WaveformError, match="2 forces for 3 valves"):
        simulate_batch([P] * 3, [0.0, 1.0], np.zeros((2, 2)), [0.0])
    with pytest.raises(WaveformError, match="1 travel stops for 3 valves"):
        simulate_batch([P] * 3, [0.0, 1.0], [0.0, 1.0], [0.0], stops=[None])
    with pytest.raises(WaveformError, match="0 valves"):
        simulate_batch([], [0.0, 1.0], [0.0, 1.0], [0.0])
    with pytest.raises(ParameterError, match="outside the travel stops"):
        simulate_batch([P], [0.0, 1.0], [0.0, 1.0], [0.0], stops=[TravelStops(1.0, 2.0)])
    vendor = parameter_set("vendor").parameters
    with pytest.raises(MotionError, match="valve 2 of 2"):
        simulate_batch([P, vendor], [0.0, 800.0], [0.0, 5338.0], [0.0, 800.0], most_events=1000)


def test_the_integrator_says_when_it_creeps() -> None:
    stem = StemIntegrator(parameter_set("vendor").parameters, most_events=100)
    with pytest.raises(MotionError, match="limit is 100"):
        stem.ramp(StemState(), 800.0, 0.0, 5338.0)


def test_times_of_a_mode_are_picked_from_the_events() -> None:
    motion = simulate_motion(P, [0.0, 10.0], [0.0, 5338.0], [0.0, 10.0])
    assert motion.events.times_of(Mode.BAND) == pytest.approx([3.2], rel=1.0e-3)
    assert motion.events.times_of(Mode.STOPPED).size == 0
