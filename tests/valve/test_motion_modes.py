"""Each mode, its beginning and its end, on cases that can be worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valve.motion import Mode, Motion, StemState, simulate_motion
from valve.parameters import TravelStops, ValveParameters

# m, k, F_v, F_c, F_s, DV
STICKY = ValveParameters(2.0, 5.0e4, 300.0, 400.0, 600.0, 1.0e-3)
VISCOUS = ValveParameters(2.0, 5.0e4, 3.0e5, 400.0, 450.0, 1.0e-3)  # F_c + F_v DV = 700 > F_s: it can slide
LOOSE = ValveParameters(2.0, 0.0, 0.0, 400.0, 600.0, 1.0e-3)


def modes_of(motion: Motion) -> list[Mode]:
    return [Mode(mode) for mode in motion.events.mode]


def test_the_stem_breaks_away_when_the_net_force_passes_static_friction() -> None:
    motion = simulate_motion(STICKY, [0.0, 1.0], [0.0, 1000.0], np.linspace(0.0, 0.65, 66))
    assert motion.events.times_of(Mode.BAND)[0] == pytest.approx(0.6, rel=1.0e-14)
    assert motion.position_m[motion.time_s < 0.6].max() == 0.0
    assert motion.mode[0] == Mode.STUCK
    assert motion.force_n == pytest.approx(1000.0 * motion.time_s)


def test_the_band_accelerates_by_the_excess_over_static_friction() -> None:
    # m v' = (F - F_s) with the spring: v = rate/k (1 - cos w0 t), from the breakaway at 0.6 s
    w0, rate = math.sqrt(5.0e4 / 2.0), 1000.0
    motion = simulate_motion(STICKY, [0.0, 1.0], [0.0, rate], np.linspace(0.6, 0.602, 50), initial=None)
    since = motion.time_s - 0.6
    band = motion.mode == Mode.BAND
    assert np.count_nonzero(band) > 20
    expected = rate / 5.0e4 * (1.0 - np.cos(w0 * since))
    assert motion.velocity_m_per_s[band] == pytest.approx(expected[band], abs=1.0e-13)


def test_a_preload_shifts_the_breakaway_by_itself() -> None:
    loaded = ValveParameters(2.0, 5.0e4, 300.0, 400.0, 600.0, 1.0e-3, preload_n=250.0)
    motion = simulate_motion(loaded, [0.0, 1.0], [0.0, 1000.0], [0.0, 1.0])
    assert motion.events.times_of(Mode.BAND)[0] == pytest.approx(0.85, rel=1.0e-14)


def test_without_spring_and_damping_a_constant_force_gives_parabolas() -> None:
    motion = simulate_motion(LOOSE, [0.0], [1000.0], np.linspace(0.0, 2.0, 201))
    # (F - F_s)/m = 200 m/s2 up to DV after 5 us, then (F - F_c)/m = 300 m/s2
    edge_s = 1.0e-3 / 200.0
    since = motion.time_s[1:] - edge_s
    assert modes_of(motion) == [Mode.BAND, Mode.SLIP]
    assert motion.events.time_s == pytest.approx([0.0, edge_s], rel=1.0e-12, abs=0.0)
    assert motion.position_m[1:] == pytest.approx(100.0 * edge_s**2 + 1.0e-3 * since + 150.0 * since**2, rel=1.0e-13)


def test_a_stem_that_starts_beyond_static_friction_moves_at_once() -> None:
    motion = simulate_motion(STICKY, [0.0, 1.0], [900.0, 900.0], [0.0, 0.01])
    assert motion.events.time_s[0] == 0.0
    assert motion.events.mode[0] == Mode.BAND
    assert motion.position_m[1] > 0.0


def test_a_force_at_static_friction_to_rounding_still_holds() -> None:
    held = simulate_motion(STICKY, [0.0, 5.0], [600.0 * (1.0 + 1.0e-13)] * 2, [0.0, 5.0])
    assert len(held.events) == 0
    assert held.position_m[-1] == 0.0
    moved = simulate_motion(STICKY, [0.0, 5.0], [600.0 * (1.0 + 1.0e-9)] * 2, [0.0, 5.0])
    assert moved.position_m[-1] > 0.0


def test_capture_stops_the_stem_only_where_static_friction_holds_it() -> None:
    motion = simulate_motion(STICKY, [0.0, 1.0, 4.0], [0.0, 2000.0, 2000.0], np.linspace(0.0, 4.0, 4001))
    last_s, last_mode = motion.events.time_s[-1], motion.events.mode[-1]
    assert last_mode == Mode.STUCK
    net_n = motion.force_n - 5.0e4 * motion.position_m
    assert abs(net_n[-1]) <= 600.0
    assert motion.velocity_m_per_s[motion.time_s > last_s] == pytest.approx(0.0, abs=0.0)


def test_a_reversed_force_takes_the_stem_through_zero_velocity_without_a_stop() -> None:
    # a step to a force far below: at v = DV the net force already pulls back beyond F_s
    motion = simulate_motion(STICKY, [0.0, 1.0, 1.0, 1.2], [0.0, 3000.0, -3000.0, -3000.0], np.linspace(0.0, 1.2, 1201))
    after = motion.events.time_s >= 1.0
    assert [Mode(mode) for mode in motion.events.mode[after][:2]] == [Mode.BAND, Mode.SLIP]
    assert motion.velocity_m_per_s[999] > 0.01
    assert motion.velocity_m_per_s[1000:].min() < -0.01


def test_a_slow_ramp_makes_a_viscous_stem_slide_at_the_limit_velocity() -> None:
    # a ramp of 0.9 DV: the stem reaches DV in the band, and F lies between F_s and F_c + F_v DV
    motion = simulate_motion(VISCOUS, [0.0, 100.0], [0.0, 100.0 * 0.9 * 5.0e4 * 1.0e-3], np.linspace(0.0, 12.0, 120001))
    sliding = motion.mode == Mode.SLIDE
    assert np.count_nonzero(sliding) > 1000
    assert np.all(motion.velocity_m_per_s[sliding] == 1.0e-3)
    net_n = motion.force_n[sliding] - 5.0e4 * motion.position_m[sliding]
    assert net_n.min() >= 450.0 * (1.0 - 1.0e-9)
    assert net_n.max() <= 700.0 * (1.0 + 1.0e-9)
    assert Mode.STUCK in modes_of(motion)  # a ramp below DV lets it fall back: it creeps


def test_a_slide_goes_over_into_slip_when_the_force_gains_on_it() -> None:
    # a ramp of 1.5 DV: in the slide F - k x rises by 0.5 k DV = 25 N/s until F_c + F_v DV
    rate = 1.5 * 5.0e4 * 1.0e-3
    motion = simulate_motion(VISCOUS, [0.0, 40.0], [0.0, 40.0 * rate], np.linspace(0.0, 40.0, 4001))
    assert modes_of(motion) == [Mode.BAND, Mode.SLIDE, Mode.SLIP]
    _breakaway_s, slide_s, slip_s = motion.events.time_s
    start = simulate_motion(VISCOUS, [0.0, 40.0], [0.0, 40.0 * rate], [slide_s, slip_s])
    gained_n = np.diff(start.force_n - 5.0e4 * start.position_m)[0]
    assert gained_n == pytest.approx(25.0 * (slip_s - slide_s), rel=1.0e-9)
    assert start.force_n[1] - 5.0e4 * start.position_m[1] == pytest.approx(700.0, rel=1.0e-12)
    assert motion.velocity_m_per_s[-1] == pytest.approx(1.5e-3, rel=2.0e-2)


def test_a_force_step_takes_a_slide_wherever_the_new_force_leads() -> None:
    rate = 1.5 * 5.0e4 * 1.0e-3
    slide_s = 6.2
    before = simulate_motion(VISCOUS, [0.0, 40.0], [0.0, 40.0 * rate], [slide_s])
    assert before.mode[-1] == Mode.SLIDE
    held_n = 5.0e4 * before.position_m[-1]
    for net_n, expected in (
        (900.0, Mode.SLIP),
        (600.0, Mode.SLIDE),
        (100.0, Mode.STUCK),
        (-100.0, Mode.STUCK),
        (-900.0, Mode.BAND),
    ):
        stepped = simulate_motion(
            VISCOUS, [slide_s, slide_s, 7.0], [before.force_n[-1], held_n + net_n, held_n + net_n], [slide_s, slide_s],
            initial=before.final_state,
        )  # fmt: skip
        assert stepped.mode[-1] == expected, f"net force {net_n} N"


def test_a_force_step_at_the_very_end_counts() -> None:
    motion = simulate_motion(STICKY, [0.0, 1.0, 1.0], [0.0, 0.0, 900.0], [0.5, 1.0])
    assert motion.mode.tolist() == [Mode.STUCK, Mode.BAND]
    assert motion.force_n.tolist() == [0.0, 900.0]


def test_without_static_excess_the_stem_still_sticks_and_slips() -> None:
    even = ValveParameters(2.0, 5.0e4, 300.0, 500.0, 500.0, 1.0e-3)
    motion = simulate_motion(even, [0.0, 1.0, 2.0], [0.0, 2000.0, 0.0], np.linspace(0.0, 2.0, 2001))
    assert motion.events.times_of(Mode.BAND)[0] == pytest.approx(0.25, rel=1.0e-14)
    # no jump: the velocity never passes that of the ramp by more than its first overshoot
    assert np.abs(motion.velocity_m_per_s).max() < 2.0 * 2000.0 / 5.0e4


def test_an_undamped_frictionless_stem_swings_as_a_harmonic_oscillator() -> None:
    free = ValveParameters(2.0, 5.0e4, 0.0, 0.0, 0.0, 1.0e-9)
    w0 = math.sqrt(5.0e4 / 2.0)
    quarter = np.linspace(0.0, 0.99 * math.pi / w0, 200)
    motion = simulate_motion(free, [0.0], [1000.0], quarter)
    assert motion.position_m == pytest.approx(0.02 * (1.0 - np.cos(w0 * quarter)), abs=1.0e-15)


def test_a_frictionless_stem_comes_to_rest_where_the_force_passes_zero_inside_the_band() -> None:
    # the limit of ever smaller static friction: |F| <= F_s and |v| < DV hold for an instant
    for F_s in (0.0, 1.0e-9):
        free = ValveParameters(2.0, 5.0e4, 300.0, 0.0, F_s, 1.0e-3)
        motion = simulate_motion(free, [0.0, 2.0], [1000.0, 1000.0], np.linspace(0.0, 2.0, 201))
        assert motion.final_state.mode == Mode.STUCK
        assert motion.position_m[-1] == pytest.approx(0.02, abs=1.0e-5)


def test_a_stop_catches_the_stem_and_holds_it_until_friction_lets_go() -> None:
    stops = TravelStops(-0.001, 0.01)
    time_s = np.linspace(0.0, 4.0, 4001)
    motion = simulate_motion(STICKY, [0.0, 2.0, 4.0], [0.0, 4000.0, -4000.0], time_s, stops=stops)
    assert motion.position_m.max() == 0.01
    assert motion.position_m.min() == -0.001
    caught_s = motion.events.times_of(Mode.STOPPED)
    assert np.all(motion.velocity_m_per_s[motion.mode == Mode.STOPPED] == 0.0)
    # it leaves when k x - F = F_s: at F = 500 - 600 N on the way down, 4000 N/s
    left_s = motion.events.time_s[motion.events.time_s > caught_s[0]][0]
    assert left_s == pytest.approx(2.0 + (4000.0 + 100.0) / 4000.0, rel=1.0e-13)
    assert motion.mode[-1] == Mode.STOPPED
    assert motion.final_state == StemState(-0.001, 0.0, Mode.STOPPED)


def test_a_stem_at_rest_on_a_stop_is_not_pressed_through_it() -> None:
    motion = simulate_motion(STICKY, [0.0, 1.0], [0.0, -5000.0], [0.0, 0.5, 1.0], stops=TravelStops(0.0, 0.1))
    assert motion.position_m.tolist() == [0.0, 0.0, 0.0]
    assert set(motion.mode.tolist()) == {Mode.STOPPED}
    assert len(motion.events) == 0


def test_a_stem_driven_into_a_stop_in_the_band_is_caught_there() -> None:
    # 0.1 um of room: the stem meets the stop before it reaches DV
    motion = simulate_motion(STICKY, [0.0, 1.0], [0.0, 1000.0], [0.0, 1.0], stops=TravelStops(-1.0, 1.0e-7))
    assert modes_of(motion) == [Mode.BAND, Mode.STOPPED]
    assert motion.final_state.position_m == 1.0e-7


def test_a_stem_thrown_at_a_stop_loses_its_velocity_there() -> None:
    motion = simulate_motion(
        LOOSE, [0.0], [0.0], [0.0, 1.0], stops=TravelStops(-0.01, 0.01), initial=StemState(0.0, 5.0)
    )
    # m v' = -F_c: v2 = v02 - 2 * 200 * 0.01 at the stop
    assert motion.events.time_s[-1] == pytest.approx((5.0 - math.sqrt(25.0 - 4.0)) / 200.0, rel=1.0e-12)
    assert motion.final_state == StemState(0.01, 0.0, Mode.STOPPED)


@pytest.mark.parametrize(
    ("velocity_m_per_s", "force_n", "mode"),
    [(0.0, 0.0, Mode.STUCK), (0.5e-3, 100.0, Mode.STUCK), (0.5e-3, 900.0, Mode.BAND), (0.1, 0.0, Mode.SLIP)],
)
def test_any_initial_state_finds_its_mode(velocity_m_per_s: float, force_n: float, mode: Mode) -> None:
    motion = simulate_motion(STICKY, [0.0], [force_n], [0.0, 0.0001], initial=StemState(0.0, velocity_m_per_s))
    assert motion.mode[0] == mode
    assert motion.velocity_m_per_s[0] == (0.0 if mode == Mode.STUCK else velocity_m_per_s)


def test_a_gap_of_hours_between_outputs_changes_nothing() -> None:
    corners = [0.0, 1.0, 50000.0, 50001.0], [0.0, 2000.0, 2000.0, -2000.0]
    coarse = simulate_motion(STICKY, *corners, [0.0, 50001.0])
    fine = simulate_motion(STICKY, *corners, np.concatenate(([0.0], np.linspace(49999.0, 50001.0, 2001))))
    assert coarse.position_m[-1] == pytest.approx(fine.position_m[-1], abs=1.0e-13)
    assert np.array_equal(coarse.events.time_s, fine.events.time_s)
