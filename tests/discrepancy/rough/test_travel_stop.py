"""A stop in the travel, told from a stem that stops by itself."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from discrepancy.rough.causes.seen import View
from discrepancy.rough.causes.travel_stop import TravelStopHigh, TravelStopLow
from discrepancy.rough.evidence import fitted, problem_of
from discrepancy.rough.observations import observations
from discrepancy.rough.setting import setting_of
from estimators.base import Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.parameters import Known
from estimators.engine.reading import read
from estimators.engine.rows import measured_rows
from estimators.engine.segmentation import Move, Rest
from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case as judged
from tests.support.rough_valves import VALVES, RoughCase, case
from valve.effects.stribeck_friction import StribeckFriction
from valve.effects.travel_stop_high import TravelStopHigh as HighEffect


def _view(made: RoughCase) -> View:
    reading = read(measured_rows(made.recording).recording, made.nameplate)
    assert not isinstance(reading, Outcome)
    lag = lag_after_corners(reading)
    rows = observations(reading, lag)
    setting = setting_of(rows, reading, made.nameplate)
    problem = problem_of(rows, setting, lag)
    return View(made.recording, made.nameplate, reading, setting, fitted(problem, problem.no_columns), None)


def test_a_stem_that_goes_on_from_there_more_often_than_it_stops_has_no_stop() -> None:
    analysis, _ = diagnosed(judged("healthy", 135))  # six of its eight turns lie further on, by four bands of its noise
    assert analysis["discrepancy"]["verdict"] == "none"


def test_a_force_that_no_command_explains_drives_no_hard_packing_against_a_stop() -> None:
    analysis, _ = diagnosed(judged("healthy", 137))  # after two turns of nine it went on, by 1.4 % of its range
    assert analysis["discrepancy"]["verdict"] == "none"


def test_a_stem_that_sticks_and_slips_up_to_its_turn_has_no_stop() -> None:
    parameters, _ = VALVES["nominal"]
    falling = StribeckFriction(excess_n=0.3 * parameters.coulomb_friction_n, speed_m_per_s=3.725675929803189e-3)
    view = _view(case("nominal", "triangle", "usual", seed=800, effects=[falling]))
    assert TravelStopHigh().seen(view) is None
    assert TravelStopLow().seen(view) is None


def test_a_stop_that_a_sliding_stem_runs_into_is_seen() -> None:
    seen = TravelStopHigh().seen(_view(case("small", "triangle", "usual", seed=900, effects=[HighEffect(0.017)])))
    assert seen is not None
    assert abs(seen.fitted["position_m"].value - 0.017) < 1.0e-4


@pytest.mark.parametrize(
    ("hunting", "commanded", "apart_m", "is_stop"),
    [(0.0, True, 1.0e-5, True), (3.0, True, 0.0, False), (0.0, False, 1.0e-5, False), (0.0, False, 0.0, True)],
)
def test_an_ip_that_hunts_or_may_do_so_drives_no_stem_on(
    hunting: float, commanded: bool, apart_m: float, is_stop: bool
) -> None:
    """Twice the force comes up to where the stem rests, and rises by another percent there.

    Without a command nothing tells what of it an I/P did by itself, but that the stem rests at the same place.
    """
    time_s = np.arange(0.0, 44.0, 0.02)
    knots_s = [0.0, 10.0, 12.0, 22.0, 32.0, 34.0, 44.0]
    force_n = np.interp(time_s, knots_s, [0.0, 1000.0, 1010.0, 0.0, 1000.0, 1010.0, 0.0])
    spring = 2.0e4
    position_m = np.minimum(force_n, 1000.0) / spring

    def rest(first_s: float, last_s: float) -> Rest:
        first, last = np.searchsorted(time_s, [first_s, last_s]).tolist()
        return Rest(first, last, 1000.0 / spring - (apart_m if first_s > 20.0 else 0.0), 1.0e-7)

    def move(first_s: float, last_s: float, direction: int, before: int, after: int) -> Move:
        first, last = np.searchsorted(time_s, [first_s, last_s]).tolist()
        return Move(first, last, direction, before, after, math.nan, direction * 0.05)

    rests = rest(10.0, 12.0), rest(32.0, 34.0)
    moves = (
        move(0.0, 10.0, 1, -1, 0), move(12.0, 22.0, -1, 0, -1),
        move(22.0, 32.0, 1, -1, 1), move(34.0, 43.9, -1, 1, -1),
    )  # fmt: skip
    known = {"k": Known(spring, 1.0), "lag": Known(0.0, 0.01), "F_0": Known(0.0, 1.0), "F_s": Known(60.0, 1.0)}
    view = SimpleNamespace(
        recording=SimpleNamespace(command_pa=force_n if commanded else None),
        reading=SimpleNamespace(
            time_s=time_s,
            position_m=position_m,
            noise_m=1.0e-6,
            samples=SimpleNamespace(period_s=0.02),
            path=SimpleNamespace(force_n=force_n, left_n=hunting * np.sign(np.sin(0.5 * time_s))),
            segmentation=SimpleNamespace(moves=moves, rests=rests, band_m=1.0e-6),
        ),
        null=SimpleNamespace(known=known.__getitem__, hyperparameter=lambda _: 1.0),
        setting=SimpleNamespace(full_force_n=1000.0, high_m=0.05, low_m=0.0, travel_m=0.06, late_s=0.0),
    )
    assert (TravelStopHigh().seen(cast(View, view)) is not None) == is_stop


@pytest.mark.long
def test_a_stop_is_seen_by_a_stem_that_is_damped_for_longer_than_the_force_goes_on() -> None:
    # 0.42 s of a force that went on, behind a stem that is 0.29 s late; four arrivals within 2 um
    analysis, _ = diagnosed(judged("hidden", 381, sizes=(0.08868043526271223,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == ["travel_stop_high"]


@pytest.mark.parametrize(
    ("kind", "seed", "cause", "size"),
    [
        ("perfect", 1044, "travel_stop_low", 0.0104),
        pytest.param("hidden", 1114, "travel_stop_low", 0.0112, marks=pytest.mark.long),
        pytest.param("hidden", 809, "travel_stop_high", 0.01, marks=pytest.mark.long),
    ],
)
def test_a_stop_in_the_last_percent_of_the_sweep_is_named(kind: str, seed: int, cause: str, size: float) -> None:
    # for a moment at each turn the force is more than any friction, and the stem rests where it rested before
    analysis, _ = diagnosed(judged(kind, seed, cause, sizes=(size,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == [cause]
