"""One step of a descent: that of the damped normal equations, within bounds and no longer than allowed."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.likelihood.step_kernel import bounded_step

COUNT = 5
FAR = np.full(COUNT, 1.0e9)
EVERY = np.ones(COUNT, dtype=np.bool_)


def equations(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A positive definite matrix, shape (5, 5), with rows of very different size, and a right side."""
    generator = np.random.default_rng(seed)
    root = generator.normal(size=(COUNT, 20)) * np.array([1.0e-3, 1.0, 1.0e3, 10.0, 0.1])[:, None]
    return root @ root.T, root @ generator.normal(size=20)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_far_from_all_bounds_the_step_solves_the_damped_equations(seed: int) -> None:
    normal, pull = equations(seed)
    step = bounded_step(normal, pull, 0.3, EVERY, np.zeros(COUNT), -FAR, FAR, FAR)
    assert step == pytest.approx(np.linalg.solve(normal + 0.3 * np.diag(np.diag(normal)), pull), rel=1.0e-10)


def test_what_would_leave_its_bounds_goes_to_the_bound_and_the_others_follow_it() -> None:
    normal, pull = equations(3)
    free = bounded_step(normal, pull, 0.0, EVERY, np.zeros(COUNT), -FAR, FAR, FAR)
    upper = FAR.copy()
    upper[1] = 0.5 * free[1] if free[1] > 0.0 else 1.0e9
    lower = -FAR
    lower[1] = 0.5 * free[1] if free[1] < 0.0 else -1.0e9
    step = bounded_step(normal, pull, 0.0, EVERY, np.zeros(COUNT), lower, upper, FAR)
    others = [0, 2, 3, 4]
    right = pull[others] - normal[others, 1] * 0.5 * free[1]
    assert step[1] == pytest.approx(0.5 * free[1])
    assert step[others] == pytest.approx(np.linalg.solve(normal[np.ix_(others, others)], right), rel=1.0e-9)


def test_what_is_held_or_not_seen_stays_and_the_longest_step_shortens_all() -> None:
    normal, pull = equations(4)
    normal[2, :] = normal[:, 2] = 0.0
    may_move = EVERY.copy()
    may_move[0] = False
    step = bounded_step(normal, pull, 0.1, may_move, np.zeros(COUNT), -FAR, FAR, FAR)
    assert step[0] == step[2] == 0.0
    longest = np.full(COUNT, 0.25 * float(np.abs(step).max()))
    assert bounded_step(normal, pull, 0.1, may_move, np.zeros(COUNT), -FAR, FAR, longest) == pytest.approx(0.25 * step)


def test_equations_that_are_singular_to_rounding_give_each_unknown_its_own_step() -> None:
    normal, pull = np.ones((COUNT, COUNT)), np.arange(1.0, COUNT + 1.0)
    step = bounded_step(normal - 1.0e-3 * np.tri(COUNT, k=-1), pull, 0.0, EVERY, np.zeros(COUNT), -FAR, FAR, FAR)
    assert np.isfinite(step).all()
