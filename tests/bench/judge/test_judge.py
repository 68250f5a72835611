"""The judge's own physics and grades."""

from dataclasses import replace

import numpy as np
import pytest

from tests.bench.judge.effects import CATALOGUE
from tests.bench.judge.judging import grade, judged_estimate, share_of_gain
from tests.bench.judge.recordings import Setting, dead_at, filtered, nameplate, run, true_mean, with_play
from tests.bench.judge.strength import best_mean_law
from tests.bench.judge.valves import GRADES, ROW_S, VALVES, move, roughen, stem_of, wander

_NOMINAL = VALVES["nominal"]


def _setting(grade_name: str = "usual", sequence: str = "triangle", seed: int = 3) -> Setting:
    return Setting(_NOMINAL, GRADES[grade_name], sequence, 0.02, 0.005, (0.02, 0.97), seed)


def test_the_stem_breaks_away_at_its_static_friction_and_jumps_as_far_as_an_overdamped_stem_does() -> None:
    rate_pa_per_s = 4000.0
    pressure_pa = np.asarray(rate_pa_per_s * ROW_S * np.arange(12_000), dtype=np.float64)
    position_m = move(stem_of(_NOMINAL), pressure_pa, 0.0)
    moved = int(np.argmax(position_m > 2.0e-5))
    broke_n = _NOMINAL.area_m2 * pressure_pa[moved]
    assert broke_n == pytest.approx(_NOMINAL.F_s, rel=5.0e-3)
    settled_m = (_NOMINAL.area_m2 * pressure_pa[-1] - _NOMINAL.F_c) / _NOMINAL.k
    lag_m = _NOMINAL.F_v / _NOMINAL.k * _NOMINAL.area_m2 * rate_pa_per_s / _NOMINAL.k
    assert position_m[-1] == pytest.approx(settled_m - lag_m, abs=2.0e-6)


def test_a_stem_at_rest_stays_while_the_force_is_below_its_static_friction() -> None:
    span_pa = 0.95 * _NOMINAL.F_s / _NOMINAL.area_m2
    pressure_pa = span_pa * np.sin(2.0 * np.pi * ROW_S * np.arange(5_000))
    assert np.ptp(move(stem_of(_NOMINAL), pressure_pa, 0.0)) == 0.0


def test_the_work_of_the_actuator_goes_into_spring_and_friction() -> None:
    pressure_pa = _NOMINAL.range_pa[1] * np.interp(ROW_S * np.arange(20_001), [0.0, 10.0, 20.0], [0.0, 1.0, 0.0])
    position_m = move(stem_of(_NOMINAL), pressure_pa, 0.0)
    steps_m = np.diff(position_m)
    between_n = _NOMINAL.area_m2 * 0.5 * (pressure_pa[1:] + pressure_pa[:-1])
    speed = steps_m / ROW_S
    lost_j = np.sum(_NOMINAL.F_c * np.abs(steps_m) + _NOMINAL.F_v * speed * steps_m)
    stored_j = 0.5 * _NOMINAL.k * (position_m[-1] ** 2 - position_m[0] ** 2)
    assert np.sum(between_n * steps_m) == pytest.approx(lost_j + stored_j, rel=5.0e-3)


def test_half_the_step_gives_the_same_motion_to_micrometres() -> None:
    pressure_pa = _NOMINAL.range_pa[1] * np.interp(ROW_S * np.arange(8_001), [0.0, 4.0, 8.0], [0.0, 1.0, 0.0])
    coarse_m, fine_m = (move(stem_of(_NOMINAL), pressure_pa, 0.0, None, steps) for steps in (50, 100))
    assert np.abs(coarse_m - fine_m).max() < 2.0e-5
    assert np.sqrt(np.mean((coarse_m - fine_m) ** 2)) < 1.0e-6


def test_a_stop_holds_the_stem_and_bristles_let_it_yield() -> None:
    pressure_pa = _NOMINAL.range_pa[1] * np.interp(ROW_S * np.arange(8_001), [0.0, 4.0, 8.0], [0.0, 1.0, 0.0])
    stopped = stem_of(_NOMINAL)
    stopped.high_m = 0.04
    assert move(stopped, pressure_pa, 0.0).max() == pytest.approx(0.04, abs=1e-9)
    yielding = stem_of(_NOMINAL)
    yielding.bristle_m = 2.0e-4
    below = int(0.9 * _NOMINAL.F_c / _NOMINAL.area_m2 / (_NOMINAL.range_pa[1] / 4000.0))
    early_m = move(yielding, pressure_pa, 0.0)[below]
    assert 1.0e-4 < early_m < 2.0e-3


def test_a_packing_has_the_sizes_of_its_grade() -> None:
    grade_of, rng = GRADES["hard"], np.random.default_rng(5)
    up_n, down_n = roughen(stem_of(_NOMINAL), grade_of, rng)
    for part in (up_n, down_n):
        assert part.std() == pytest.approx(grade_of.roughness * _NOMINAL.F_c, rel=0.35)
    assert 0.1 < np.corrcoef(up_n, down_n)[0, 1] < 0.97
    sizes = [wander(60_000, 10.0, np.random.default_rng(seed)).std() for seed in range(20)]
    assert 4.0 < float(np.median(sizes)) < 16.0


def test_the_best_mean_law_of_a_valve_without_a_packing_is_its_own() -> None:
    made = run(_setting("ideal"))
    law, misfit_m = best_mean_law(
        made, replace(_NOMINAL, F_c=1.03 * _NOMINAL.F_c, k=0.99 * _NOMINAL.k), by_command=False
    )
    assert law.k == pytest.approx(_NOMINAL.k, rel=2.0e-3)
    assert law.F_c == pytest.approx(_NOMINAL.F_c, rel=1.0e-2)
    assert misfit_m < 3.0 * GRADES["ideal"].white * _NOMINAL.travel_m


def test_a_hidden_effect_is_in_the_run_and_the_same_seed_gives_the_same() -> None:
    setting, effect = _setting(), CATALOGUE["position_lag"]
    healthy, hidden, again = run(setting), run(setting, ((effect, 0.2),)), run(setting, ((effect, 0.2),))
    assert np.array_equal(hidden.position_m, again.position_m)
    assert np.array_equal(hidden.stem_m, healthy.stem_m)
    assert np.abs(hidden.position_m - healthy.position_m).max() > 1.0e-3
    truth = true_mean(setting, healthy)
    assert truth.F_c == pytest.approx(_NOMINAL.F_c, rel=0.03)
    assert "bench_set_pa" in nameplate(setting, mass=True, bench_set=True)


def test_play_lag_and_a_dead_spot_do_what_they_say() -> None:
    ramp = np.concatenate([np.linspace(0.0, 1.0, 1001), np.linspace(1.0, 0.0, 1001)])
    behind = with_play(ramp, 0.1)
    assert behind[1000] == pytest.approx(0.95)
    assert behind[1050] == pytest.approx(0.95)
    assert behind[1500] == pytest.approx(ramp[1500] + 0.05)
    assert filtered(ramp, 0.05)[900] == pytest.approx(ramp[900] - 0.05, abs=1e-6)
    stuck = dead_at(ramp, 0.4, 0.6)
    assert stuck[500] == pytest.approx(0.4, abs=2e-3)
    assert stuck[1500] == pytest.approx(0.6, abs=2e-3)


def test_answers_are_graded_by_what_a_fitter_would_do() -> None:
    lag = ["transducer_lag"]
    assert grade("named", lag, [], lag) == "right"
    assert grade("likely", ["local_friction"], [], ["seat_friction"]) == "right"
    assert grade("named", [*lag, "vibration"], [], lag) == "wrong"
    assert grade("ambiguous", ["vibration"], lag, lag) == "right"
    assert grade("ambiguous", ["vibration"], [*lag, "a", "b"], lag) == "vague"
    assert grade("ambiguous", ["vibration"], ["a"], lag) == "wrong"
    assert grade("named", lag, [], [*lag, "vibration"]) == "partly"
    assert grade("named", ["vibration"], [], []) == "wrong"
    assert grade("unexplained", [], [], lag) == "unexplained"
    assert grade("none", [], [], []) == "none"
    assert grade("named", [*lag, "travel_stop_high"], [], lag, ["travel_stop_high"]) == "right"


def test_an_estimate_beyond_twice_its_half_width_is_wrong_where_its_status_is_ok() -> None:
    entry = {"value": _NOMINAL.k * 1.01, "ci95": [_NOMINAL.k * 1.006, _NOMINAL.k * 1.014]}
    parameters = {symbol: {"value": None, "ci95": None} for symbol in ("F_c", "F_s", "F_0", "F_v", "m")}
    judged = judged_estimate({"k": entry, **parameters}, _NOMINAL, "ok")["k"]
    assert (judged["held"], judged["wrong"]) == (False, True)
    assert not judged_estimate({"k": entry, **parameters}, _NOMINAL, "poor")["k"]["wrong"]
    assert share_of_gain(4.0, 2.0, 1.0) == pytest.approx(2.0 / 3.0)
    assert share_of_gain(1.0, 1.0, 0.95) is None
