"""Loops without a stem position: known signals, simulated loops, and records that nothing can be said of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from scipy import signal
from scipy.io import loadmat

from estimators.loop_stiction.verdict import Answer, LoopVerdict, judged_loop, to_json
from tests.support.control_loops import Kind, control_loop
from valve.errors import RecordingError
from valve.recording import FloatArray

FILE = Path(__file__).parents[4] / "shared" / "data" / "damadics" / "OneHourTestData_ExampleII.mat"
PERIOD_S: Final = 200.0
TIME_S: Final[FloatArray] = np.arange(0.0, 20.0 * PERIOD_S, 2.0)
PHASE: Final[FloatArray] = 2.0 * np.pi * TIME_S / PERIOD_S


def noisy(values: FloatArray, size: float = 0.02, seed: int = 1) -> FloatArray:
    return values + size * np.random.default_rng(seed).standard_normal(values.size)


def triangle(phase: FloatArray) -> FloatArray:
    """Return a triangle that has its zeros where a sine of this phase has them."""
    return np.asarray(signal.sawtooth(phase + 0.5 * np.pi, 0.5))


def judged(output: FloatArray, value: FloatArray, setpoint: FloatArray | None = None) -> LoopVerdict:
    return judged_loop(TIME_S, 50.0 + 5.0 * output, 20.0 + value, setpoint, subject="FIC-7")


def stuck_flow() -> tuple[FloatArray, FloatArray]:
    """Return output and value of a self-regulating loop with a stuck valve: a square, and its integral, a triangle."""
    value = noisy(np.asarray(signal.square(PHASE), dtype=np.float64), 0.1)
    return noisy(triangle(PHASE + 0.5 * np.pi)), value


def test_a_triangle_behind_a_square_is_a_stuck_valve() -> None:
    found = judged(*stuck_flow())
    assert found.answer is Answer.TEST_VALVE
    assert found.process == "self-regulating"
    assert found.oscillation is not None
    assert found.oscillation.period_s == pytest.approx(PERIOD_S, rel=0.02)
    assert found.oscillation.output_swing == pytest.approx(10.0, rel=0.1)
    assert found.oscillation.lag_deg == pytest.approx(90.0, abs=5.0)


def test_units_and_the_direction_of_the_controller_change_no_answer() -> None:
    output, value = stuck_flow()
    found = judged_loop(TIME_S, 8.0e3 - 40.0 * output, 1.0e-3 * value, None, subject="FIC-7")
    assert found.answer is Answer.TEST_VALVE
    assert found.oscillation is not None
    assert found.oscillation.output_swing == pytest.approx(80.0, rel=0.1)


def test_a_triangle_of_the_value_under_a_controller_with_both_actions_is_a_stuck_valve_of_a_level() -> None:
    value = triangle(PHASE)
    integral = np.cumsum(value - value.mean()) * 2.0 * np.pi / PERIOD_S * (TIME_S[1] - TIME_S[0])
    found = judged(noisy(-value - (integral - integral.mean())), noisy(value))
    assert found.answer is Answer.TEST_VALVE
    assert found.process == "integrating"


@pytest.mark.parametrize("lag_deg", [0.0, 45.0, 90.0])
def test_a_sine_is_not_the_valve_whatever_the_controller(lag_deg: float) -> None:
    found = judged(noisy(-np.sin(PHASE - np.radians(lag_deg))), noisy(np.sin(PHASE)))
    assert found.answer is Answer.NOT_THE_VALVE


def test_a_triangle_that_the_proportional_action_makes_is_not_the_valve() -> None:
    found = judged(noisy(-triangle(PHASE)), noisy(triangle(PHASE)))
    assert found.answer is Answer.NOT_THE_VALVE
    assert "proportional action" in found.reason


def leaning(phase: FloatArray, peak: float) -> FloatArray:
    """Return half cycles of straight lines with their peak at this share of each."""
    place = np.mod(phase, np.pi) / np.pi
    return np.where(place < peak, place / peak, (1.0 - place) / (1.0 - peak)) * np.sign(np.sin(phase))


@pytest.mark.parametrize("process", ["self-regulating", "integrating"])
@pytest.mark.parametrize(("peak", "is_stuck"), [(0.5, True), (0.15, False), (0.85, False)])
def test_pulses_that_lean_are_no_stuck_valve(process: str, peak: float, is_stuck: bool) -> None:
    """What a loop makes of an outer load that goes on and off."""
    bent = leaning(PHASE, peak)
    if process == "self-regulating":
        found = judged(noisy(bent), noisy(np.sin(PHASE - 0.5 * np.pi)))
    else:
        integral = np.cumsum(bent) * 2.0 * np.pi / PERIOD_S * (TIME_S[1] - TIME_S[0])
        found = judged(noisy(-bent - signal.detrend(integral)), noisy(bent))
    assert (found.answer is Answer.TEST_VALVE) == is_stuck
    assert found.answer is not Answer.NO_OSCILLATION


def test_swings_of_any_size_are_no_stuck_valve() -> None:
    heights = np.repeat(np.random.default_rng(3).uniform(0.2, 2.0, 20), TIME_S.size // 20)
    output, value = stuck_flow()
    found = judged(heights * output, heights * value)
    assert found.answer in (Answer.CANNOT_TELL, Answer.NO_OSCILLATION)


def test_random_loads_are_seldom_taken_for_an_oscillation_and_never_for_a_stuck_valve() -> None:
    answers = []
    for seed in range(12):
        random = np.random.default_rng(seed).standard_normal(TIME_S.size)
        walk = np.asarray(signal.lfilter([0.1], [1.0, -0.98], random))
        found = judged(-np.cumsum(walk) * 0.02 - walk, noisy(walk))
        answers.append(found.answer)
        assert found.answer is not Answer.NO_OSCILLATION or "period up to 8.33 min" in found.reason
    assert answers.count(Answer.NO_OSCILLATION) >= 8
    assert Answer.TEST_VALVE not in answers


def test_a_set_point_that_swings_too_is_for_the_outer_loop_to_explain() -> None:
    output, value = stuck_flow()
    found = judged(output, value, 20.0 + 0.5 * np.sin(PHASE - 1.0))
    assert found.answer is Answer.CANNOT_TELL
    assert "set point swings with the same period" in found.reason


def test_single_steps_of_the_set_point_do_no_harm() -> None:
    output, value = stuck_flow()
    steps = np.zeros(TIME_S.size)
    for number, at_s in enumerate((310.0, 640.0, 1130.0, 1490.0, 2210.0, 2650.0, 3100.0, 3570.0)):
        steps += np.where(at_s < TIME_S, 3.0 * (-1.0) ** number, 0.0)
    assert judged(output, value + steps, 20.0 + steps).answer is Answer.TEST_VALVE


def manual(output: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.where(TIME_S < 1500.0, output[749], output), value


def saturated(output: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.clip(output, -0.5, 2.0), value


def drawn(output: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    kept = slice(None, None, 10)
    return np.interp(TIME_S, TIME_S[kept], output[kept]), np.interp(TIME_S, TIME_S[kept], value[kept])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda output, value: (0.0 * output, value), "the controller output is 50 in all 2000 rows"),
        (lambda output, value: (output, 0.0 * value), "the process value is 20 in all 2000 rows"),
        (manual, "does not change for 25"),
        (saturated, "stands at its end, 47.5, in "),
        (drawn, "without compression or interpolation"),
    ],
)
def test_what_cannot_be_told_says_why_and_what_to_do(
    spoil: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]], words: str
) -> None:
    found = judged(*spoil(*stuck_flow()))
    assert found.answer is Answer.CANNOT_TELL
    assert words in found.reason
    assert "export" in found.reason


def test_reports_of_changes_are_refused_as_interpolated_rows_are() -> None:
    output, value = stuck_flow()
    kept = np.random.default_rng(5).random(TIME_S.size) < 0.3
    found = judged_loop(TIME_S[kept], output[kept], value[kept], None, subject="FIC-7")
    assert found.answer is Answer.CANNOT_TELL
    assert "a historian's reports of changes" in found.reason


def test_slow_rows_are_asked_to_be_faster() -> None:
    output, value = stuck_flow()
    found = judged_loop(TIME_S[::10], output[::10], value[::10], None, subject="FIC-7")
    assert found.answer is Answer.CANNOT_TELL
    assert "has 10 rows, its shape needs 12: export a row every 16.7 s or faster" in found.reason


def test_fewer_than_eight_periods_are_no_oscillation_that_could_be_judged() -> None:
    output, value = stuck_flow()
    found = judged_loop(TIME_S[:700], output[:700], value[:700], None, subject="FIC-7")
    assert found.answer is Answer.NO_OSCILLATION
    assert "period up to 2.91 min" in found.reason


def test_the_longest_stretch_between_gaps_is_judged() -> None:
    output, value = stuck_flow()
    value[200:260] = np.nan
    found = judged(output, value)
    assert found.answer is Answer.TEST_VALVE
    assert found.rows.left_out_s == pytest.approx(520.0)
    assert "1 gaps" in found.notes[0]


def test_too_few_rows_and_too_many_gaps_are_refused() -> None:
    output, value = stuck_flow()
    with pytest.raises(RecordingError, match="50 rows have a controller output and a process value, 96 are needed"):
        judged_loop(TIME_S[:50], output[:50], value[:50], None, subject="FIC-7")
    for at in range(0, 2000, 60):
        value[at : at + 8] = np.nan
    with pytest.raises(RecordingError, match="gaps leave at most"):
        judged(output, value)


def test_the_json_names_every_figure_and_none_of_a_stem() -> None:
    document = to_json(judged(*stuck_flow()))
    assert document["schema"] == "breakaway/loop/1"
    assert document["answer"] == "test_valve"
    assert document["oscillation"]["period_s"] == pytest.approx(PERIOD_S, rel=0.02)
    assert document["shapes"]["output"]["index"] > 0.6
    assert not {"friction", "dead_band", "stick_band"} & set(document["oscillation"])


def test_a_simulated_level_with_a_sticking_valve_is_found() -> None:
    made = control_loop("level", Kind.STICKS_HARD, 21)
    found = judged_loop(made.time_s, made.output, made.value, made.setpoint, subject="LIC-2")
    assert found.answer is Answer.TEST_VALVE
    assert found.process == "integrating"


@pytest.mark.parametrize("process", ["flow", "level", "temperature"])
@pytest.mark.parametrize("kind", [Kind.QUIET, Kind.TIGHT, Kind.SINE, Kind.SQUARE, Kind.SETPOINT, Kind.SATURATED])
def test_a_simulated_loop_with_a_valve_in_order_is_never_sent_for_a_test(process: str, kind: Kind) -> None:
    made = control_loop(process, kind, 21)
    found = judged_loop(made.time_s, made.output, made.value, made.setpoint, subject="XC-1")
    assert found.answer is not Answer.TEST_VALVE


@pytest.mark.skipif(not FILE.exists(), reason="the measured hour of DAMADICS is not beside the project")
def test_the_measured_hour_is_too_slow_for_its_swing_and_says_so() -> None:
    # rows of the matrix: time, ..., controller output in %, rod displacement in %, level in %
    matrix = np.asarray(loadmat(FILE)["OneHourTestData_ExampleII"], dtype=np.float64)
    found = judged_loop(matrix[0], matrix[5], matrix[7], None, subject="LC74")
    assert found.answer is Answer.CANNOT_TELL
    assert "a period of 5.22 s has 5.22 rows" in found.reason


def test_a_record_too_short_for_a_slow_period_says_how_long_it_should_be() -> None:
    output, value = stuck_flow()
    found = judged_loop(TIME_S[:200], output[:200], value[:200], subject="FIC-7")
    assert found.answer is Answer.CANNOT_TELL
    assert "is 6.63 min long" in found.reason
    assert "export 80 min at least" in found.reason


def test_a_clock_that_was_set_back_is_said_with_where_and_the_remedy() -> None:
    time_s = np.concatenate([TIME_S[:1000], TIME_S[:1000] - 100.0])
    with pytest.raises(RecordingError, match=r"FIC-7: the clock goes back once, by 2098 s at row 1001, .* in UTC"):
        judged_loop(time_s, *(one[:2000] for one in stuck_flow()), subject="FIC-7")


@pytest.mark.parametrize("channel", [0, 1])
def test_a_unit_that_changes_in_the_middle_is_refused_and_not_called_no_oscillation(channel: int) -> None:
    channels = [one[:2000].copy() for one in stuck_flow()]
    channels[channel][1000:] /= 100.0
    name = ("output", "process value")[channel]
    with pytest.raises(RecordingError, match=rf"the unit of the {name} changes after row 1000 .* a factor of 100 "):
        judged_loop(TIME_S[:2000], *channels, subject="FIC-7")
