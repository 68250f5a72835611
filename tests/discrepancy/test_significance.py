"""What counts as more than noise: the limits themselves, on residuals whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from discrepancy.diagnose import explains
from discrepancy.least_squares import Fit
from discrepancy.model import Model
from discrepancy.significance import (
    excess,
    gain,
    is_noise,
    is_settled,
    is_significant,
    misfit,
    noise_factor,
    wander,
)
from estimators.samples import FloatArray

COUNT = 4096
LAWS = ("presliding", "flow_force")


class _Observed:
    def __init__(self, rows: int) -> None:
        self.weight = np.ones(COUNT)
        self.count = COUNT
        self.rows = rows
        self.unresolved_rms = 0.0
        self.stepped_rms = 0.0
        self.has_exact_force = False


class _Model:
    def __init__(self, rows: int, causes: tuple[str, ...]) -> None:
        self.observed = _Observed(rows)
        self.causes = causes


def fit_of(residual: FloatArray, *, rows: int = COUNT, cost: float | None = None, causes: tuple[str, ...] = ()) -> Fit:
    """A fit that leaves these residuals of ``rows`` rows; its cost is their sum of squares where none is given."""
    model = cast("Model", cast("Any", _Model(rows, causes)))
    return Fit(model, np.zeros(1), residual, None, float(residual @ residual) if cost is None else cost)


@pytest.fixture
def white() -> FloatArray:
    return np.random.default_rng(1).standard_normal(COUNT)


def test_the_gain_is_the_fall_of_the_cost_in_what_the_better_fit_leaves_as_noise(white: FloatArray) -> None:
    after = fit_of(white, cost=4000.0)
    assert gain(fit_of(white, cost=4100.0), after) == pytest.approx(100.0)
    slow = np.repeat(np.random.default_rng(2).standard_normal(COUNT // 16), 16)
    hanging = fit_of(slow, cost=4000.0)
    assert noise_factor(hanging) == pytest.approx(16.0, rel=0.3)
    assert gain(fit_of(white, cost=4100.0), hanging) == pytest.approx(100.0 / noise_factor(hanging))


def test_a_motion_that_cannot_be_followed_gains_nothing_and_loses_to_any(white: FloatArray) -> None:
    lost = fit_of(white, cost=math.inf)
    assert gain(fit_of(white), lost) == 0.0
    assert gain(lost, fit_of(white)) == math.inf


@pytest.mark.parametrize(("fall", "counts"), [(44.0, False), (46.0, True)])
def test_a_fall_counts_from_forty_five_on(white: FloatArray, fall: float, counts: bool) -> None:
    assert is_significant(fit_of(white, cost=5000.0 + fall), fit_of(white, cost=5000.0)) == counts


@pytest.mark.parametrize(("share", "counts"), [(0.058, False), (0.062, True)])
def test_a_sure_fall_must_move_all_rows_by_six_hundredths_of_their_noise(
    white: FloatArray, share: float, counts: bool
) -> None:
    rows = 1_000_000
    before = fit_of(white, rows=rows, cost=5000.0 + share**2 * rows)
    assert is_significant(before, fit_of(white, rows=rows, cost=5000.0)) == counts


@pytest.mark.parametrize(("share", "counts"), [(0.029, False), (0.031, True)])
def test_half_of_that_is_enough_of_a_periodic_force(white: FloatArray, share: float, counts: bool) -> None:
    rows = 1_000_000
    before = fit_of(white, rows=rows, cost=5000.0 + share**2 * rows)
    assert is_significant(before, fit_of(white, rows=rows, cost=5000.0, causes=("vibration",))) == counts
    assert not is_significant(before, fit_of(white, rows=rows, cost=5000.0, causes=("flow_force",)))


def test_a_periodic_force_must_move_the_stem_by_more_than_a_converter_has_it_seem(white: FloatArray) -> None:
    rows = 1_000_000
    for share, counts in ((0.79, False), (0.81, True)):
        before = fit_of(white, rows=rows, cost=5000.0 + share**2 * rows)
        cast("Any", before.model.observed).stepped_rms = 0.8
        assert is_significant(before, fit_of(white, rows=rows, cost=5000.0, causes=("vibration",))) == counts


def test_half_of_that_is_enough_of_a_cause_that_leaves_noise_where_the_force_has_no_errors(white: FloatArray) -> None:
    rows = 1_000_000
    slow = np.repeat(np.random.default_rng(5).standard_normal(COUNT // 16), 16)
    for share, counts in ((0.029, False), (0.031, True)):
        after = fit_of(white, rows=rows, cost=5000.0, causes=("stribeck_friction",))
        before = fit_of(white, rows=rows, cost=5000.0 + share**2 * rows)
        cast("Any", before.model.observed).has_exact_force = True
        assert is_significant(before, after) == counts
        beside = fit_of(white, rows=rows, cost=before.cost, causes=("presliding",))
        cast("Any", beside.model.observed).has_exact_force = True
        assert not is_significant(beside, after)
        left = fit_of(0.9 * white + 0.4 * slow, rows=rows, cost=5000.0, causes=("stribeck_friction",))
        assert not is_noise(left)
        assert not is_significant(before, left)
        elastic = fit_of(white, rows=rows, cost=5000.0, causes=("presliding",))
        assert not is_significant(before, elastic)


@pytest.mark.parametrize(("scale", "noise"), [(1.14, True), (1.16, False)])
def test_noise_leaves_less_than_a_seventh_more_than_noise(scale: float, noise: bool) -> None:
    # signs that alternate have a misfit that is known exactly, and pieces without a mean
    residual = math.sqrt(scale) * np.resize([1.0, -1.0], COUNT)
    assert misfit(fit_of(residual)) == pytest.approx(scale)
    assert is_noise(fit_of(residual)) == noise


def test_what_hangs_together_is_no_noise_however_small_it_is() -> None:
    slow = np.repeat(np.random.default_rng(3).standard_normal(COUNT // 4), 4)
    assert misfit(fit_of(0.9 * slow)) < 1.0
    assert not is_noise(fit_of(0.9 * slow))


def test_a_little_that_hangs_together_is_the_fits_own_beside_a_large_misfit_that_it_took_away(
    white: FloatArray,
) -> None:
    slow = np.repeat(np.random.default_rng(4).standard_normal(COUNT // 16), 16)
    own = fit_of(0.95 * white + 0.22 * slow)
    assert 1.15 < noise_factor(own) < 2.0
    assert misfit(own) < 1.15
    for size, settled in ((30.5, False), (31.5, True)):
        before = fit_of(math.sqrt(size) * np.sign(white))
        assert excess(before) == pytest.approx(size - 1.0)
        assert is_settled(before, own) == settled
    far = fit_of(0.9 * white + 0.4 * slow)
    assert noise_factor(far) > 2.0
    assert not is_settled(fit_of(6.0 * np.sign(white)), far)


def test_a_wave_is_told_by_its_rms_in_noises_of_one_row(white: FloatArray) -> None:
    wave = 0.5 * math.sqrt(2.0) * np.sin(np.arange(COUNT) * 2.0 * math.pi / 1024.0)
    assert wander(fit_of(white + wave)) == pytest.approx(0.5, rel=0.15)
    # a block of 25 rows has a fifth of one row's noise
    assert wander(fit_of(white + wave, rows=25 * COUNT)) == pytest.approx(0.1, rel=0.15)


def test_the_misfit_is_a_mean_square(white: FloatArray) -> None:
    assert misfit(fit_of(2.0 * np.sign(white))) == pytest.approx(4.0)
    assert excess(fit_of(0.5 * np.sign(white))) == 0.0
    assert excess(replace(fit_of(2.0 * np.sign(white)))) == pytest.approx(3.0)


def test_what_the_errors_of_the_force_may_move_rows_by_is_no_cause(white: FloatArray) -> None:
    wave = 0.26 * np.sin(np.arange(COUNT) / 300.0)
    plain, other = fit_of(white + wave), fit_of(white)
    assert is_significant(replace(plain, cost=other.cost + 60.0), other)
    assert not explains(plain)
    for fit in (plain, other):
        cast("Any", fit.model.observed).unresolved_rms = 0.2
    assert not is_significant(replace(plain, cost=other.cost + 60.0), other)
    assert explains(plain)


def test_two_causes_explain_a_large_misfit_of_which_they_leave_less_than_what_mimics_them_would(
    white: FloatArray,
) -> None:
    slow = np.repeat(np.random.default_rng(2).standard_normal(COUNT // 256), 256)
    left = fit_of(0.9 * white + 0.12 * slow, causes=("presliding", "friction_drift"))
    assert noise_factor(left) > 1.5
    for missed, explained in ((100.0, True), (30.0, False)):
        assert explains(left, fit_of(missed * np.sign(slow))) == explained
    larger = fit_of(1.2 * white + 0.12 * slow, causes=("presliding", "friction_drift"))
    assert not explains(larger, fit_of(100.0 * np.sign(slow)))


@pytest.mark.parametrize(("share", "explained"), [(0.027, True), (0.033, False)])
def test_a_law_that_is_known_to_3_percent_explains_what_it_leaves_of_that(
    white: FloatArray, share: float, explained: bool
) -> None:
    slow = np.sign(np.repeat(np.random.default_rng(4).standard_normal(COUNT // 64), 64))
    missed, rows = 12.0, 10 * COUNT
    white = white - white.reshape(-1, 64).mean(axis=1).repeat(64)
    plain = fit_of(white + missed * slow, rows=rows)
    left = {name: fit_of(0.9 * white + share * missed * slow, rows=rows, causes=(name,)) for name in LAWS}
    assert misfit(left["presliding"]) < 1.15
    assert noise_factor(left["presliding"]) > 4.0
    assert explains(left["presliding"], plain) == explained
    assert not explains(left["flow_force"], plain)
