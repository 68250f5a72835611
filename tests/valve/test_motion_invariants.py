"""What must hold for every motion, whatever the valve: balances, limits, restarts, symmetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.valve.random_valves import DURATION_S, KINDS, RandomValve, random_valve, random_valves
from valve.errors import MotionError
from valve.motion import Mode, Motion, StemIntegrator, StemState, simulate_batch, simulate_motion
from valve.parameter_sets import PARAMETER_SETS
from valve.parameters import TravelStops, ValveParameters
from valve.waveform import triangle

EVEN_S: npt.NDArray[np.float64] = np.arange(501, dtype=np.float64) * 1.0e-3
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def motion_of(valve: RandomValve, output_time_s: npt.NDArray[np.float64] = EVEN_S) -> Motion:
    return simulate_motion(valve.parameters, valve.force_time_s, valve.force_n, output_time_s, stops=valve.stops)


@pytest.mark.parametrize("kind", KINDS)
def test_momentum_balances_to_rounding_inside_each_mode(kind: str) -> None:
    checked = 0
    for seed in range(100, 106):
        valve = random_valve(kind, seed)
        p = valve.parameters
        edges = np.linspace(0.0, DURATION_S, 2001)
        half = np.diff(edges)[:, None] / 2.0
        nodes = (edges[:-1, None] + half + half * NODES).ravel()
        motion = motion_of(valve, np.sort(np.concatenate((edges, nodes))))
        x = motion_of(valve, nodes).position_m.reshape(-1, NODES.size)
        ends = motion_of(valve, edges)
        # an interval counts if no event and no corner of the force falls into it
        cuts = np.concatenate((motion.events.time_s, valve.force_time_s))
        whole = np.histogram(cuts, edges)[0] == 0
        friction = np.select(
            [ends.mode == Mode.SLIP, ends.mode == Mode.BAND],
            [
                p.coulomb_friction_n * np.sign(ends.velocity_m_per_s),
                p.static_friction_n * np.sign(ends.force_n - p.spring_rate_n_per_m * ends.position_m - p.preload_n),
            ],
            np.nan,
        )[:-1]
        moving = whole & np.isfinite(friction)
        F_v = np.where(ends.mode[:-1] == Mode.SLIP, p.viscous_friction_n_s_per_m, 0.0)
        span = np.diff(edges)
        middle_n = (ends.force_n[:-1] + ends.force_n[1:]) / 2.0
        impulse = (middle_n - p.preload_n - friction) * span
        impulse -= p.spring_rate_n_per_m * (x * WEIGHTS * half).sum(axis=1)
        impulse -= F_v * np.diff(ends.position_m)
        change = p.mass_kg * np.diff(ends.velocity_m_per_s)
        size = np.abs(middle_n).max() * span + p.mass_kg * np.abs(ends.velocity_m_per_s).max()
        size += F_v * np.abs(ends.position_m).max()
        # a steep force is known no better than the time at which it is read
        allowed = 1.0e-14 * size + 1.0e-15 * np.abs(np.diff(ends.force_n))
        assert np.all(np.abs(change - impulse)[moving] <= allowed[moving])
        checked += int(np.count_nonzero(moving))
    assert checked > 100


@pytest.mark.parametrize("kind", KINDS)
def test_each_mode_keeps_to_its_own_region(kind: str) -> None:
    for seed in range(200, 215):
        valve = random_valve(kind, seed)
        p = valve.parameters
        motion = motion_of(valve, np.arange(3001, dtype=np.float64) * (DURATION_S / 3000.0))
        net_n = motion.force_n - p.spring_rate_n_per_m * motion.position_m - p.preload_n
        speed, DV, F_s = np.abs(motion.velocity_m_per_s), p.limit_velocity_m_per_s, p.static_friction_n
        at = {mode: motion.mode == mode for mode in Mode}
        assert np.all(np.abs(net_n[at[Mode.STUCK]]) <= F_s * (1.0 + 1.0e-9))
        assert np.all(motion.velocity_m_per_s[at[Mode.STUCK] | at[Mode.STOPPED]] == 0.0)
        assert np.all(np.diff(motion.position_m)[at[Mode.STUCK][:-1] & at[Mode.STUCK][1:] & _quiet(motion)] == 0.0)
        assert np.all(speed[at[Mode.BAND]] <= DV * (1.0 + 1.0e-9))
        assert np.all(np.abs(net_n[at[Mode.BAND]]) >= F_s * (1.0 - 1.0e-9))
        assert np.all(speed[at[Mode.SLIP]] >= DV * (1.0 - 1.0e-9))
        assert np.all(speed[at[Mode.SLIDE]] == DV)
        assert motion.position_m.min() >= valve.stops.low_m
        assert motion.position_m.max() <= valve.stops.high_m
        stopped_m = motion.position_m[at[Mode.STOPPED]]
        assert np.all((stopped_m == valve.stops.low_m) | (stopped_m == valve.stops.high_m))


def _quiet(motion: Motion) -> npt.NDArray[np.bool_]:
    """True for each output interval without an event."""
    return np.asarray(np.histogram(motion.events.time_s, motion.time_s)[0] == 0)


@pytest.mark.parametrize("kind", KINDS)
def test_two_halves_make_the_whole(kind: str) -> None:
    rng = np.random.default_rng(3)
    for seed in range(300, 320):
        valve = random_valve(kind, seed)
        whole = motion_of(valve)
        cut = int(rng.integers(1, EVEN_S.size - 1))
        first = motion_of(valve, EVEN_S[: cut + 1])
        at_cut_n = float(whole.force_n[cut])
        later = valve.force_time_s > EVEN_S[cut]
        second = simulate_motion(
            valve.parameters,
            np.concatenate(([EVEN_S[cut]], valve.force_time_s[later])),
            np.concatenate(([at_cut_n], valve.force_n[later])),
            EVEN_S[cut:],
            stops=valve.stops,
            initial=first.final_state,
        )
        joined_m = np.concatenate((first.position_m, second.position_m[1:]))
        assert np.abs(joined_m - whole.position_m).max() <= 1.0e-12
        assert len(first.events) + len(second.events) == len(whole.events)


@pytest.mark.parametrize("name", sorted(PARAMETER_SETS))
def test_millisecond_by_millisecond_equals_one_run(name: str) -> None:
    chosen = PARAMETER_SETS[name]
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    waveform = triangle(2.0, 1, *signal.range_pa)
    time_s = np.arange(2001) * 1.0e-3
    whole = simulate_motion(chosen.parameters, waveform.time_s, area_m2 * waveform.pressure_pa, time_s)
    stem, state = StemIntegrator(chosen.parameters), StemState()
    visited = [state]
    for i in range(2000):
        state = stem.ramp(state, time_s[i + 1] - time_s[i], whole.force_n[i], whole.force_n[i + 1])
        visited.append(state)
    assert np.abs([s.position_m for s in visited] - whole.position_m).max() <= 1.0e-12
    assert np.abs([s.velocity_m_per_s for s in visited] - whole.velocity_m_per_s).max() <= 1.0e-9
    assert [s.mode for s in visited[10::10]] == whole.mode[10::10].tolist()


@pytest.mark.parametrize("name", sorted(PARAMETER_SETS))
def test_first_order_hold_of_a_sampled_force_equals_its_corners(name: str) -> None:
    chosen = PARAMETER_SETS[name]
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    waveform = triangle(20.0, 3, *signal.range_pa)
    time_s = np.arange(60001) * 1.0e-3
    corners = simulate_motion(chosen.parameters, waveform.time_s, area_m2 * waveform.pressure_pa, time_s)
    sampled = simulate_motion(chosen.parameters, time_s, corners.force_n, time_s)
    assert np.abs(sampled.position_m - corners.position_m).max() <= 1.0e-14
    assert len(sampled.events) == len(corners.events)
    assert np.abs(sampled.events.time_s - corners.events.time_s).max() <= 1.0e-9


def test_periods_that_differ_by_less_than_a_picosecond_are_kept_apart() -> None:
    # without a spring nothing draws a lost instant back: 1e4 of 5e-13 s each would be 5e-9 m
    coasting = ValveParameters(2.0, 0.0, 10.0, 1.0, 1.0, 1.0e-3)
    periods_s = 1.0e-3 * (1.0 + 5.0e-10 * (np.arange(10_000) % 2))
    time_s = np.concatenate(([0.0], np.cumsum(periods_s)))
    corners = simulate_motion(coasting, [0.0, 20.0], [11.0, 11.0], time_s)
    sampled = simulate_motion(coasting, time_s, corners.force_n, time_s)
    assert sampled.position_m[-1] == pytest.approx(9.8, rel=0.01)
    assert np.abs(sampled.position_m - corners.position_m).max() < 1.0e-12


def test_the_motion_does_not_depend_on_where_it_is_looked_at() -> None:
    rng = np.random.default_rng(4)
    for valve in random_valves(5, first_seed=400):
        even = motion_of(valve)
        uneven_s = np.sort(np.concatenate((EVEN_S, rng.uniform(0.0, DURATION_S, 700), EVEN_S[100:110])))
        uneven = motion_of(valve, uneven_s)
        places = np.searchsorted(uneven_s, EVEN_S, side="right") - 1
        allowed_m = 1.0e-15 * (1.0 + np.abs(even.position_m).max() + np.abs(even.velocity_m_per_s).max())
        assert np.abs(uneven.position_m[places] - even.position_m).max() <= allowed_m
        assert np.array_equal(uneven.events.time_s, even.events.time_s)
        coarse = motion_of(valve, np.array([0.0, 0.0, DURATION_S]))
        assert coarse.position_m[-1] == pytest.approx(even.position_m[-1], abs=allowed_m)


def test_a_mirrored_force_gives_the_mirrored_motion_to_the_last_bit() -> None:
    for valve in random_valves(5, first_seed=500):
        mirrored = simulate_motion(
            replace(valve.parameters, preload_n=-valve.parameters.preload_n),
            valve.force_time_s,
            -valve.force_n,
            EVEN_S,
            stops=TravelStops(-valve.stops.high_m, -valve.stops.low_m),
        )
        motion = motion_of(valve)
        assert np.array_equal(mirrored.position_m, -motion.position_m)
        assert np.array_equal(mirrored.velocity_m_per_s, -motion.velocity_m_per_s)
        assert np.array_equal(mirrored.mode, motion.mode)
        assert np.array_equal(mirrored.events.time_s, motion.events.time_s)


def test_events_alone_and_batches_equal_the_single_motions() -> None:
    valves = [v for v in random_valves(3, first_seed=600) if v.force_time_s.size == 6]
    shared_time_s = valves[0].force_time_s
    forces_n = np.array([v.force_n for v in valves])
    batch = simulate_batch(
        [v.parameters for v in valves],
        shared_time_s,
        forces_n,
        EVEN_S,
        velocities=True,
        stops=[v.stops for v in valves],
    )
    assert batch.velocity_m_per_s is not None
    for i, valve in enumerate(valves):
        single = simulate_motion(valve.parameters, shared_time_s, valve.force_n, EVEN_S, stops=valve.stops)
        assert np.array_equal(batch.position_m[i], single.position_m)
        assert np.array_equal(batch.velocity_m_per_s[i], single.velocity_m_per_s)
        assert batch.final_states[i] == single.final_state
        events, final = StemIntegrator(valve.parameters, valve.stops).events(StemState(), shared_time_s, valve.force_n)
        assert np.array_equal(events.time_s, single.events.time_s)
        assert np.array_equal(events.mode, single.events.mode)
        assert final == single.final_state


def test_extreme_valves_neither_hang_nor_lose_a_number_nor_turn_time_back() -> None:
    """1500 valves far outside any actuator, with forces that sit exactly on the edges between the modes."""
    rng = np.random.default_rng(5)
    followed = 0
    for _ in range(1500):
        m, k = 10.0 ** rng.uniform(-2.0, 2.0), rng.choice([0.0, 10.0 ** rng.uniform(-6.0, 7.0)])
        critical = 2.0 * np.sqrt(k * m)
        F_v = rng.choice([0.0, 10.0 ** rng.uniform(-3.0, 6.0), critical, critical * (1.0 + 1.0e-9)])
        F_c = rng.choice([0.0, 10.0 ** rng.uniform(-3.0, 4.0)])
        F_s = F_c * rng.choice([1.0, 1.0 + 10.0 ** rng.uniform(-12.0, 0.0)])
        DV, span_s, n = 10.0 ** rng.uniform(-8.0, 0.0), 10.0 ** rng.uniform(-2.0, 1.0), int(rng.choice([2, 6, 100]))
        force_time_s = np.sort(np.round(rng.uniform(0.0, span_s, n), 2))  # some fall together: steps
        forces_n = (
            rng.normal(size=n) * 10.0 ** rng.uniform(-2.0, 4.0),
            np.round(rng.normal(size=n)) * F_s,  # on the edge of breakaway
            np.cumsum(np.full(n, k * DV * span_s / n)),  # at the limit velocity
            np.full(n, 1.5 * F_s),
        )
        stops = TravelStops(-0.01, 0.02) if rng.random() < 0.5 else None
        initial = StemState(rng.choice([0.0, -0.01, 0.02]), rng.choice([0.0, DV, -DV, 0.1]))
        output_s = np.linspace(force_time_s[0], force_time_s[-1] + 0.1, 300)
        parameters = ValveParameters(m, k, F_v, F_c, F_s, DV)
        try:
            motion = simulate_motion(
                parameters,
                force_time_s,
                forces_n[rng.integers(4)],
                output_s.astype(np.float64),
                stops=stops,
                initial=initial,
                most_events=20_000,
            )
        except MotionError:
            continue  # thousands of oscillations a second: the cap is the answer
        followed += 1
        assert np.isfinite(motion.position_m).all()
        assert np.isfinite(motion.velocity_m_per_s).all()
        assert np.all(np.diff(motion.events.time_s) >= 0.0)
        if stops is not None:
            assert motion.position_m.min() >= stops.low_m
            assert motion.position_m.max() <= stops.high_m
    assert followed > 1450
