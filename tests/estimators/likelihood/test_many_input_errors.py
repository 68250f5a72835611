"""A measured force of many corners with many errors of its own: cheaper, and the same as with all of them unknown."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimators.base import absent, measured
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.elimination import FEW_ERRORS, descend_with_errors, spread_of
from estimators.likelihood.input_errors import with_input_errors
from estimators.likelihood.inputs.input_path import input_path
from estimators.likelihood.inputs.pressure_lines import MeasuredPath
from estimators.likelihood.model import StemModel
from estimators.likelihood.problem import pose
from estimators.likelihood.stand_ins import without_lone_limit, without_mass_at_bound
from estimators.likelihood.thinned_force import thinned
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray
from tests.estimators.recordings import SYMBOLS, recorded
from valve.parameter_sets import parameter_set
from valve.waveform import sine


@cache
def _widened(noise_pa: float = 80.0) -> tuple[StemModel, FloatArray]:
    """The model of a sine under a noisy gauge with the errors of its pieces, and the true point (p + d,)."""
    signal = parameter_set("nominal").nameplate.signal
    assert signal is not None
    made = recorded("nominal", period_s=2.0e-3, noise_m=20.0e-6, waveform=sine(10.0, 2, *signal.range_pa))
    assert made.recording.pressure_pa is not None
    noise = noise_pa * np.random.default_rng(3).standard_normal(made.recording.samples)
    recording = replace(made.recording, pressure_pa=made.recording.pressure_pa + noise)
    motion, path = read_motion(recording, made.nameplate), input_path(recording, made.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert isinstance(path, MeasuredPath)
    problem = pose(motion, path)
    assert problem is not None
    true = made.truth.by_symbol()
    own = {name: true[name] for name in ("m", "k", "F_v", "F_c", "F_0", "DV")} | {"d": true["F_s"] / true["F_c"] - 1.0}
    point = problem.model.coordinates.point(problem.trials[0].values | own)
    model = compressed(problem.model)
    model = with_input_errors(model, point, path.variations(np.zeros(1)))
    assert len(model.deviations) > 4 * FEW_ERRORS
    return model, np.concatenate([point, np.zeros(len(model.deviations))])


def test_a_descent_with_the_errors_eliminated_ends_where_one_with_all_of_them_unknown_does() -> None:
    model, start = _widened()
    plain = descend(model, start, most_steps=12, one_sided=True)
    found = descend_with_errors(model, start, most_steps=12, one_sided=True)
    assert found.cost < plain.cost + 0.5
    assert found.cost == pytest.approx(model.cost(found.point), rel=1.0e-12)


def test_the_bent_force_is_the_same_whatever_was_asked_before() -> None:
    model, start = _widened()
    random = np.random.default_rng(1)
    values = model.coordinates.values(start)
    shares = {name: 0.0 for name in values if name.startswith("input_")}
    for _ in range(30):
        for name in random.choice(list(shares), int(random.integers(1, 7))):
            shares[str(name)] = float(random.standard_normal())
        asked = model.corners(values | shares)
        fresh = replace(model).corners(values | shares)
        assert np.allclose(asked[0], fresh[0], rtol=0.0, atol=1.0e-12)
        assert np.allclose(asked[1], fresh[1], rtol=1.0e-12, atol=0.0)


def test_the_spread_is_the_root_of_the_covariance_that_all_rows_show() -> None:
    random = np.random.default_rng(2)
    effect = random.standard_normal((40, 6)) * np.array([30.0, 3.0, 1.0, 0.1, 1.0e-3, 0.0])
    spread = spread_of(effect)
    root = np.eye(40) - spread @ spread.T
    assert spread.shape[1] < effect.shape[1]
    assert root @ (np.eye(40) + effect @ effect.T) @ root == pytest.approx(np.eye(40), abs=2.0e-3)


def test_a_force_of_many_corners_goes_in_chords_that_the_position_does_not_show() -> None:
    signal = parameter_set("nominal").nameplate.signal
    assert signal is not None
    made = recorded(
        "nominal", noise_m=20.0e-6, waveform=sine(10.0, 2, *signal.range_pa, corners_per_period=4000), seed=2
    )
    motion, path = read_motion(made.recording, made.nameplate), input_path(made.recording, made.nameplate)
    assert isinstance(motion, RecordedMotion)
    assert isinstance(path, MeasuredPath)
    problem = pose(motion, path)
    assert problem is not None
    values = problem.trials[0].values
    fewer = thinned(problem.model, values)
    dense, thin = problem.model.corners(values), fewer.corners(values)
    assert thin[0].size < 0.3 * dense[0].size
    off_n = np.interp(dense[0], *thin) - dense[1]
    assert float(np.abs(off_n).max()) < 0.05 * values["k"] * 20.0e-6
    area = float(np.sum(0.5 * np.diff(dense[0]) * (off_n[1:] + off_n[:-1])))
    assert abs(area) < 1.0e-4 * values["k"] * 20.0e-6 * 20.0


def test_a_mass_at_the_end_of_its_range_and_a_limit_at_the_ramps_speed_are_not_given() -> None:
    model, start = _widened()
    known = {symbol: measured(1.0, 1.0e-3) for symbol in SYMBOLS}
    number = model.coordinates.names.index("m")
    light = start.copy()
    light[number] = model.coordinates.lower[number]
    assert not without_mass_at_bound(known, model, light)["m"].identifiable
    assert without_mass_at_bound(known, model, start)["m"].identifiable
    undamped = known | {"F_v": absent("hidden")}
    assert not without_lone_limit(undamped, 4.0e-3, 4.2e-3)["m"].identifiable
    assert not without_lone_limit(undamped, 4.0e-3, 4.2e-3)["DV"].identifiable
    assert without_lone_limit(undamped, 0.4e-3, 4.2e-3)["m"].identifiable
    assert without_lone_limit(known, 4.0e-3, 4.2e-3)["DV"].identifiable


def test_a_descent_with_many_errors_ends_soon_after_the_simulations_that_it_may_take() -> None:
    model, start = _widened()
    found = descend_with_errors(model, start, most_steps=60, most_simulations=150)
    assert found.simulations < 150 + 4 * start.size
    assert found.cost <= model.cost(start)
