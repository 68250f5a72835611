"""A periodic force: found by its line in the misfit, by the breakaways that it lets go, and fitted without blurring."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
import pytest

from discrepancy import shaking
from discrepancy.baseline import baseline_unknowns, fit_baseline
from discrepancy.causes.forces import AREA, VIBRATION
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.locking import locked_forces
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.pauses import rest_ends
from discrepancy.periodic import along_strength, followed
from discrepancy.screening import extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.shaking import Line, lines, shaken_breakaways, slot_clock
from discrepancy.significance import is_significant, misfit
from tests.blind.cases import BlindCase, blind_case

pytestmark = pytest.mark.long

made = cache(blind_case)


def fitted(case: BlindCase) -> tuple[Observed, Fit]:
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    return observed, baseline


def test_steps_that_lock_to_a_third_of_the_frequency_give_it_away_by_the_forces_at_their_breakaways() -> None:
    case = made(7601, "triangle")
    hidden, valve = case.hidden[0].parameters, case.truth.parameters
    observed, baseline = fitted(case)
    found = shaken_breakaways(observed, 3)
    assert found[0].frequency_hz == pytest.approx(hidden["frequency_hz"], abs=5.0e-3)
    assert found[0].force_n == pytest.approx(hidden["force_n"], rel=0.1)
    assert found[0].phase_rad == pytest.approx(hidden["phase_rad"], abs=0.3)
    assert found[0].spring_n_per_m == pytest.approx(valve.spring_rate_n_per_m, rel=1.0e-3)
    assert found[0].static_n == pytest.approx(valve.static_friction_n, rel=0.01)
    setting = setting_of(baseline)
    (candidate,) = screen(baseline, [VIBRATION], setting)
    fit = refit(baseline, candidate, setting)
    assert misfit(fit) < 1.1
    assert fit.values["vibration.force_n"] == pytest.approx(hidden["force_n"], rel=0.05)


def test_a_line_of_three_micrometres_under_fifty_of_noise_is_a_cause() -> None:
    case = made(7328, "triangle")
    hidden = case.hidden[0].parameters
    _, baseline = fitted(case)
    setting = setting_of(baseline)
    (candidate,) = screen(baseline, [VIBRATION], setting)
    fit = refit(baseline, candidate, setting)
    assert is_significant(baseline, fit)
    assert fit.values["vibration.frequency_hz"] == pytest.approx(hidden["frequency_hz"], abs=0.01)
    assert fit.values["vibration.force_n"] == pytest.approx(hidden["force_n"], rel=0.3)


def test_a_line_in_the_misfit_is_found_with_its_frequency_phase_and_amplitude() -> None:
    case = made(7328, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    noise_m = np.random.default_rng(1).normal(0.0, 1.0, observed.count) / observed.weight
    wave_m = 8.0e-6 * np.sin(2.0 * math.pi * 11.37 * observed.time_s + 0.6)
    (line,) = lines(observed, noise_m + wave_m, 1)
    assert line.frequency_hz == pytest.approx(11.37, abs=4.0e-3)
    middle_s = float(observed.time_s.mean())
    off_rad = line.phase_rad - 0.6 + math.tau * (line.frequency_hz - 11.37) * middle_s
    assert math.remainder(off_rad, math.tau) == pytest.approx(0.0, abs=0.2)
    assert line.amplitude_m == pytest.approx(8.0e-6, rel=0.15)


def test_what_alternates_from_block_to_block_is_no_line() -> None:
    """Half the rate of the blocks is the last frequency of the spectrum, below 60 Hz where blocks are long."""
    observed = observe(made(7403, "healthy").recordings, made(7403, "healthy").nameplate)
    assert isinstance(observed, Observed)
    clock_s = slot_clock(observed)
    step_s = float(np.median(np.diff(clock_s)))
    assert 0.5 / step_s < 60.0
    alternating_m = 1.0e-5 * np.cos(math.pi * np.round(clock_s / step_s))
    assert all(line.frequency_hz < 0.501 / step_s for line in lines(observed, alternating_m, 3))


def test_the_force_behind_a_line_is_what_mass_spring_and_damper_make_of_it() -> None:
    force_n, phase_rad = Line(1.0 / math.tau, 0.25, 2.0e-3).force(3.0, 1003.0, 1000.0)
    assert force_n == pytest.approx(2.0e-3 * 1000.0 * math.sqrt(2.0))
    assert phase_rad == pytest.approx(0.25 + math.pi / 4.0)


# Where the plain valve ends on a case of locked steps.
LOCKED: Final = {
    "m": 1.6492, "k": 46103.0, "F_v": 368.3, "F_c": 1157.6, "d": 0.11716, "F_0": 243.48, "DV": 1.6496e-4,
    "first_rise": 4.4687, "x_0": 3.4431e-5,
}  # fmt: skip
# About where short fits end on this case: static friction stands in for half of the force, as all its breakaways come
# at nearly the same phase.
HALF: Final = {
    "m": 1.2, "k": 63311.0, "F_v": 800.0, "F_c": 1850.0, "d": 0.195, "F_0": 451.83, "DV": 2.0e-4, "first_rise": 191.0,
    "vibration.force_n": 50.0, "vibration.frequency_hz": 17.4212, "vibration.phase_rad": 1.4,
}  # fmt: skip


def test_a_walk_along_the_force_leads_out_of_the_valley_where_static_friction_stands_in_for_it() -> None:
    case = made(8063, "triangle")
    _, baseline = fitted(case)
    model = extended_model(baseline.model, VIBRATION, setting_of(baseline))
    stuck = descend(start_fit(model, model.unknowns.point({**baseline.values, **HALF})), most_steps=12)
    assert misfit(stuck) > 1000.0
    found = along_strength(stuck, VIBRATION)
    assert misfit(found) < 0.01 * misfit(stuck)
    assert found.values["vibration.force_n"] == pytest.approx(case.hidden[0].parameters["force_n"], rel=0.3)


def test_a_diaphragm_that_grows_and_a_vibration_are_told_together_by_the_breakaways(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each hides the other: what the wave leaves bends by the direction, and a bend makes the wave another."""
    generator = np.random.default_rng(3)
    time_s = np.sort(generator.uniform(0.0, 120.0, 40))
    sense = np.where(np.arange(40) < 20, 1.0, -1.0)
    place_m = generator.uniform(0.0, 0.06, 40)
    wave_n = 40.0 * np.sin(2.0 * math.pi * 5.861 * time_s + 1.37)
    force_n = (6.0e4 * place_m + 380.0 + 2650.0 * sense - wave_n) / (1.0 + 0.37 * (place_m - 0.03))
    table = list(zip(time_s, force_n, place_m, sense, strict=True))
    monkeypatch.setattr(shaking, "_breakaways", lambda _motion: [table[0], *table])
    observed = observe(made(7517, "triangle").recordings, made(7517, "triangle").nameplate)
    assert isinstance(observed, Observed)
    slope = "diaphragm_area_change.slope_per_m"
    fit_before = {slope: 0.53, "diaphragm_area_change.reference_m": 0.03}  # as it stands in for the wave
    (found,) = shaken_breakaways(observed, 1, fit_before)
    assert found.frequency_hz == pytest.approx(5.861, abs=2.0e-3)
    assert found.force_n == pytest.approx(40.0, rel=0.02)
    assert found.phase_rad == pytest.approx(1.37, abs=0.7)  # the grid of frequencies moves it
    assert found.spring_n_per_m == pytest.approx(6.0e4, rel=2.0e-3)
    assert found.static_n == pytest.approx(2650.0, rel=2.0e-3)
    assert found.beside[slope] == pytest.approx(0.37, rel=0.02)
    (plain,) = shaken_breakaways(observed, 1)
    assert not plain.beside
    assert plain.spring_n_per_m != pytest.approx(6.0e4, rel=0.01)


def test_beside_another_cause_the_friction_in_motion_begins_anew_and_the_static_one_is_kept() -> None:
    """A fit that missed a vibration has the slips of another valve, and from those no step leads to the right ones."""
    case = made(7517, "triangle")
    hidden, valve = case.hidden[0].parameters, case.truth.parameters
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    unknowns = baseline_unknowns(observed, 1.08e-2, 1150.0)
    plain = start_fit(Model(observed, unknowns), unknowns.point(LOCKED))
    setting = setting_of(plain)
    model = extended_model(extended_model(plain.model, AREA, setting), VIBRATION, setting)
    balance = {"k": valve.spring_rate_n_per_m, "F_0": LOCKED["F_0"], "diaphragm_area_change.slope_per_m": 0.0}
    slips = {"F_c": valve.static_friction_n / 1.01, "d": 0.01, "F_v": 20.0 * valve.viscous_friction_n_s_per_m}
    values = {**plain.values, **balance, **VIBRATION.full(hidden), **slips}
    start = start_fit(model, model.unknowns.point(values))
    assert misfit(start) > 500.0
    fit = followed([({**hidden, **balance}, start)], VIBRATION, 0.0)
    assert fit is not None
    assert misfit(fit) < 1.1
    assert fit.values["F_c"] == pytest.approx(valve.coulomb_friction_n, rel=0.02)
    assert fit.values["vibration.force_n"] == pytest.approx(hidden["force_n"], rel=0.1)


def test_slips_that_noise_runs_together_are_told_by_what_lies_between_the_jumps() -> None:
    case = made(9008, "triangle")
    hidden = case.hidden[0].parameters
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    motion = observed.motions[0]
    assert len(motion.phases.breakaways) == 2, "a window as wide as the noise asks for bridges the rests"
    assert len(rest_ends(motion)) > 40
    found = shaken_breakaways(observed, 3)
    assert found[0].frequency_hz == pytest.approx(hidden["frequency_hz"], abs=5.0e-3)
    assert found[0].static_n == pytest.approx(case.truth.parameters.static_friction_n, rel=0.02)
    assert any(
        one.frequency_hz == pytest.approx(hidden["frequency_hz"], abs=2.0e-3) for one in locked_forces(observed, 2.0e-3)
    )
