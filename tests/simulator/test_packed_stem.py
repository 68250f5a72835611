"""The stem of a valve with a packing: it agrees with the exact motion, obeys each law, and states the truth."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from simulator.packed_stem import STEP_S, PackedMotion, PackedStem, Truth
from tests.support.rough_valves import SEQUENCES, VALVES, sequence
from valve.effects import EFFECTS, Effect, ValveScale, effect_from_values, with_effects
from valve.errors import NotFoundError, ParameterError
from valve.extended_motion import simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve, StopSlots
from valve.motion import simulate_motion
from valve.packing import (
    PACKINGS,
    POINTS_A_LENGTH,
    Packing,
    RoughnessLaw,
    RoughnessTable,
    drawn_roughness,
    packing_preset,
)
from valve.stem import Mode, StemState
from valve.waveform import Waveform, multi_rate_triangle, triangle

NOMINAL, PLATE = VALVES["nominal"]
AREA_M2, TRAVEL_M = 0.06452, 0.1016
FULL_PA = 82737.0
F_C, F_S = NOMINAL.coulomb_friction_n, NOMINAL.static_friction_n


def stem_of(
    packing: Packing, valve: ExtendedValve | None = None, *, start_m: float = 0.0, seed: int = 0, **changes: Any
) -> PackedStem:
    valve = ExtendedValve(NOMINAL) if valve is None else valve
    return PackedStem(valve, packing, roughness_of(packing, valve, seed), start_m, seed=seed, **changes)


def roughness_of(packing: Packing, valve: ExtendedValve, seed: int, travel_m: float = TRAVEL_M) -> RoughnessTable:
    return drawn_roughness(packing, valve.parameters.coulomb_friction_n, travel_m, seed)


def run(
    packing: Packing,
    wave: Waveform,
    *,
    period_s: float = 1.0e-3,
    valve: ExtendedValve | None = None,
    **changes: Any,
) -> tuple[PackedMotion, Truth, np.ndarray]:
    """The motion under a waveform at even times, the truth, and those times."""
    stem = stem_of(packing, valve, **changes)
    times_s = np.arange(round(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    motion = stem.motion(wave.time_s, AREA_M2 * wave.pressure_pa, times_s)
    return motion, stem.truth(), times_s


@pytest.mark.parametrize(
    ("name", "sequence_name"),
    [
        pytest.param(
            name, one, marks=pytest.mark.long if one == "multi_rate" and name not in {"nominal", "small"} else ()
        )
        for name in VALVES
        for one in SEQUENCES
    ],
)
def test_an_ideal_packing_moves_as_the_exact_motion_does_to_a_micrometre_and_nearer_with_a_shorter_step(
    name: str, sequence_name: str
) -> None:
    parameters, nameplate = VALVES[name]
    area_m2, wave = nameplate.actuator.diaphragm_area_m2, sequence(sequence_name, nameplate)
    assert area_m2 is not None
    times_s = np.arange(math.floor(wave.duration_s / 1.0e-3) + 1, dtype=np.float64) * 1.0e-3
    force_n = area_m2 * wave.pressure_pa
    start_m = (force_n[0] - parameters.preload_n) / parameters.spring_rate_n_per_m
    exact = simulate_motion(parameters, wave.time_s, force_n, times_s, initial=StemState(start_m))

    def error_m(step_s: float) -> float:
        stem = stem_of(Packing(), ExtendedValve(parameters), start_m=start_m, step_s=step_s)
        motion = stem.motion(wave.time_s, force_n, times_s)
        assert stem.truth().breakaways_s.size == len(exact.events.times_of(Mode.BAND))
        return float(np.abs(motion.position_m - exact.position_m).max())

    assert error_m(STEP_S) < 1.0e-6
    if name == "nominal":
        # of second order, and nothing left in the end
        assert error_m(STEP_S / 4.0) < 0.15 * error_m(STEP_S) + 1.0e-9


_COURSE = Waveform("course", np.array([0.0, 3.0, 6.0, 9.0]), FULL_PA * np.array([0.0, 1.0, 0.2, 0.6]))
_COURSE_S = np.arange(9001, dtype=np.float64) * 1.0e-3


@cache
def _bare_motion() -> PackedMotion:
    return stem_of(Packing()).motion(_COURSE.time_s, AREA_M2 * _COURSE.pressure_pa, _COURSE_S)


@pytest.mark.parametrize("cause", EFFECTS)
def test_an_effect_acts_in_a_packed_stem_as_in_the_extended_motion(cause: str) -> None:
    scale = ValveScale.of(NOMINAL, TRAVEL_M, AREA_M2 * FULL_PA)
    hidden: Effect = EFFECTS[cause].of_strength(2.0, scale)
    valve = with_effects(ExtendedValve(NOMINAL), [hidden])
    wave, times_s = _COURSE, _COURSE_S
    force_n = AREA_M2 * wave.pressure_pa
    start = ExtendedState(StemState(max(valve.stops.low_m, 0.0)))
    expected = simulate_extended(valve, wave.time_s, force_n, times_s, initial=start, command=False)
    stem = stem_of(Packing(), valve, start_m=start.stem.position_m)
    motion = stem.motion(wave.time_s, force_n, times_s)
    bare = _bare_motion()
    # bristles carry no inertia there, and here yield in steps; friction that falls with speed makes a slip's start slow
    limit_m = {"presliding": 2.0e-5, "stribeck_friction": 6.0e-5}.get(cause, 5.0e-6)
    assert np.abs(motion.position_m - expected.position_m).max() < limit_m
    assert np.abs(motion.sensed_m - expected.sensed_m).max() < limit_m
    of_the_input = cause in {"transducer_lag", "transducer_dead_time", "supply_saturation", "actuator_leak"}
    if not of_the_input and cause != "travel_stop_high":
        assert np.abs(motion.sensed_m - bare.sensed_m).max() > 2.0e-5


def test_a_breakaway_needs_another_force_each_time_with_the_scatter_that_was_asked_for() -> None:
    wave = multi_rate_triangle([1.0] * 400, 0.0, FULL_PA)
    _, truth, _ = run(Packing(breakaway_scatter=0.04), wave, period_s=0.1)
    forces_n = np.abs(truth.breakaways_n)
    assert forces_n.size == 800
    assert forces_n.mean() == pytest.approx(truth.parameters.static_friction_n, abs=4.0 * 0.04 * F_S / math.sqrt(800))
    assert forces_n.std() == pytest.approx(0.04 * F_S, rel=0.1)
    assert truth.static_scatter_n == pytest.approx(0.04 * F_S, rel=0.02)
    assert abs(np.corrcoef(forces_n[1:], forces_n[:-1])[0, 1]) < 0.12
    assert abs(np.corrcoef(forces_n[::2], forces_n[1::2])[0, 1]) < 0.16


def test_a_resting_stem_needs_another_force_when_the_load_turns_over_and_the_same_while_it_stays() -> None:
    most_n = 0.97 * F_S  # with a scatter of 5 % a breakaway needs less in one of four
    corner_s = np.arange(21, dtype=np.float64)
    to_and_fro_n = most_n * np.where(np.arange(21) % 2 == 0, 0.0, np.where(np.arange(21) % 4 == 1, 1.0, -1.0))
    one_way_n = np.abs(to_and_fro_n)

    def freed(force_n: np.ndarray) -> int:
        count = 0
        for seed in range(40):
            stem = stem_of(Packing(breakaway_scatter=0.05), seed=seed)
            stem.advance(corner_s, force_n)
            count += stem.truth().breakaways_s.size > 0
        return count

    assert freed(to_and_fro_n) > 32
    assert 4 <= freed(one_way_n) <= 18


def test_a_scatter_below_what_motion_needs_raises_the_mean_breakaway_and_the_truth_says_so() -> None:
    vendor = VALVES["vendor"][0]  # its F_s is its F_c
    wave = multi_rate_triangle([0.5] * 300, 0.0, 0.3 * FULL_PA)
    _, truth, _ = run(Packing(breakaway_scatter=0.05), wave, period_s=0.1, valve=ExtendedValve(vendor))
    forces_n = np.abs(truth.breakaways_n)
    expected_n = vendor.static_friction_n * (1.0 + 0.05 / math.sqrt(2.0 * math.pi))
    assert truth.parameters.static_friction_n == pytest.approx(expected_n, rel=1.0e-6)
    assert forces_n.size == 600
    assert forces_n.mean() == pytest.approx(expected_n, abs=0.2)
    assert forces_n.min() >= vendor.coulomb_friction_n * (1.0 - 1.0e-9)


@pytest.mark.parametrize("law", RoughnessLaw)
def test_the_roughness_has_its_size_its_length_and_its_common_part(law: RoughnessLaw) -> None:
    packing = Packing(roughness=0.02, roughness_length=0.01, roughness_common=0.36, roughness_law=law)
    tables = [drawn_roughness(packing, 1000.0, 1.0, seed) for seed in range(300)]
    opening = np.array([table.opening_n for table in tables])
    closing = np.array([table.closing_n for table in tables])
    assert opening.std() == pytest.approx(20.0, rel=0.03)
    assert closing.std() == pytest.approx(20.0, rel=0.03)
    assert abs(opening.mean()) < 0.3
    assert np.mean(opening * closing) / 400.0 == pytest.approx(0.36, abs=0.03)
    alike = np.mean(opening[:, POINTS_A_LENGTH:] * opening[:, :-POINTS_A_LENGTH]) / 400.0
    at_a_length = {
        RoughnessLaw.MATERN: (1.0 + math.sqrt(3.0)) * math.exp(-math.sqrt(3.0)),
        RoughnessLaw.SMOOTH: math.exp(-0.5),
        RoughnessLaw.ROUGH: math.exp(-1.0),
    }[law]
    assert alike == pytest.approx(at_a_length, abs=0.03)
    far = 12 * POINTS_A_LENGTH
    assert abs(np.mean(opening[:, far:] * opening[:, :-far])) / 400.0 < 0.03
    table = tables[0]
    assert table.places_m[0] == pytest.approx(-0.15)
    assert table.places_m[-1] >= 1.15
    assert table.step_m == pytest.approx(0.01 / POINTS_A_LENGTH)


def test_a_stem_meets_the_roughness_of_its_place_and_direction() -> None:
    packing = Packing(roughness=0.03, roughness_length=0.02)
    stem = stem_of(packing, seed=5)
    wave = triangle(20.0, 1, 0.0, FULL_PA)
    times_s = np.arange(20001, dtype=np.float64) * 1.0e-3
    motion = stem.motion(wave.time_s, AREA_M2 * wave.pressure_pa, times_s)
    # quasi-statically net force less viscous friction is friction: measured on the motion, not read from the table
    force_n = AREA_M2 * wave.at(times_s)
    slid = (np.abs(motion.velocity_m_per_s) > 5.0e-3) & (motion.mode == Mode.SLIP)
    slid[1:-1] &= np.abs(np.diff(motion.velocity_m_per_s, 2)) < 1.0e-4
    friction_n = force_n - NOMINAL.spring_rate_n_per_m * motion.position_m
    friction_n -= NOMINAL.viscous_friction_n_s_per_m * motion.velocity_m_per_s
    friction_n -= NOMINAL.mass_kg * np.gradient(motion.velocity_m_per_s, 1.0e-3)
    table = roughness_of(packing, ExtendedValve(NOMINAL), 5)
    for heading, values in ((1.0, table.opening_n), (-1.0, table.closing_n)):
        rows = slid & (np.sign(motion.velocity_m_per_s) == heading)
        expected_n = heading * (F_C + np.interp(motion.position_m[rows], table.places_m, values))
        assert np.count_nonzero(rows) > 3000
        assert np.median(np.abs(friction_n[rows] - expected_n)) < 0.5
        assert np.std(expected_n) > 20.0


def test_friction_wanders_in_time_as_an_ornstein_uhlenbeck_process() -> None:
    stem = stem_of(Packing(wander=0.01, wander_time_s=5.0), seed=3)
    every_s = 1.0
    times_s = np.arange(40_000, dtype=np.float64) * every_s
    motion = stem.motion(np.array([0.0, times_s[-1]]), np.zeros(2), times_s)
    wander = motion.friction_n / F_C - 1.0
    assert wander.std() == pytest.approx(0.01, rel=0.06)
    assert abs(wander.mean()) < 4.0e-4
    for late in (1, 5, 10):
        alike = np.mean(wander[late:] * wander[:-late]) / wander.var()
        assert alike == pytest.approx(math.exp(-late * every_s / 5.0), abs=0.05)
    truth = stem.truth()
    assert truth.parameters.coulomb_friction_n == pytest.approx(F_C * (1.0 + wander.mean()), rel=2.0e-4)
    assert truth.coulomb_spread_n == pytest.approx(F_C * wander.std(), rel=0.02)


def test_the_first_breakaway_after_long_is_harder_and_a_short_rest_hardly() -> None:
    wave = triangle(20.0, 2, 0.0, FULL_PA)
    _, truth, _ = run(Packing(first_rise=0.3, first_rise_time_s=3600.0), wave)
    forces_n = np.abs(truth.breakaways_n)
    assert forces_n[0] == pytest.approx(1.3 * F_S, rel=1.0e-6)
    assert forces_n[1:] == pytest.approx(F_S, rel=1.0e-3)
    assert truth.parameters.static_friction_n == pytest.approx(F_S)
    stem = stem_of(Packing(first_rise=0.3, first_rise_time_s=3600.0))
    force_n = AREA_M2 * wave.pressure_pa
    stem.advance(wave.time_s, force_n)
    stem.advance(np.array([0.0, 3600.0]), np.zeros(2))
    stem.begin_record()
    stem.advance(wave.time_s, force_n)
    assert abs(stem.truth().breakaways_n[0]) == pytest.approx(1.15 * F_S, rel=1.0e-3)


@pytest.mark.parametrize("name", ["nominal", "graphite", "large"])
def test_the_truth_is_the_average_of_the_friction_that_was_applied(name: str) -> None:
    parameters, nameplate = VALVES[name]
    area_m2, wave = nameplate.actuator.diaphragm_area_m2, sequence("triangle", nameplate)
    assert area_m2 is not None
    travel_m, force_n = nameplate.actuator.travel_m, area_m2 * wave.pressure_pa
    packing = Packing(roughness=0.04, roughness_length=0.03, roughness_common=0.3)
    times_s = np.arange(0, round(wave.duration_s / 1.0e-3) + 1, dtype=np.float64) * 1.0e-3
    for seed in range(4):
        table = roughness_of(packing, ExtendedValve(parameters), seed, travel_m)
        stem = PackedStem(ExtendedValve(parameters), packing, table, 0.0, seed=seed)
        motion, truth = stem.motion(wave.time_s, force_n, times_s), stem.truth()
        way_m = np.diff(motion.position_m)
        between_n = 0.5 * (motion.friction_n[1:] + motion.friction_n[:-1])
        opening_n, closing_n = (
            float(np.sum(between_n[rows] * way_m[rows]) / np.sum(way_m[rows])) for rows in (way_m > 0.0, way_m < 0.0)
        )
        # the stroke from the first start is longer than the others: a part of the average is weighed otherwise
        limit_n = 0.006 * parameters.coulomb_friction_n
        applied_n = 0.5 * (opening_n - closing_n)
        assert truth.parameters.coulomb_friction_n == pytest.approx(applied_n, abs=limit_n)
        assert truth.parameters.preload_n - parameters.preload_n == pytest.approx(
            0.5 * (opening_n + closing_n), abs=limit_n
        )
        (low_m, high_m), _ = truth.swept_m
        assert low_m == pytest.approx(motion.position_m.min(), abs=1.0e-5)
        assert high_m == pytest.approx(motion.position_m.max(), abs=1.0e-5)
        fine_m = np.linspace(low_m, high_m, 100_001)
        up_n = float(np.interp(fine_m, table.places_m, table.opening_n).mean())
        assert table.mean_n(low_m, high_m, opening=True) == pytest.approx(up_n, abs=1.0e-3 * abs(up_n) + 1.0e-3)
        rough_n = np.concatenate(
            [between_n[rows] * side - applied_n for rows, side in ((way_m > 0.0, 1.0), (way_m < 0.0, -1.0))]
        )
        half_n = 0.5 * (opening_n + closing_n)
        rough_n += np.repeat((-half_n, half_n), (np.count_nonzero(way_m > 0.0), np.count_nonzero(way_m < 0.0)))
        assert truth.coulomb_spread_n == pytest.approx(float(np.std(rough_n)), rel=0.2)


def test_the_mean_force_of_many_breakaways_is_the_truth_with_all_laws_together() -> None:
    # holds at many levels, so that the stem breaks away at places all over its travel
    rng = np.random.default_rng(8)
    levels_pa = rng.uniform(0.0, FULL_PA, 1500)
    wave = Waveform("steps", np.arange(levels_pa.size, dtype=np.float64) * 1.0, levels_pa)
    packing = Packing(breakaway_scatter=0.05, roughness=0.05, roughness_length=0.05, wander=0.01)
    _, truth, _ = run(packing, wave, period_s=1.0, seed=11)
    opening = truth.breakaways_n > 0.0
    assert min(np.count_nonzero(opening), np.count_nonzero(~opening)) > 200
    spread_n = np.abs(truth.breakaways_n).std()
    assert spread_n == pytest.approx(truth.static_spread_n, rel=0.12)
    made_n = 0.5 * (truth.breakaways_n[opening].mean() - truth.breakaways_n[~opening].mean())
    assert made_n == pytest.approx(truth.parameters.static_friction_n, abs=4.0 * spread_n / math.sqrt(opening.size))


def test_what_the_actuator_gives_is_stored_in_the_spring_or_lost_to_friction() -> None:
    packing = replace(PACKINGS["hard"], roughness_length=0.01)
    stem = stem_of(packing, seed=2)
    wave = triangle(6.0, 1, 0.0, FULL_PA)
    times_s = np.arange(60_001, dtype=np.float64) * 1.0e-4
    motion = stem.motion(wave.time_s, AREA_M2 * wave.pressure_pa, times_s)
    x, v, force_n = motion.position_m, motion.velocity_m_per_s, AREA_M2 * wave.at(times_s)
    way_m = np.diff(x)
    given_j = np.cumsum(0.5 * (force_n[1:] + force_n[:-1]) * way_m)
    stored_j = 0.5 * NOMINAL.spring_rate_n_per_m * x[1:] ** 2 + 0.5 * NOMINAL.mass_kg * v[1:] ** 2
    rubbed_j = np.cumsum(0.5 * (motion.friction_n[1:] + motion.friction_n[:-1]) * way_m)
    damped_j = np.cumsum(NOMINAL.viscous_friction_n_s_per_m * 0.5 * (v[1:] ** 2 + v[:-1] ** 2) * 1.0e-4)
    left_j = given_j - stored_j - rubbed_j - damped_j
    assert given_j.max() > 100.0
    assert np.abs(left_j).max() < 2.0e-3 * given_j.max()


def test_a_stem_at_rest_holds_still_below_its_breakaway_and_moves_at_it() -> None:
    motion, truth, times_s = run(PACKINGS["hard"], triangle(20.0, 2, 0.0, FULL_PA), seed=9)
    held = motion.mode == Mode.STUCK
    both = held[1:] & held[:-1]
    assert np.all(np.diff(motion.position_m)[both] == 0.0)
    for begin_s, place_m, level_n in zip(truth.breakaways_s, truth.breakaways_m, truth.breakaways_n, strict=True):
        net_n = AREA_M2 * float(triangle(20.0, 2, 0.0, FULL_PA).at(begin_s)) - NOMINAL.spring_rate_n_per_m * place_m
        assert net_n == pytest.approx(level_n, rel=1.0e-6)
        before = int(np.searchsorted(times_s, begin_s)) - 1
        assert motion.position_m[before] == pytest.approx(place_m, abs=1.0e-12)
        assert (motion.position_m[before + 40] - place_m) * np.sign(level_n) > 1.0e-4
    # each rest follows a breakaway
    assert np.all(truth.rests_s > truth.breakaways_s[: truth.rests_s.size])
    assert np.all(truth.breakaways_s[1:] > truth.rests_s[: truth.breakaways_s.size - 1])


def test_a_rigid_stop_ends_the_way_of_a_packed_stem() -> None:
    valve = ExtendedValve(NOMINAL, stops=StopSlots(0.0, 0.05))
    motion, _, _ = run(PACKINGS["usual"], triangle(20.0, 1, 0.0, FULL_PA), valve=valve)
    assert motion.position_m.max() == 0.05
    assert (motion.mode[motion.position_m == 0.05] == Mode.STOPPED).all()
    assert motion.position_m[-1] < 0.05


def test_bristles_pressed_onto_a_stop_are_held_by_it_and_come_off_again() -> None:
    hidden = effect_from_values("presliding", {"deflection_m": 1.0e-4})
    valve = with_effects(ExtendedValve(NOMINAL, stops=StopSlots(0.0, 0.05)), [hidden])
    wave = triangle(4.0, 2, 0.0, FULL_PA)
    motion, _, _ = run(PACKINGS["mild"], wave, valve=valve)
    assert motion.position_m.max() == 0.05
    assert motion.position_m[-1] < 0.05 - 1.0e-3


def test_the_same_seed_gives_the_same_stem_however_often_it_is_looked_at() -> None:
    wave = triangle(8.0, 1, 0.0, FULL_PA)
    force_n, times_s = AREA_M2 * wave.pressure_pa, np.arange(8001, dtype=np.float64) * 1.0e-3
    once = stem_of(PACKINGS["usual"], seed=4, filter_s=0.01).motion(wave.time_s, force_n, times_s)
    stem = stem_of(PACKINGS["usual"], seed=4, filter_s=0.01)
    positions_m, edges_s = [0.0], np.unique(np.append(np.random.default_rng(1).uniform(0.0, 8.0, 60), [0.0, 4.0, 8.0]))
    for from_s, to_s in itertools.pairwise(edges_s):
        ends_n = AREA_M2 * wave.at(np.array([from_s, to_s]))
        wanted_s = times_s[(times_s > from_s) & (times_s <= to_s)] - from_s
        found = stem.motion(np.array([0.0, to_s - from_s]), ends_n, np.clip(wanted_s, 0.0, to_s - from_s))
        positions_m += found.position_m.tolist()
    assert np.abs(np.array(positions_m) - once.position_m).max() < 1.0e-6
    other = stem_of(PACKINGS["usual"], seed=5, filter_s=0.01).motion(wave.time_s, force_n, times_s)
    assert np.abs(other.position_m - once.position_m).max() > 1.0e-4


def test_the_filter_of_a_sensor_follows_the_stem_with_its_time_constant() -> None:
    wave = triangle(8.0, 1, 0.0, FULL_PA)
    bare, _, _ = run(Packing(), wave)
    shown, _, _ = run(Packing(), wave, filter_s=0.02)
    assert np.array_equal(bare.sensed_m, bare.position_m)
    expected = np.empty_like(shown.position_m)
    expected[0] = value = shown.position_m[0]
    keep, step_s = math.exp(-1.0e-3 / 0.02), 1.0e-3
    for row in range(1, expected.size):
        slope = (shown.position_m[row] - shown.position_m[row - 1]) / step_s * 0.02
        value = shown.position_m[row] - slope + (value - shown.position_m[row - 1] + slope) * keep
        expected[row] = value
    assert np.abs(shown.sensed_m - expected).max() < 2.0e-6
    assert np.abs(shown.sensed_m - shown.position_m).max() > 1.0e-4


def test_a_jammed_stem_stays_where_it_is() -> None:
    stem = stem_of(PACKINGS["usual"], seed=1, filter_s=0.05)
    stem.advance(np.array([0.0, 4.0]), np.array([0.0, 4000.0]))
    before_m = stem.state.position_m
    true_m, sensed_m = stem.hold(2.0, np.array([0.1, 1.0, 2.0]))
    assert (true_m == before_m).all()
    assert sensed_m[-1] == pytest.approx(before_m, abs=1.0e-9)
    stem.advance(np.array([0.0, 1.0]), np.array([4000.0, 5300.0]))
    assert stem.state.position_m > before_m


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"breakaway_scatter": -0.1}, "breakaway_scatter"),
        ({"roughness": math.nan}, "roughness"),
        ({"roughness_length": 0.0}, "roughness_length"),
        ({"roughness_common": 1.1}, "roughness_common"),
        ({"roughness_law": "spiky"}, "roughness_law"),
        ({"wander_time_s": 0.0}, "wander_time_s"),
    ],
)
def test_a_packing_that_cannot_be_is_refused(values: dict[str, Any], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        Packing(**values)


def test_presets_grow_from_ideal_to_hard() -> None:
    assert list(PACKINGS) == ["ideal", "mild", "usual", "hard"]
    assert packing_preset("ideal").is_ideal
    for name in ("breakaway_scatter", "roughness", "wander"):
        sizes = [getattr(packing, name) for packing in PACKINGS.values()]
        assert sizes == sorted(sizes)
        assert len(set(sizes)) == 4
    with pytest.raises(NotFoundError, match="usual"):
        packing_preset("normal")
