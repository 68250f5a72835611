"""Where the fit begins: spring, friction and preload by a force balance, the rest of the unknowns on a grid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from estimators.motion.phases import After
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.rests import Breakaway
from estimators.motion.static_friction import breakaway_forces
from estimators.samples import BoolArray, FloatArray, Samples

# Own choices: the masses tried, kg, and the viscous shares of the friction in motion; DV as a share of the speed, and
# F_s as one of the friction in motion.
_MASSES_KG: Final = (0.2, 0.8, 3.0, 12.0, 50.0)
_VISCOUS_SHARES: Final = (0.9, 0.5, 0.2, 0.06, 0.02, 0.003)
_LIMIT_SHARES: Final = (0.015, 0.4, 0.9, 1.4)
_STATIC_SHARES: Final = (0.0, 1.08, 1.25, 1.5)
_DAMPINGS: Final = (0.02, 0.1, 0.3, 0.6, 0.9, 1.5, 4.0)  # ratios, of a stem that jumps
_SAME: Final = 0.02
_UNKNOWN: Final = 3  # k, F_s and F_0: as many breakaways are enough for a start
_MANY: Final = 6  # breakaways: of fewer no two need follow each other in one sense
_SETTLED_SHARE: Final = 0.3  # of a stretch, left out of a balance


@dataclass(frozen=True, slots=True)
class FirstGuess:
    """k (N/m), F_0 (N), the friction A (N) in motion at ``speed`` (m/s), F_s (N), and how long its jumps are, m."""

    spring_n_per_m: float
    preload_n: float
    friction_n: float
    speed: float
    static_n: float
    jump_m: float | None = None


def first_guesses(motion: RecordedMotion) -> list[FirstGuess]:
    """Return what the force balances give, the most trusted first: uniform motion, all motion, breakaways."""
    found = [_from_uniform_motion(motion), _from_all_motion(motion), _from_breakaways(motion), _from_all_rows(motion)]
    if motion.uniform is None:
        # the jumps of a staircase tell more than its mean motion
        found.insert(0, found.pop(2))
    return distinct([guess for guess in found if guess is not None])


def _from_uniform_motion(motion: RecordedMotion) -> FirstGuess | None:
    uniform = motion.uniform
    if uniform is None:
        return None
    preload_n, friction_n = uniform.preload_n, uniform.friction_n
    if preload_n is None:
        # one direction shows their sum or difference only: half of the force at rest is as good as any share
        sense = next(iter(uniform.directions))
        total_n = friction_n
        friction_n = 0.2 * float(np.ptp(motion.samples.force_n))
        preload_n = sense * (total_n - friction_n)
    return _checked(motion, uniform.spring_n_per_m, preload_n, friction_n, uniform.reference_speed)


def _from_all_motion(motion: RecordedMotion) -> FirstGuess | None:
    """By least squares of F = k x + F_0 +- (A + F_v (|v| - v_ref)) over all that moves, slips left out."""
    samples, phases = motion.samples, motion.phases
    chosen = np.zeros(samples.count, dtype=np.bool_)
    sense = np.zeros(samples.count)
    for stretch in phases.stretches:
        skipped = int(_SETTLED_SHARE * (stretch.last - stretch.first)) if stretch.after is After.BREAKAWAY else 0
        chosen[stretch.first + skipped : stretch.last + 1] = True
        sense[stretch.rows] = stretch.direction
    if np.count_nonzero(chosen) < 8 or len(phases.directions) < 2:
        return None
    pace = np.abs(phases.velocity)
    speed = float(np.median(pace[chosen]))
    columns = [samples.position_m, sense, np.ones(samples.count), sense * (pace - speed)]
    solved = _solved([column[chosen] for column in columns], samples.force_n[chosen])
    if solved is None:
        return None
    return _checked(motion, float(solved[0]), float(solved[2]), float(solved[1]), speed)


def _from_breakaways(motion: RecordedMotion) -> FirstGuess | None:
    """By least squares of F = k x + F_0 +- F_s over the breakaways; the friction in motion is taken as 0.8 of it."""
    jumps_alone = motion.uniform is None
    solved = breakaway_balance(motion.samples, motion.phases.breakaways, _UNKNOWN if jumps_alone else _UNKNOWN + 1)
    if solved is None:
        return None
    static_n = float(solved[1])
    sense = np.array([float(breakaway.direction) for breakaway in motion.phases.breakaways])
    rest_m = np.array([breakaway.rest_m for breakaway in motion.phases.breakaways])
    # a lightly damped jump is 2 (F_s - F_c)/k long
    jump_m = _jump(rest_m, sense) if jumps_alone else None
    spring, preload_n = float(solved[0]), float(solved[2])
    return FirstGuess(spring, preload_n, 0.8 * static_n, motion.phases.moving_speed, static_n, jump_m)


def _jump(rest_m: FloatArray, sense: FloatArray) -> float | None:
    """How long a jump is, m, by the rests that the stem broke away from, shape (b,), and their senses; None for none.

    From one rest to the next where the sense stays. Of few breakaways, one a ramp, it is the shorter one of those to
    where the stem turned: a jump that was not seen makes the other longer, or ends where it began.
    """
    moved_m = np.diff(rest_m)
    if rest_m.size >= _MANY:
        steps_m = np.abs(moved_m)[sense[1:] == sense[:-1]]
        return float(np.median(steps_m)) if steps_m.size > 0 else None
    jumps_m = np.sort((moved_m * sense[:-1])[moved_m * sense[:-1] > 0.0])
    return float(jumps_m[(jumps_m.size - 1) // 2]) if jumps_m.size > 0 else None


def breakaway_balance(
    samples: Samples, breakaways: Sequence[Breakaway], fewest: int = _UNKNOWN + 1
) -> FloatArray | None:
    """k, F_s and F_0, shape (3,), by least squares of F = k x + F_0 +- F_s over the breakaways; None for too few."""
    rows = np.array([breakaway.row for breakaway in breakaways], dtype=np.int64)
    sense = np.array([float(breakaway.direction) for breakaway in breakaways])
    if rows.size < fewest or np.unique(sense).size < 2:
        return None
    rest_m = np.array([breakaway.rest_m for breakaway in breakaways])
    solved = _solved([rest_m, sense, np.ones(rows.size)], samples.force_n[rows])
    return solved if solved is not None and solved[0] > 0.0 and solved[1] > 0.0 else None


def _from_all_rows(motion: RecordedMotion) -> FirstGuess | None:
    """By the middle line of force over position: k and F_0; the friction is what is off it."""
    samples = motion.samples
    solved = _solved([samples.position_m, np.ones(samples.count)], samples.force_n)
    if solved is None or not solved[0] > 0.0:
        return None
    off_n = np.abs(samples.force_n - solved[0] * samples.position_m - solved[1])
    friction_n = float(np.quantile(off_n, 0.7))
    return _checked(motion, float(solved[0]), float(solved[1]), friction_n, motion.phases.moving_speed)


def _solved(columns: list[FloatArray], target: FloatArray) -> FloatArray | None:
    matrix = np.stack(columns, axis=1)
    scale = np.sqrt(np.mean(matrix * matrix, axis=0))
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return None
    solution, _residual, rank, _values = np.linalg.lstsq(matrix / scale, target, rcond=1.0e-9)
    return np.asarray(solution / scale) if rank == scale.size else None


def _checked(
    motion: RecordedMotion, spring: float, preload_n: float, friction_n: float, speed: float
) -> FirstGuess | None:
    """The guess with its F_s from the breakaways; None where it is no valve's."""
    if not (spring > 0.0 and friction_n > 0.0 and speed > 0.0):
        return None
    forces = breakaway_forces(motion.samples, motion.phases, spring, preload_n)
    static_n = friction_n if forces is None else max(forces.value, 0.3 * friction_n)
    return FirstGuess(spring, preload_n, friction_n, speed, static_n)


@dataclass(frozen=True, slots=True)
class Trial:
    """Values by name, and the classes that they belong to: DV as a share of the speed, F_s as one of the friction."""

    values: dict[str, float]
    limit_share: float
    static_share: float


def trials(guess: FirstGuess, nameplate_mass_kg: float | None, fastest_m_per_s: float) -> Iterator[Trial]:
    """Return m, k, F_v, F_c, d, DV and F_0 by name for each mass, viscous share, DV and F_s to be tried with a guess.

    The force at breakaway is tried first as F_s (share 0), for it may be seen late and F_s lie above or below it.
    """
    masses_kg = _MASSES_KG if nameplate_mass_kg is None else (*_MASSES_KG, nameplate_mass_kg)
    if guess.jump_m is not None:
        yield from _jumping_trials(guess, guess.jump_m, masses_kg, fastest_m_per_s)
        return
    for viscous_share, limit_share, static_share in product(_VISCOUS_SHARES, _LIMIT_SHARES, _STATIC_SHARES):
        coulomb_n = (1.0 - viscous_share) * guess.friction_n
        static_n = static_share * guess.friction_n if static_share > 0.0 else guess.static_n
        for mass_kg in masses_kg:
            values = {
                "m": mass_kg,
                "k": guess.spring_n_per_m,
                "F_v": viscous_share * guess.friction_n / guess.speed,
                "F_c": coulomb_n,
                "d": max(0.0, static_n / coulomb_n - 1.0),
                "DV": min(limit_share * guess.speed, 0.95 * fastest_m_per_s),
                "F_0": guess.preload_n,
            }
            yield Trial(values, limit_share, static_share)


def _jumping_trials(
    guess: FirstGuess, jump_m: float, masses_kg: tuple[float, ...], fastest_m_per_s: float
) -> Iterator[Trial]:
    """Trials for a stem that jumps and sticks: (1 + exp(-pi z/sqrt(1 - z^2))) (F_s - F_c)/k long at damping ratio z."""
    for damping, limit_share in product(_DAMPINGS, _LIMIT_SHARES[:2]):
        beyond = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)) if damping < 1.0 else 0.0
        coulomb_n = max(guess.static_n - guess.spring_n_per_m * jump_m / (1.0 + beyond), 0.02 * guess.static_n)
        for mass_kg in masses_kg:
            values = {
                "m": mass_kg,
                "k": guess.spring_n_per_m,
                "F_v": 2.0 * damping * math.sqrt(guess.spring_n_per_m * mass_kg),
                "F_c": coulomb_n,
                "d": guess.static_n / coulomb_n - 1.0,
                "DV": min(limit_share * guess.speed, 0.95 * fastest_m_per_s),
                "F_0": guess.preload_n,
            }
            yield Trial(values, limit_share, damping)


def distinct(guesses: list[FirstGuess]) -> list[FirstGuess]:
    """Return the guesses without those that differ little from one before."""
    kept: list[FirstGuess] = []
    for guess in guesses:
        if not any(_is_near(guess, other) for other in kept):
            kept.append(guess)
    return kept


def _is_near(one: FirstGuess, other: FirstGuess) -> bool:
    spring = abs(one.spring_n_per_m / other.spring_n_per_m - 1.0) < _SAME
    friction = abs(one.friction_n / other.friction_n - 1.0) < 10.0 * _SAME
    return spring and friction and abs(one.preload_n - other.preload_n) < 2.0 * _SAME * other.friction_n


def resting_rows(motion: RecordedMotion) -> BoolArray:
    """Rows, shape (n,), between the stretches of motion."""
    resting = np.ones(motion.samples.count, dtype=np.bool_)
    for stretch in motion.phases.stretches:
        resting[stretch.rows] = False
    return resting
