"""The extended valve's motion: exact where nothing is added, and what holds whatever is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.support.extended_reference import integrate
from tests.valve.random_valves import DURATION_S, KINDS, random_valve
from valve.errors import MotionError, ParameterError, WaveformError
from valve.extended_motion import ExtendedStem, input_corners, simulate_extended
from valve.extended_state import ExtendedState, Rests
from valve.extended_valve import (
    AreaSlots,
    Curve,
    ExtendedValve,
    FrictionSlots,
    InputPath,
    SensorPath,
    SpringSlots,
    StopSlots,
    Vibration,
)
from valve.motion import Mode, StemState, simulate_motion
from valve.parameter_sets import PARAMETER_SETS, parameter_set
from valve.waveform import Waveform, sine, steps, triangle

FloatArray = npt.NDArray[np.float64]
SAME_M = 1.0e-12  # the exact motion's own difference between corners and samples is 1e-14
NOMINAL = parameter_set("nominal").parameters
FULL_FORCE_N = 0.06452 * 82737.0
COURSE_S = np.array([0.0, 0.8, 1.3, 1.5, 2.0])
COURSE_N = FULL_FORCE_N * np.array([0.0, 1.0, 0.35, 0.35, 0.9])
EVERY_MS: FloatArray = np.arange(2001, dtype=np.float64) * 1.0e-3
# several at once, so that the whole is more than its parts
FILLED = ExtendedValve(
    NOMINAL,
    spring=SpringSlots(hardening_n_per_m2=5.0e4, knee_m=0.04, knee_rate_n_per_m=4000.0),
    friction=FrictionSlots(
        spot_n=200.0, spot_centre_m=0.03, spot_width_m=0.003, drift_n=100.0, drift_time_s=3.0, coulomb_asymmetry=0.1,
        static_asymmetry=0.1, stribeck_velocity_m_per_s=0.01, dwell_rise_n=200.0, dwell_time_s=0.2,
    ),
    stops=StopSlots(-0.01, 0.06),
    vibration=Vibration(20.0, 7.0),
    sensor=SensorPath(lag_s=0.02, play_m=2.0e-4),
)  # fmt: skip
# a slot filled with next to nothing: the path of filled slots for a motion that is known exactly
NEXT_TO_NEUTRAL = {
    "neutral": {},
    "on the path of filled slots": {"spring": SpringSlots(hardening_n_per_m2=1.0e-9)},
}


def waveforms(low_pa: float, high_pa: float) -> list[Waveform]:
    levels = [low_pa, high_pa, 0.5 * (low_pa + high_pa), low_pa]
    return [triangle(10.0, 2, low_pa, high_pa), sine(8.0, 2, low_pa, high_pa), steps(levels, 3.0)]


@pytest.mark.parametrize("slots", NEXT_TO_NEUTRAL)
@pytest.mark.parametrize("name", PARAMETER_SETS)
def test_with_neutral_slots_it_is_the_exact_motion(name: str, slots: str) -> None:
    chosen = PARAMETER_SETS[name]
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    valve = ExtendedValve(chosen.parameters, **NEXT_TO_NEUTRAL[slots])  # type: ignore[arg-type]
    for waveform in waveforms(*signal.range_pa):
        time_s: FloatArray = np.arange(round(waveform.duration_s * 500) + 1, dtype=np.float64) * 2.0e-3
        corner_s, corner_n = waveform.time_s.copy(), area_m2 * waveform.pressure_pa
        exact = simulate_motion(chosen.parameters, corner_s, corner_n, time_s)
        motion = simulate_extended(valve, corner_s, corner_n, time_s)
        assert np.abs(motion.position_m - exact.position_m).max() < SAME_M
        assert np.array_equal(motion.mode, exact.mode)
        assert np.allclose(motion.events.time_s, exact.events.time_s, rtol=0.0, atol=1.0e-9)
        sampled_n = area_m2 * waveform.at(time_s)
        held = simulate_motion(chosen.parameters, time_s, sampled_n, time_s)
        assert np.abs(simulate_extended(valve, time_s, sampled_n, time_s).position_m - held.position_m).max() < SAME_M


@pytest.mark.parametrize("kind", KINDS)
def test_with_neutral_slots_any_valve_moves_exactly(kind: str) -> None:
    time_s = np.linspace(0.0, DURATION_S, 501)
    for seed in range(1, 5):
        drawn = random_valve(kind, seed)
        exact = simulate_motion(drawn.parameters, drawn.force_time_s, drawn.force_n, time_s, stops=drawn.stops)
        slots = StopSlots(drawn.stops.low_m, drawn.stops.high_m)
        motion = simulate_extended(
            ExtendedValve(drawn.parameters, stops=slots), drawn.force_time_s, drawn.force_n, time_s
        )
        assert np.abs(motion.position_m - exact.position_m).max() < SAME_M


def test_many_slots_at_once_agree_with_fixed_steps() -> None:
    _position_m, expected_m = integrate(FILLED, COURSE_S, COURSE_N, 2.0, 1.0e-3, 2.0e-6)
    motion = simulate_extended(FILLED, COURSE_S, COURSE_N, EVERY_MS)
    assert np.abs(motion.sensed_m - expected_m).max() < 6.0e-6
    coarse = simulate_extended(FILLED, COURSE_S, COURSE_N, EVERY_MS[::50])
    assert np.abs(coarse.sensed_m - expected_m[::50]).max() < 6.0e-6, "polled at 50 ms it is the same valve"


def test_jittered_polls_see_the_same_motion() -> None:
    rng = np.random.default_rng(5)
    polls_s = np.sort(np.concatenate((rng.uniform(0.0, 2.0, 60), [0.0, 2.0])))
    dense_s = np.union1d(EVERY_MS, polls_s)
    dense = simulate_extended(FILLED, COURSE_S, COURSE_N, dense_s)
    polled = simulate_extended(FILLED, COURSE_S, COURSE_N, polls_s)
    assert np.abs(polled.sensed_m - dense.sensed_m[np.isin(dense_s, polls_s)]).max() < 6.0e-6


@pytest.mark.parametrize("valve", [FILLED, ExtendedValve(NOMINAL, friction=FrictionSlots(presliding_m=1.0e-4))])
def test_pieces_make_the_whole(valve: ExtendedValve) -> None:
    whole = simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS)
    rng, stem, state = np.random.default_rng(8), ExtendedStem(valve), ExtendedState()
    at_s, seen_m = 0.0, []
    looks = np.unique(rng.integers(1, 2001, 90))
    for look in looks:
        to_s = EVERY_MS[look]
        corners_s = np.concatenate(([at_s], COURSE_S[(at_s < COURSE_S) & (to_s > COURSE_S)], [to_s]))
        state = stem.advance(state, corners_s - at_s, np.interp(corners_s, COURSE_S, COURSE_N))
        at_s = to_s
        seen_m.append(state.sensed_m)
    assert np.abs(np.array(seen_m) - whole.sensed_m[looks]).max() < 3.0e-6


def test_without_preload_the_mirrored_force_mirrors_the_motion() -> None:
    valve = ExtendedValve(
        NOMINAL,
        friction=FrictionSlots(stribeck_velocity_m_per_s=0.01, dwell_rise_n=100.0, pressure_share=0.02, drift_n=50.0),
    )
    there = simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS)
    back = simulate_extended(valve, COURSE_S, -COURSE_N, EVERY_MS)
    assert np.abs(there.position_m + back.position_m).max() < 1.0e-12
    asymmetry = FrictionSlots(coulomb_asymmetry=0.2, static_asymmetry=0.2, viscous_asymmetry=0.1)
    other = FrictionSlots(coulomb_asymmetry=-0.2, static_asymmetry=-0.2, viscous_asymmetry=-0.1)
    there = simulate_extended(ExtendedValve(NOMINAL, friction=asymmetry), COURSE_S, COURSE_N, EVERY_MS)
    back = simulate_extended(ExtendedValve(NOMINAL, friction=other), COURSE_S, -COURSE_N, EVERY_MS)
    assert np.abs(there.position_m + back.position_m).max() < 1.0e-12


def test_force_and_position_never_pass_their_limits() -> None:
    valve = replace(FILLED, input=InputPath(limit_n=3000.0, lag_s=0.1))
    motion = simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS)
    assert motion.force_n.max() <= 3000.0
    assert motion.force_n.max() > 2990.0
    low = simulate_extended(FILLED, COURSE_S, 2.0 * COURSE_N, EVERY_MS)
    assert low.position_m.max() == pytest.approx(0.06, abs=1.0e-15)
    assert (low.mode == Mode.STOPPED).any()


def test_a_curve_over_travel_does_what_the_formula_does() -> None:
    points_m = np.linspace(0.0, 0.1, 201)
    gauss_n = 200.0 * np.exp(-0.5 * ((points_m - 0.03) / 0.005) ** 2)
    spot = FrictionSlots(spot_n=200.0, spot_centre_m=0.03, spot_width_m=0.005)
    for curved, formula in (
        (
            ExtendedValve(NOMINAL, friction=FrictionSlots(curve_n=Curve(0.0, 0.1, tuple(gauss_n)))),
            ExtendedValve(NOMINAL, friction=spot),
        ),
        (
            ExtendedValve(NOMINAL, spring=SpringSlots(curve_n=Curve(0.0, 0.1, tuple(2.5e4 * points_m**2)))),
            ExtendedValve(NOMINAL, spring=SpringSlots(hardening_n_per_m2=5.0e4)),
        ),
        (
            ExtendedValve(NOMINAL, area=AreaSlots(curve=Curve(0.0, 0.1, tuple(-0.3 * points_m)))),
            ExtendedValve(NOMINAL, area=AreaSlots(slope_per_m=-0.3)),
        ),
    ):
        by_curve, by_formula = (simulate_extended(v, COURSE_S, COURSE_N, EVERY_MS) for v in (curved, formula))
        assert np.abs(by_curve.position_m - by_formula.position_m).max() < 5.0e-6


def test_the_stem_is_put_where_it_was_seen_to_rest() -> None:
    rests = Rests(np.array([0.2, 1.4]), np.array([0.001, 0.04]))
    motion = simulate_extended(ExtendedValve(NOMINAL), COURSE_S, COURSE_N, EVERY_MS, rests=rests)
    assert motion.position_m[[199, 200, 1400]] == pytest.approx([0.0, 0.001, 0.04])
    again = simulate_extended(
        ExtendedValve(NOMINAL), [1.4, 1.5, 2.0], COURSE_N[[3, 3, 4]], EVERY_MS[1400:],
        initial=ExtendedState(StemState(0.04)),
    )  # fmt: skip
    assert np.abs(motion.position_m[1400:] - again.position_m).max() < SAME_M


def test_how_long_it_had_rested_counts_where_breakaway_depends_on_it() -> None:
    valve = ExtendedValve(NOMINAL, friction=FrictionSlots(dwell_rise_n=400.0, dwell_time_s=1.0))
    at_s, at_m = np.array([1.4]), np.array([0.03])
    breakaways = [
        simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS, rests=rests).events.time_s[-2]
        for rests in (Rests(at_s, at_m), Rests(at_s, at_m, np.array([-5.0])))
    ]
    assert breakaways[1] > breakaways[0] + 0.02


def test_the_input_path_answers_a_step_in_closed_form() -> None:
    path = InputPath(gain=1.1, leak=0.1, limit_n=900.0, lag_s=0.3, dead_time_s=0.2)
    time_s, force_n = input_corners(path, np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1000.0]), 4.0)
    wanted_s = np.linspace(0.0, 4.0, 4001)
    expected_n = 810.0 * (1.0 - np.exp(-np.maximum(wanted_s - 1.2, 0.0) / 0.3))
    assert np.abs(np.interp(wanted_s, time_s, force_n) - expected_n).max() < 5.0e-5
    assert time_s.size < 10_000


def test_a_ramp_meets_its_limit_and_its_lag_at_their_time() -> None:
    time_s, force_n = input_corners(InputPath(limit_n=600.0), np.array([0.0, 1.0]), np.array([0.0, 1000.0]), 1.0)
    assert time_s == pytest.approx([0.0, 0.6, 1.0])
    assert force_n == pytest.approx([0.0, 600.0, 600.0])
    sampled_s: FloatArray = np.arange(3001, dtype=np.float64) * 1.0e-3
    lagged_s, lagged_n = input_corners(InputPath(lag_s=0.25), sampled_s, 100.0 * sampled_s, 3.0)
    exact_n = 100.0 * (sampled_s - 0.25 * (1.0 - np.exp(-sampled_s / 0.25)))
    assert np.abs(np.interp(sampled_s, lagged_s, lagged_n) - exact_n).max() < 1.0e-5


def test_a_measured_force_takes_no_input_path() -> None:
    valve = ExtendedValve(NOMINAL, input=InputPath(lag_s=0.5, dead_time_s=0.3))
    measured = simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS, command=False)
    bare = simulate_extended(ExtendedValve(NOMINAL), COURSE_S, COURSE_N, EVERY_MS)
    assert np.array_equal(measured.position_m, bare.position_m)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ParameterError, match="spot_width_m is 0"):
        FrictionSlots(spot_width_m=0.0)
    with pytest.raises(ParameterError, match="coulomb_asymmetry is 2"):
        FrictionSlots(coulomb_asymmetry=2.0)
    with pytest.raises(ParameterError, match="gradient_n_per_m is nan"):
        ExtendedValve(NOMINAL, friction=FrictionSlots(gradient_n_per_m=float("nan")))
    with pytest.raises(ParameterError, match="1 values"):
        Curve(0.0, 1.0, (1.0,))
    with pytest.raises(WaveformError, match="rests"):
        Rests(np.array([1.0, 0.0]), np.array([0.0, 0.0]))
    with pytest.raises(ParameterError, match="outside the travel stops"):
        simulate_extended(FILLED, COURSE_S, COURSE_N, EVERY_MS, initial=ExtendedState(StemState(0.07)))
    with pytest.raises(MotionError, match="the extended stem"):
        simulate_extended(FILLED, COURSE_S, COURSE_N, EVERY_MS, most_events=3)


def test_a_stem_without_a_spring_that_runs_off_over_a_spot_ends_with_an_error() -> None:
    """What a search may try (blind case diagnostic 11111) took minutes of steps as fine as the spot."""
    loose = replace(
        NOMINAL,
        spring_rate_n_per_m=1.0e-3,
        viscous_friction_n_s_per_m=0.0114,
        coulomb_friction_n=0.0062,
        static_friction_n=0.068,
    )
    valve = ExtendedValve(loose, friction=FrictionSlots(spot_n=-1.0e-11, spot_centre_m=0.023, spot_width_m=2.0e-3))
    with pytest.raises(MotionError, match="more steps"):
        simulate_extended(valve, COURSE_S, COURSE_N, EVERY_MS)


def test_steep_steps_late_in_a_sampled_record_do_not_stop_the_clock() -> None:
    time_s = np.arange(20_001, dtype=np.float64) * 1.0e-3
    force_n = FULL_FORCE_N * steps([0.0, 1.0, 0.5, 0.0], 5.0).at(time_s)
    rng = np.random.default_rng(3)
    vendor = parameter_set("vendor").parameters
    for _ in range(10):
        scaled = replace(vendor, mass_kg=rng.uniform(0.9, 1.8), spring_rate_n_per_m=rng.uniform(37e3, 68e3))
        exact = simulate_motion(scaled, time_s, force_n, time_s)
        assert (
            np.abs(
                simulate_extended(ExtendedValve(scaled), time_s, force_n, time_s).position_m - exact.position_m
            ).max()
            < SAME_M
        )


def test_a_heavily_damped_stem_that_shakes_is_followed_to_the_end() -> None:
    chosen, rng = parameter_set("graphite"), np.random.default_rng(5)
    course_n = 0.0445 * np.array([42231.0, 206322.0, 124276.0, 124276.0, 42231.0])
    for _ in range(30):
        shaking = Vibration(rng.uniform(50.0, 900.0), rng.uniform(1.0, 60.0), 0.3)
        motion = simulate_extended(
            ExtendedValve(chosen.parameters, vibration=shaking), [0.0, 5.0, 7.5, 8.0, 10.0], course_n, [0.0, 10.0]
        )
        assert np.isfinite(motion.position_m).all()


def test_a_step_at_the_very_end_of_a_slip_leaves_the_stem_where_it_is() -> None:
    chosen = parameter_set("vendor").parameters
    valve = ExtendedValve(chosen, spring=SpringSlots(hardening_n_per_m2=4000.0))
    moving = ExtendedState(StemState(0.001, 0.01, Mode.SLIP), never_moved=False)
    motion = ExtendedStem(valve).motion(moving, np.zeros(2), np.array([100.0, 120.0]), np.zeros(1))
    assert motion.position_m.tolist() == [0.001]
    assert motion.final_state.stem.velocity_m_per_s == 0.01


@pytest.mark.parametrize("above", [1.0e-10, 4.1e-10, 1.0e-7])
def test_a_stem_that_slides_a_hair_faster_than_its_band_is_wide_takes_no_more_steps_than_another(above: float) -> None:
    """Where a fit ends at the sill of DV: a million steps of a microsecond told no more than some hundred."""
    speed = 0.01
    parameters = replace(
        NOMINAL, mass_kg=600.0, viscous_friction_n_s_per_m=12.0e3, limit_velocity_m_per_s=speed / (1.0 + above)
    )
    rate_n_per_s = parameters.spring_rate_n_per_m * speed
    valve = ExtendedValve(parameters, **NEXT_TO_NEUTRAL["on the path of filled slots"])  # type: ignore[arg-type]
    corners = np.array([0.0, 8.0]), np.array([0.0, 8.0 * rate_n_per_s])
    time_s: FloatArray = np.arange(800, dtype=np.float64) * 1.0e-2
    sensed_m, passes = ExtendedStem(valve).sensed(ExtendedState(), *corners, time_s)
    assert passes < 4000
    exact = simulate_motion(parameters, *corners, time_s)
    assert np.abs(sensed_m - exact.position_m).max() < SAME_M
