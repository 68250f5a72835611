"""The noise taken out of residuals and slopes, and their products, beside dense algebra."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from estimators.engine.fields import fields_on
from estimators.engine.roughness import ROUGH, Roughness
from estimators.engine.whitening import gather, surprises, whitened

_COLOURED, _COLOURED_S = 4.0e-12, 0.02


def _rows() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, white variances, and lines of which some are zero but for a few rows."""
    draw = np.random.default_rng(4)
    time_s = np.cumsum(draw.uniform(0.001, 0.02, 200))
    lines = draw.normal(0.0, 1.0e-5, (6, 200))
    lines[3, :50] = lines[3, 60:] = 0.0
    lines[4, :190] = 0.0
    lines[5] = 0.0
    return time_s, draw.uniform(1.0e-12, 9.0e-12, 200), lines


def _covariance(time_s: np.ndarray, white: np.ndarray) -> np.ndarray:
    away_s = np.abs(time_s[:, None] - time_s)
    return np.asarray(np.diag(white) + _COLOURED * np.exp(-away_s / _COLOURED_S))


def test_whitened_lines_have_the_products_of_the_dense_inverse() -> None:
    time_s, white, lines = _rows()
    covariance = _covariance(time_s, white)
    out, logarithms = whitened(time_s, lines, white, _COLOURED, _COLOURED_S)
    assert out @ out.T == pytest.approx(lines @ np.linalg.solve(covariance, lines.T), rel=1.0e-9, abs=1.0e-9)
    assert logarithms == pytest.approx(float(np.linalg.slogdet(covariance)[1]), rel=1.0e-12)


def test_gathered_products_are_those_of_all_slopes() -> None:
    time_s, white, lines = _rows()
    out, _ = whitened(time_s, lines, white, _COLOURED, _COLOURED_S)
    numbers = np.array([7, 2, 0, 4, 5])
    normal, right = np.zeros((8, 8)), np.zeros(8)
    gather(out, numbers, normal, right)
    assert normal[np.ix_(numbers, numbers)] == pytest.approx(out[1:] @ out[1:].T, rel=1.0e-9, abs=1.0e-9)
    assert right[numbers] == pytest.approx(out[1:] @ out[0], rel=1.0e-9, abs=1.0e-9)
    assert not normal[[1, 3, 6]].any()


def test_several_sections_are_as_likely_as_each_by_itself() -> None:
    time_s, white, lines = _rows()
    firsts = np.array([0, 70, 130, 200])
    whole = np.zeros(2)
    for first, end in pairwise(firsts.tolist()):
        out, logarithms = whitened(time_s[first:end], lines[:1, first:end], white[first:end], _COLOURED, _COLOURED_S)
        whole += float((out**2).sum()), logarithms
    assert surprises(time_s, lines[0], white, firsts, _COLOURED, _COLOURED_S) == pytest.approx(whole, rel=1.0e-12)


def test_the_friction_of_a_path_is_that_of_the_shares_of_its_knots() -> None:
    draw = np.random.default_rng(5)
    fields = fields_on(np.linspace(0.0, 0.1, 12), np.arange(0.0, 5.0), Roughness(10.0, 5.0, 0.02, 4.0, 9.0, 1.0), ROUGH)
    values = draw.normal(0.0, 10.0, fields.count)
    path_m, time_s = draw.uniform(-0.01, 0.11, 40), np.sort(draw.uniform(0.5, 3.5, 40))
    for opening in (True, False):
        both = np.full(path_m.size, opening)
        touched, shares = fields.beside(path_m, time_s, both)
        assert fields.friction_n(path_m, time_s, both, values) == pytest.approx((values[touched] * shares).sum(axis=1))
