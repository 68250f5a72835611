"""Waveforms: their corners, what lies between them, and each refusal."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from valve.diagnostic_waveform import diagnostic
from valve.errors import WaveformError
from valve.waveform import Waveform, dwell, multi_rate_periods, multi_rate_triangle, sine, steps, triangle

_NOTHING_PA = 1.0e-9  # what numbers near the smallest that there are lose in a quotient

pressures = st.floats(-1.0e6, 1.0e6)


@st.composite
def waveforms(draw: st.DrawFn) -> Waveform:
    runs_s = draw(st.lists(st.one_of(st.just(0.0), st.floats(1.0e-6, 1.0e3)), min_size=1, max_size=12))
    time_s = np.concatenate(([0.0], np.cumsum(runs_s)))
    if time_s[-1] == 0.0:
        time_s[-1] = 1.0
    return Waveform("drawn", time_s, np.array(draw(st.lists(pressures, min_size=time_s.size, max_size=time_s.size))))


@settings(suppress_health_check=[HealthCheck.too_slow])  # the first input waits for what is loaded beside
@given(waveforms(), st.lists(st.floats(-10.0, 2.0e4), min_size=1, max_size=20))
def test_the_pressure_never_leaves_the_range_of_the_corners(waveform: Waveform, times_s: list[float]) -> None:
    low_pa, high_pa = waveform.range_pa
    found_pa = waveform.at(np.array(times_s))
    assert found_pa.min() >= low_pa
    assert found_pa.max() <= high_pa


@given(waveforms())
def test_each_corner_is_met_and_of_a_step_its_far_side(waveform: Waveform) -> None:
    last_at = dict(zip(waveform.time_s, waveform.pressure_pa, strict=True))
    for time_s, pressure_pa in last_at.items():
        assert waveform.at(float(time_s)) == pytest.approx(pressure_pa, rel=1.0e-12, abs=1.0e-9)


@given(waveforms())
def test_the_ends_are_held(waveform: Waveform) -> None:
    assert waveform.at(-1.0e-9) == waveform.pressure_pa[0]
    assert waveform.at(-100.0) == waveform.pressure_pa[0]
    assert waveform.at(waveform.duration_s + 5.0) == waveform.pressure_pa[-1]


@given(waveforms())
def test_no_slope_is_steeper_than_the_fastest(waveform: Waveform) -> None:
    rate = waveform.fastest_rate_pa_per_s
    run_s, rise_pa = np.diff(waveform.time_s), np.abs(np.diff(waveform.pressure_pa))
    assert (
        (rise_pa <= rate * run_s * (1.0 + 1.0e-12) + _NOTHING_PA).all()
        if math.isfinite(rate)
        else (run_s[rise_pa > 0.0] < 1.0).any()
    )


def test_an_array_of_any_shape_is_answered_in_its_shape() -> None:
    waveform = triangle(4.0, 1, 0.0, 100.0)
    assert waveform.at(np.array([[0.0, 1.0], [2.0, 3.0]])) == pytest.approx(np.array([[0.0, 50.0], [100.0, 50.0]]))
    assert waveform.at(1.0).shape == ()


def test_a_step_at_the_very_start_and_end_is_seen_on_its_far_side() -> None:
    waveform = Waveform("edges", np.array([0.0, 0.0, 1.0, 1.0]), np.array([5.0, 10.0, 10.0, 20.0]))
    assert waveform.at(np.array([-1.0, 0.0, 0.5, 1.0, 2.0])).tolist() == [5.0, 10.0, 10.0, 20.0, 20.0]


@pytest.mark.parametrize(
    ("time_s", "pressure_pa", "words"),
    [
        ([0.0], [1.0], "at least 2"),
        ([0.0, 1.0], [1.0], "2 times and 1 pressures"),
        ([0.0, math.nan], [1.0, 1.0], "not a finite number"),
        ([0.0, 1.0], [1.0, math.inf], "not a finite number"),
        ([1.0, 2.0], [1.0, 1.0], "must start at 0 s"),
        ([0.0, 2.0, 1.0], [1.0, 1.0, 1.0], "must start at 0 s and rise"),
        ([0.0, 0.0], [1.0, 2.0], "must start at 0 s and rise"),
        ([[0.0, 1.0]], [[0.0, 1.0]], "at least 2"),
    ],
)
def test_malformed_corners_are_refused(time_s: list[float], pressure_pa: list[float], words: str) -> None:
    with pytest.raises(WaveformError, match=f"waveform odd: .*{words}"):
        Waveform("odd", np.array(time_s), np.array(pressure_pa))


def test_a_waveform_cannot_be_written_to_and_keeps_its_own_copy() -> None:
    corners_s = np.array([0.0, 1.0])
    waveform = Waveform("kept", corners_s, np.array([0.0, 1.0]))
    corners_s[1] = 9.0
    assert waveform.duration_s == 1.0
    with pytest.raises(ValueError, match="read-only"):
        waveform.pressure_pa[0] = 3.0


def test_a_triangle_rises_and_falls_as_often_as_asked() -> None:
    waveform = triangle(20.0, 3, 0.0, 82737.0)
    assert waveform.time_s.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    assert waveform.pressure_pa.tolist() == [0.0, 82737.0] * 3 + [0.0]
    assert waveform.fastest_rate_pa_per_s == pytest.approx(8273.7)
    assert waveform.name == "triangle"


def test_a_triangle_can_start_from_rest_and_end_there() -> None:
    waveform = triangle(20.0, 1, 1000.0, 11000.0, rest_pa=500.0, rest_s=2.0)
    # 1000 Pa/s: half a second each way
    assert waveform.time_s == pytest.approx([0.0, 0.5, 10.5, 20.5, 21.0, 23.0])
    assert waveform.pressure_pa.tolist() == [500.0, 1000.0, 11000.0, 1000.0, 500.0, 500.0]


def test_a_rest_at_the_low_end_needs_no_way_there() -> None:
    waveform = triangle(2.0, 1, 1000.0, 2000.0, rest_pa=1000.0)
    assert waveform.time_s.tolist() == [0.0, 1.0, 2.0]


def test_a_multi_rate_triangle_takes_each_period_in_turn() -> None:
    waveform = multi_rate_triangle([20.0, 2.0], 0.0, 100.0, rest_pa=10.0)
    # back to rest at the last period's slope of 100 Pa/s
    assert np.diff(waveform.time_s) == pytest.approx([1.0, 10.0, 10.0, 1.0, 1.0, 0.1])
    assert waveform.fastest_rate_pa_per_s == pytest.approx(100.0)


@pytest.mark.parametrize("fastest_s", [2.0, 4.2, 8.0, 12.0])
def test_multi_rate_periods_fill_the_time_and_none_is_another_again(fastest_s: float) -> None:
    periods_s = multi_rate_periods(fastest_s)
    assert periods_s[0] == 20.0
    assert 60.0 - 1.3 * fastest_s < sum(periods_s) <= 60.0
    fast = np.sort(periods_s[1 if fastest_s > 5.0 else 2 :])
    assert fast.size >= 2
    assert fastest_s <= fast[0]
    assert fast[-1] <= 1.3 * fastest_s
    assert np.diff(fast).min() > 1.0e-3 * fastest_s


@pytest.mark.parametrize(
    ("fastest_s", "duration_s", "words"),
    [(15.0, 60.0, "hardly another rate"), (4.0, 30.0, "allow more time"), (0.0, 60.0, "above 0"), (2.0, math.inf, "0")],
)
def test_rates_that_cannot_be_had_are_refused(fastest_s: float, duration_s: float, words: str) -> None:
    with pytest.raises(WaveformError, match=words):
        multi_rate_periods(fastest_s, duration_s=duration_s)


def test_holds_at_the_turns_come_on_top_and_are_counted() -> None:
    periods_s = multi_rate_periods(2.0, turn_s=0.5)
    wave = multi_rate_triangle(periods_s, 1.0, 3.0, turn_s=0.5)
    assert wave.duration_s == pytest.approx(sum(periods_s) + len(periods_s))
    assert 55.0 < wave.duration_s <= 60.0
    assert wave.at(np.array([10.0, 10.25, 10.5])) == pytest.approx(3.0)
    assert wave.at(np.array([20.5, 20.75, 21.0])) == pytest.approx(1.0)
    with pytest.raises(WaveformError, match="hold at a turn"):
        multi_rate_triangle([2.0], 1.0, 3.0, turn_s=-0.1)


def test_a_sine_keeps_to_the_sine_between_its_corners() -> None:
    waveform = sine(8.0, 2.5, 0.0, 70050.0)
    time_s = np.linspace(0.0, 20.0, 100_001)
    exact_pa = 35025.0 * (1.0 - np.cos(2.0 * np.pi * time_s / 8.0))
    error = np.abs(waveform.at(time_s) - exact_pa).max() / 70050.0
    # the docstring's bound, and close to it
    assert 0.5 * (math.pi / 2000.0) ** 2 / 4.0 < error <= 1.001 * (math.pi / 2000.0) ** 2 / 4.0
    assert waveform.range_pa == pytest.approx((0.0, 70050.0))


def test_steps_change_at_once_and_hold() -> None:
    waveform = steps([0.0, 100.0, 50.0], 2.0)
    assert waveform.at(np.array([0.0, 1.999, 2.0, 3.9, 4.0, 6.0])).tolist() == [0.0, 0.0, 100.0, 100.0, 50.0, 50.0]
    assert waveform.duration_s == 6.0
    assert waveform.fastest_rate_pa_per_s == math.inf


def test_a_flat_waveform_has_no_rate() -> None:
    assert steps([5.0, 5.0], 1.0).fastest_rate_pa_per_s == 0.0


def test_dwells_rest_in_the_middle_of_each_ramp() -> None:
    waveform = dwell(4.0, 0.0, 100.0, [3.0, 7.0])
    assert np.diff(waveform.time_s).tolist() == [1.0, 3.0, 1.0, 1.0, 3.0, 1.0, 1.0, 7.0, 1.0, 1.0, 7.0, 1.0]
    assert waveform.pressure_pa[[1, 2, 3, 4, 5, 6]].tolist() == [50.0, 50.0, 100.0, 50.0, 50.0, 0.0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: triangle(20.0, 0, 0.0, 1.0), "no cycle"),
        (lambda: triangle(0.0, 1, 0.0, 1.0), "period in s is 0"),
        (lambda: triangle(math.nan, 1, 0.0, 1.0), "period in s is nan"),
        (lambda: triangle(1.0, 1, 2.0, 1.0), "the second must be higher"),
        (lambda: triangle(1.0, 1, 0.0, 1.0, rest_s=-1.0), "the rest in s is -1"),
        (lambda: triangle(1.0, 1, 0.0, 1.0, rest_s=math.nan), "the rest in s is nan"),
        (lambda: triangle(1.0, 1, 0.0, 1.0, rest_pa=math.nan), "finite"),
        (lambda: triangle(1.0, 1, 0.0, math.inf), "finite"),
        (lambda: multi_rate_triangle([1.0, -1.0], 0.0, 1.0), "period in s is -1"),
        (lambda: sine(0.0, 1.0, 0.0, 1.0), "period in s is 0"),
        (lambda: sine(1.0, 0.0, 0.0, 1.0), "number of cycles is 0"),
        (lambda: sine(1.0, 1.0, 1.0, 1.0), "the second must be higher"),
        (lambda: sine(1.0, 1.0, 0.0, 1.0, corners_per_period=4), "4 corners a period, it needs at least 8"),
        (lambda: steps([1.0], 1.0), "1 level"),
        (lambda: steps([1.0, 2.0], 0.0), "hold in s is 0"),
        (lambda: dwell(1.0, 0.0, 1.0, []), "no dwell"),
        (lambda: dwell(1.0, 0.0, 1.0, [0.0]), "a dwell in s is 0"),
        (lambda: dwell(1.0, 1.0, 0.0, [1.0]), "the second must be higher"),
        (lambda: dwell(-1.0, 0.0, 1.0, [1.0]), "period in s is -1"),
    ],
)
def test_a_shape_that_makes_no_sense_is_refused(make: object, words: str) -> None:
    with pytest.raises(WaveformError, match=words):
        make()  # type: ignore[operator]  # each is a function without arguments


@pytest.mark.parametrize("turn_s", [0.0, 0.5, 2.0])
def test_periods_with_holds_at_their_turns_fit_into_the_time(turn_s: float) -> None:
    for duration_s in np.linspace(50.0, 70.0, 21).tolist():
        periods_s = multi_rate_periods(2.0, 20.0, duration_s, turn_s)
        wave = multi_rate_triangle(periods_s, 0.0, 82737.0, turn_s=turn_s)
        assert wave.duration_s <= duration_s * (1.0 + 1.0e-12)
        # no further one would fit
        assert wave.duration_s + 1.3 * 2.0 + 2.0 * turn_s > duration_s


@pytest.mark.parametrize("allowed_s", [8.0, 20.0, 40.0, 90.0])
def test_no_part_of_the_diagnostic_sequence_is_faster_than_the_pressure_may_go(allowed_s: float) -> None:
    """The loops and the ways to their middle too: each has a limit of its own where ramps must be slow."""
    rate_pa_per_s = 2.0 * 82737.0 / allowed_s
    wave = diagnostic(0.0, 82737.0, rate_pa_per_s=rate_pa_per_s, longest_s=3600.0)
    assert wave.fastest_rate_pa_per_s <= rate_pa_per_s
    assert wave.range_pa == (0.0, 82737.0)


def test_the_diagnostic_sequence_rests_on_its_way_and_not_only_where_it_turns() -> None:
    wave = diagnostic(0.0, 100.0, rate_pa_per_s=1.0e3, longest_s=300.0, dwells_s=(0.5, 8.0))
    assert wave.duration_s < 139.0
    still = np.diff(wave.pressure_pa) == 0.0
    places, lengths_s = wave.pressure_pa[:-1][still], np.diff(wave.time_s)[still]
    up, down = (60.0, 68.0, 76.0, 84.0), (40.0, 32.0, 24.0, 16.0)
    assert places.tolist() == pytest.approx([*up, *down, *up, *down])
    assert lengths_s.tolist() == pytest.approx([0.5] * 9 + [8.0, 0.5, 0.5, 0.5, 8.0, 0.5, 0.5])
