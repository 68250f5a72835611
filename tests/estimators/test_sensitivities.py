"""Sensitivities of the exact motion: against closed forms, against other steps, and beside a jump."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.identifiability import sensitivities
from estimators.identifiability.sensitivities import SENSITIVITY_SYMBOLS, position_sensitivities
from estimators.samples import FloatArray
from tests.support.published_recordings import VALVES
from valve.errors import ParameterError
from valve.motion import simulate_motion
from valve.parameter_sets import ParameterSet, parameter_set
from valve.parameters import TravelStops
from valve.stem import StemState
from valve.waveform import multi_rate_triangle


def area_m2(chosen: ParameterSet) -> float:
    area = chosen.nameplate.actuator.diaphragm_area_m2
    assert area is not None
    return area


def multi_rate_force(name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corner times, corner forces and output times of a test at four rates."""
    chosen = parameter_set(name)
    signal = chosen.nameplate.signal
    assert signal is not None
    wave = multi_rate_triangle([10.0, 5.0, 3.0, 2.0], *signal.range_pa)
    return wave.time_s, area_m2(chosen) * wave.pressure_pa, np.linspace(0.0, 20.0, 4001)


def test_position_is_that_of_the_simulated_motion() -> None:
    parameters = parameter_set("rough").parameters
    time_s, force_n, outputs_s = multi_rate_force("rough")
    position_m, derivatives = position_sensitivities(parameters, time_s, force_n, outputs_s, ["m", "F_s"])
    assert position_m == pytest.approx(simulate_motion(parameters, time_s, force_n, outputs_s).position_m, abs=1e-15)
    assert derivatives.shape == (outputs_s.size, 2)


def test_steady_sliding_answers_as_its_closed_form_says() -> None:
    # x = (F - F_c - F_0)/k - F_v r/k^2 once the transient has died out, at the force rate r
    parameters = replace(parameter_set("nominal").parameters, preload_n=300.0)
    rate_n_per_s, k, F_v = 500.0, parameters.spring_rate_n_per_m, parameters.viscous_friction_n_s_per_m
    outputs_s = np.linspace(6.0, 9.9, 40)
    _, derivatives = position_sensitivities(
        parameters, [0.0, 10.0], [0.0, 10.0 * rate_n_per_s], outputs_s, SENSITIVITY_SYMBOLS
    )
    load_n = rate_n_per_s * outputs_s - parameters.coulomb_friction_n - parameters.preload_n
    flat = np.ones_like(outputs_s)
    expected = {
        "m": 0.0 * flat,
        "k": -load_n / k**2 + 2.0 * F_v * rate_n_per_s / k**3,
        "F_v": -rate_n_per_s / k**2 * flat,
        "F_c": -flat / k,
        "F_s": 0.0 * flat,
        "DV": 0.0 * flat,
        "F_0": -flat / k,
        "x_0": 0.0 * flat,
    }
    values = {**parameters.by_symbol(), "x_0": 0.1}
    for symbol, column in zip(SENSITIVITY_SYMBOLS, derivatives.T, strict=True):
        assert values[symbol] * column == pytest.approx(values[symbol] * expected[symbol], abs=1.0e-8), symbol


def test_a_stem_that_never_moves_answers_to_its_start_alone() -> None:
    outputs_s = np.linspace(0.0, 1.0, 11)
    _, derivatives = position_sensitivities(
        parameter_set("nominal").parameters, [0.0, 1.0], [0.0, 1000.0], outputs_s, SENSITIVITY_SYMBOLS
    )
    assert derivatives[:, :-1] == pytest.approx(0.0, abs=1.0e-15)
    assert derivatives[:, -1] == pytest.approx(1.0, rel=1.0e-8)


@pytest.mark.parametrize("name", VALVES)
def test_half_the_step_gives_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = parameter_set(name).parameters
    force = multi_rate_force(name)
    _, whole = position_sensitivities(parameters, *force, SENSITIVITY_SYMBOLS)
    monkeypatch.setattr(sensitivities, "_RELATIVE_STEP", 0.5 * sensitivities._RELATIVE_STEP)
    monkeypatch.setattr(sensitivities, "_DV_RELATIVE_STEP", 0.5 * sensitivities._DV_RELATIVE_STEP)
    _, half = position_sensitivities(parameters, *force, SENSITIVITY_SYMBOLS)
    size = np.linalg.norm(whole, axis=0)
    assert (np.linalg.norm(half - whole, axis=0) < 1.0e-3 * size).all()
    assert (size > 0.0).all()


@pytest.mark.parametrize("excess", [1.0e-8, -1.0e-8])
def test_no_difference_is_taken_across_a_slip_more_or_less(excess: float) -> None:
    parameters = parameter_set("nominal").parameters
    outputs_s = np.linspace(0.0, 4.0, 4001)

    def slips(peak_n: float) -> bool:
        motion = simulate_motion(parameters, [0.0, 2.0, 4.0], [0.0, peak_n, 0.0], outputs_s)
        return bool(motion.position_m.max() > 1.0e-4)

    still_n, slipping_n = parameters.static_friction_n, 1.1 * parameters.static_friction_n
    while slipping_n - still_n > 1.0e-12 * slipping_n:
        middle_n = 0.5 * (still_n + slipping_n)
        still_n, slipping_n = (still_n, middle_n) if slips(middle_n) else (middle_n, slipping_n)
    # the force turns far nearer to the slip than the first step of the differences reaches
    peak_n = slipping_n * (1.0 + excess)
    assert slips(peak_n) == (excess > 0.0)
    _, derivatives = position_sensitivities(
        parameters, [0.0, 2.0, 4.0], [0.0, peak_n, 0.0], outputs_s, ["F_s", "F_0", "F_c"]
    )
    # a first step of 1.7 mN across the jump of 5 mm would give 1.4 m/N
    assert np.abs(derivatives).max() < 0.2


def test_at_the_bound_the_allowed_side_is_taken() -> None:
    parameters = replace(parameter_set("vendor").parameters, viscous_friction_n_s_per_m=0.0)
    assert parameters.static_friction_n == parameters.coulomb_friction_n
    time_s, force_n, outputs_s = multi_rate_force("vendor")
    _, derivatives = position_sensitivities(parameters, time_s, force_n, outputs_s, ["F_s", "F_v"])
    position_m = simulate_motion(parameters, time_s, force_n, outputs_s).position_m
    step_n, step_n_s_per_m = 1.0e-5, 1.0e-3
    stickier = replace(parameters, static_friction_n=parameters.static_friction_n + step_n)
    slower = replace(parameters, viscous_friction_n_s_per_m=step_n_s_per_m)
    for column, other, step in ((0, stickier, step_n), (1, slower, step_n_s_per_m)):
        moved_m = simulate_motion(other, time_s, force_n, outputs_s).position_m
        error = np.linalg.norm((moved_m - position_m) / step - derivatives[:, column])
        assert error < 0.02 * np.linalg.norm(derivatives[:, column])


def test_a_stop_holds_the_stem_whatever_the_parameters_are() -> None:
    parameters = parameter_set("nominal").parameters
    stops = TravelStops(0.0, 0.05)
    position_m, derivatives = position_sensitivities(
        parameters, [0.0, 10.0], [0.0, 5000.0], [9.0, 9.5], ["k", "F_c", "x_0"], stops=stops, initial=StemState(0.01)
    )
    assert position_m == pytest.approx(0.05)
    assert derivatives == pytest.approx(0.0, abs=1.0e-12)


def test_an_unknown_symbol_is_refused() -> None:
    with pytest.raises(ParameterError, match="x_1: no such sensitivity"):
        position_sensitivities(parameter_set("nominal").parameters, [0.0], [0.0], [0.0], ["x_1"])
