"""The points of method 2 as published: two for k, one for F_s, three of a slip for m and F_v, one for F_c."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import Form
from estimators.classic.differences import backward_differences
from estimators.linear_fit import LinearFit
from estimators.motion.balance import Balance
from estimators.motion.phases import Stretch
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.static_friction import BreakawayForces, published_breakaway_forces
from estimators.motion.uniform_motion import UniformMotion, steady_rows
from estimators.samples import FloatArray, Samples
from valve.nameplate import Action

_SHIFT_SIGMAS: Final = 1.0e-3  # of a position's noise: the step of its influence on m and F_v


@dataclass(frozen=True, slots=True, eq=False)
class PublishedPoints:
    """What the published equations give: Eq. (11) and (19) as a balance, Eq. (12), and Eq. (17)-(18) as a fit."""

    balance: Balance
    breakaway: BreakawayForces | None
    slip: LinearFit | None


def published_points(motion: RecordedMotion, uniform: UniformMotion) -> PublishedPoints | None:
    """Choose the points and solve the equations; None without uniform motion.

    Points for k and F_c: the ends and the end of the last stretch up in steady motion (of the second or a further
    wave, as the paper asks), or of the last stretch down where there is none up.
    """
    samples = motion.samples
    _, parts = steady_rows(samples, motion.phases, motion.action)
    upward = [part for part in parts if part[0].direction > 0] or parts
    if not upward:
        return None
    stretch, rows = upward[-1]
    balance = _balance(motion, stretch, rows, uniform)
    forces = published_breakaway_forces(samples, motion.phases, balance.spring[0])
    first = None
    if forces is not None:
        first = BreakawayForces(forces.friction_n[:1], forces.timing_n[:1], forces.direction[:1], forces.time_s[:1])
    return PublishedPoints(balance, first, _slip(motion, balance.spring[0]))


def _balance(motion: RecordedMotion, stretch: Stretch, rows: slice, uniform: UniformMotion) -> Balance:
    """K by Eq. (11) from two points, and the friction there by Eq. (19) or (20)."""
    samples = motion.samples
    one, two = rows.start, rows.stop - 1
    way_m = float(samples.position_m[two] - samples.position_m[one])
    if motion.action is Action.DOUBLE or way_m == 0.0:
        spring, spring_error = 0.0, 0.0
    else:
        spring = float(samples.force_n[two] - samples.force_n[one]) / way_m
        noise_n = math.hypot(samples.force_noise_n, spring * samples.position_noise_m)
        spring_error = math.sqrt(2.0) * noise_n / abs(way_m)
    friction = stretch.direction * float(samples.force_n[two] - spring * samples.position_m[two])
    error = math.hypot(
        spring_error * float(samples.position_m[two]),
        math.hypot(samples.force_noise_n, spring * samples.position_noise_m),
    )
    return Balance(
        spring=(spring, spring_error),
        friction=(friction, error),
        preload=None,
        speed=uniform.reference_speed,
        one_direction=len(uniform.directions) < 2,
        form=Form.PUBLISHED,
        action=motion.action,
    )


def _slip(motion: RecordedMotion, spring: float) -> LinearFit | None:
    """M and F_v by Eq. (17) and (18) from three consecutive points just after the greatest speed of a slip.

    The covariance is that of the position noise through the five positions that the three points are made of.
    """
    samples = motion.samples
    velocity, acceleration = backward_differences(samples)
    allowed = motion.phases.differenced_rows(samples.count, coasting=motion.action is Action.DOUBLE) & np.isfinite(
        acceleration
    )
    # three rows in a row, the first two of which the next follows
    fits = allowed[:-2] & allowed[1:-1] & allowed[2:]
    starts = np.flatnonzero(fits)
    if starts.size == 0:
        return None
    change = np.abs(acceleration[starts]) if _is_slip_free(velocity, starts) else np.abs(velocity[starts])
    start = int(starts[np.argmax(change)])
    rows = slice(start - 2, start + 3)
    solved = _solve(samples, rows, samples.position_m[rows], spring)
    if solved is None:
        return None
    noise_m = samples.position_noise_m
    influence = np.zeros((2, 5))
    if noise_m > 0.0:
        for place in range(5):
            shift = np.zeros(5)
            shift[place] = _SHIFT_SIGMAS * noise_m
            moved = _solve(samples, rows, samples.position_m[rows] + shift, spring)
            influence[:, place] = np.inf if moved is None else (moved - solved) / _SHIFT_SIGMAS
    return LinearFit(solved, influence @ influence.T, np.zeros(2), 0.0, 3)


def _is_slip_free(velocity: FloatArray, starts: np.ndarray) -> bool:
    speed = np.abs(velocity[starts])
    return bool(float(speed.max()) < 1.5 * float(np.median(speed)))


def _solve(samples: Samples, rows: slice, position_m: FloatArray, spring: float) -> FloatArray | None:
    """Solve Eq. (17) and (18) for (m, F_v); None where the points do not determine them."""
    step_s = np.diff(samples.time_s[rows])
    velocity = np.diff(position_m) / step_s
    acceleration = np.diff(velocity) / (0.5 * (step_s[1:] + step_s[:-1]))
    unexplained = samples.force_n[rows][2:] - spring * position_m[2:]
    matrix = np.column_stack([np.diff(acceleration), np.diff(velocity[1:])])
    determinant = float(np.linalg.det(matrix))
    if abs(determinant) <= 1.0e-12 * float(np.prod(np.linalg.norm(matrix, axis=0))) or not math.isfinite(determinant):
        return None
    return np.asarray(np.linalg.solve(matrix, np.diff(unexplained)))
