"""A stop in the travel, told from a stem that stops by itself."""

from __future__ import annotations

from discrepancy.rough.causes.seen import View
from discrepancy.rough.causes.travel_stop import TravelStopHigh, TravelStopLow
from discrepancy.rough.evidence import fitted, problem_of
from discrepancy.rough.observations import observations
from discrepancy.rough.setting import setting_of
from estimators.base import Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.reading import read
from estimators.engine.rows import measured_rows
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
