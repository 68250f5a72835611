"""A step of the dynamic fit: within its box, and what it promises."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.engine.fit import quadratic


def test_what_a_box_holds_stands_at_its_side_and_the_others_answer_to_it() -> None:
    draw = np.random.default_rng(4)
    root = draw.normal(size=(12, 12)) * np.geomspace(1.0, 1.0e4, 12)
    normal, right, damping = root.T @ root, root.T @ draw.normal(size=12), 1.0e-3
    about = quadratic(normal, right)
    free = about.within(damping, (np.full(12, -np.inf), np.full(12, np.inf)))
    assert free is not None
    side = np.where(np.arange(12) % 3 == 0, 0.5 * np.abs(free), np.inf)
    step = about.within(damping, (-side, side))
    assert step is not None
    assert (np.abs(step) <= side).all()
    held = np.abs(step) == side
    assert held[::3].any()
    left = right - (normal + damping * np.diag(np.diag(normal))) @ step
    assert np.abs(left[~held] / np.sqrt(np.diag(normal))[~held]).max() < 1.0e-8
    assert about.promised(step) == pytest.approx(2.0 * right @ step - step @ normal @ step)


def test_equations_that_determine_nothing_give_no_step() -> None:
    nowhere = np.full(2, math.nan)
    assert quadratic(-np.eye(2), np.ones(2)).within(1.0e-3, (nowhere, nowhere)) is None
