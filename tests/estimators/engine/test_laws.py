"""Laws beyond the plain valve: a fit takes their parameters in, and the motion's slopes by them are right."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from estimators.base import Outcome
from estimators.engine.fields import no_fields
from estimators.engine.fit import concluded, descend
from estimators.engine.laws import Law, LawParameter, Laws, Where
from estimators.engine.model import Model, Unknowns
from estimators.engine.noise import PositionNoise
from estimators.engine.parameters import GLOBALS, Known, prior_of
from estimators.engine.reading import read
from estimators.engine.sections import sections_of
from tests.support.rough_valves import case
from valve.effects import Effect
from valve.effects.spring_hardening import SpringHardening

FloatArray = npt.NDArray[np.float64]
_VALVE = "vendor"


class _Hardening(Law):
    parameters = (LawParameter("rise", "N/m^2", -4.0e5, 4.0e5, 0.0, 2.0e5, 0.0, 10.0),)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        return np.asarray(-0.5 * values[0] * where.travel_m**2)


@cache
def _reading(effect: Effect | None) -> tuple[Model, Unknowns]:
    """The model of an ideal valve with this effect, at the values it was made with."""
    made = case(_VALVE, "triangle", "ideal", seed=3, effects=[] if effect is None else [effect])
    reading = read(made.recording, made.nameplate)
    assert not isinstance(reading, Outcome)
    sections = sections_of(reading, Known(0.01, 0.02))
    truth = made.truth.parameters
    parameters = np.zeros(GLOBALS)
    parameters[:4] = np.log([truth.mass_kg, truth.viscous_friction_n_s_per_m, truth.spring_rate_n_per_m, 1.0e-3])
    parameters[4:7] = truth.preload_n, truth.coulomb_friction_n, truth.static_friction_n
    parameters[7] = np.log(truth.limit_velocity_m_per_s)
    noise = PositionNoise(1.0e-5, 2.0e-6, 0.02)
    model = Model(sections, no_fields(), noise, prior_of(600.0, (0.0, 1.0e-4)), noise, 1.0)
    began_s = np.array([one.began_s for one in sections.sections])
    rest_m = np.array([one.rest_m for one in sections.sections])
    return model, Unknowns(parameters, np.empty(0), began_s, rest_m)


def _with(law: Law, effect: Effect | None = None) -> tuple[Model, Unknowns]:
    model, unknowns = _reading(effect)
    laws = Laws((law,))
    return replace(model, laws=laws), replace(unknowns, laws=laws.start)


def test_a_law_that_does_nothing_changes_nothing() -> None:
    plain, unknowns = _reading(None)
    model, same = _with(_Hardening())
    paths = model.followed_paths(same, model.measured_paths())
    assert model.squares(same, paths) == pytest.approx(plain.squares(unknowns, paths), rel=1.0e-12)


def test_the_right_side_is_the_slope_of_the_squares_by_the_laws_parameter() -> None:
    law = _Hardening()
    model, unknowns = _with(law)
    paths = model.followed_paths(unknowns, model.measured_paths())
    one = model.linearised(unknowns, paths)
    step = 0.5 * law.parameters[0].step
    squares = [
        model.squares(replace(unknowns, laws=unknowns.laws + sign * step), paths)
        - float(((unknowns.laws[0] + sign * step - model.laws.mean[0]) / model.laws.spread[0]) ** 2)
        for sign in (1.0, -1.0)
    ]
    slope = (squares[0] - squares[1]) / (2.0 * step)
    assert -2.0 * one.right[unknowns.first_law] == pytest.approx(slope, rel=0.1)


def test_a_fit_finds_how_much_the_spring_hardens() -> None:
    true = 1.0e5
    model, unknowns = _with(_Hardening(), SpringHardening(true))
    for heat in (30.0, 3.0, 1.0):
        unknowns, *_ = descend(model.heated(heat, 1.0), unknowns, model.measured_paths(), 8)
    assert unknowns.laws[0] == pytest.approx(true, rel=0.02)


def test_a_motion_whose_slopes_are_no_numbers_ends_the_descent_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    model, unknowns = _reading(None)
    paths = model.followed_paths(unknowns, model.measured_paths())
    good = model.linearised(unknowns, paths)
    normal = good.normal.copy()
    normal[0, 0] = np.inf
    monkeypatch.setattr(Model, "linearised", lambda *_: replace(good, normal=normal))
    ended, same, squares = descend(model, unknowns, paths, 3)
    assert ended is unknowns
    assert concluded(model, ended, same, squares).surprise == np.inf
