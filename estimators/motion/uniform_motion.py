"""Uniform motion: spring rate, friction at the ramp's speed, preload (Romano & Garcia 2007, Eq. 11, 19, 20)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.linear_fit import fit_linear
from estimators.motion.phases import Phases, Stretch
from estimators.samples import BoolArray, FloatArray, Samples
from valve.nameplate import Action

# Own choices. The rest of a stretch is steady where its first 40 % is over 9 time constants of a transient.
_STEADY_SHARE: Final = 0.6
_LARGEST_SPEED_CHANGE: Final = 0.15  # between the halves of a steady part
_STEADY_SPEED_CHANGE: Final = 0.03
_LEAST_WAY: Final = 0.01  # of the travel seen
_FEWEST_ROWS: Final = 4
_ROWS_OF_A_RAMP: Final = 40
_SPEEDS_APART: Final = 0.2  # speeds that differ by less than this share of their median count as one
_PLATEAU: Final = 0.97
_AGAINST: Final = 0.5  # correlation of position and force below minus that: friction makes it smaller, never negative
_SURELY: Final = 3.0  # standard deviations of a curvature


@dataclass(frozen=True, slots=True, eq=False)
class UniformMotion:
    """Fit of F = k x + F_0 +- (A + F_v (v - v_ref)) to rows in uniform motion; A = F_c + F_v v_ref.

    ``covariance`` is that of (k, A, F_0). In one direction A and F_0 are known in their sum or difference only:
    then ``friction_n`` holds A + F_0 (up) or A - F_0 (down), and ``preload_n`` is None.
    ``viscous_n_s_per_m`` is there where the ramps had several speeds, with its standard error.
    """

    spring_n_per_m: float
    friction_n: float
    preload_n: float | None
    covariance: FloatArray
    reference_speed: float
    viscous_n_s_per_m: tuple[float, float] | None
    directions: frozenset[int]
    rows: BoolArray
    residual_rms_n: float

    @property
    def std_error(self) -> FloatArray:
        """Standard errors of k, A and F_0, shape (3,)."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.covariance), 0.0, None)))


def steady_rows(samples: Samples, phases: Phases, action: Action) -> tuple[BoolArray, list[tuple[Stretch, slice]]]:
    """Rows in uniform motion, shape (n,), and the same stretch by stretch."""
    chosen = np.zeros(samples.count, dtype=np.bool_)
    parts: list[tuple[Stretch, slice]] = []
    changes: list[float] = []
    travel_m = float(np.ptp(samples.position_m))
    for stretch in phases.stretches:
        part = _plateau(phases, stretch) if action is Action.DOUBLE else _settled(samples, phases, stretch)
        if part is None:
            continue
        way_m = abs(float(samples.position_m[part.stop - 1] - samples.position_m[part.start]))
        if way_m >= _LEAST_WAY * travel_m + 6.0 * samples.position_noise_m:
            parts.append((stretch, part))
            changes.append(_speed_change(phases.velocity[part]))
    # the steadiest ones of each direction; what varies more is not settled yet, or hindered
    kept = []
    for direction in (1, -1):
        own = [(part, change) for part, change in zip(parts, changes, strict=True) if part[0].direction == direction]
        least = min((change for _, change in own), default=0.0)
        limit = min(_LARGEST_SPEED_CHANGE, max(_STEADY_SPEED_CHANGE, 2.0 * least))
        kept += [part for part, change in own if change <= limit]
    kept.sort(key=lambda part: part[0].first)
    for _, part in kept:
        chosen[part] = True
    return chosen, kept


def _speed_change(velocity: FloatArray) -> float:
    """Change of the mean speed from the first half to the second, as a share of the faster one."""
    half = velocity.size // 2
    early, late = abs(float(velocity[:half].mean())), abs(float(velocity[half:].mean()))
    return abs(early - late) / max(early, late)


def _settled(samples: Samples, phases: Phases, stretch: Stretch) -> slice | None:
    """The last part of a driven stretch, clear of what comes after it."""
    if not stretch.driven:
        return None
    time_s = samples.time_s
    length_s = float(time_s[stretch.last] - time_s[stretch.first])
    begin_s = float(time_s[stretch.first]) + (1.0 - _STEADY_SHARE) * length_s
    begin = int(np.searchsorted(time_s, begin_s))
    end = stretch.last - phases.half_window - 3
    if end + 1 - begin < _FEWEST_ROWS and _are_long(phases):
        end = stretch.last - 1  # too short to be so careful: the corner that ended it is known to the row
    return slice(begin, end + 1) if end + 1 - begin >= _FEWEST_ROWS else None


def _are_long(phases: Phases) -> bool:
    """Whether ramps have rows enough that a short stretch is a slip at its end and not a rate that is too low."""
    return phases.corners.size > 1 and float(np.median(np.diff(phases.corners))) >= _ROWS_OF_A_RAMP


def _plateau(phases: Phases, stretch: Stretch) -> slice | None:
    """The longest part of a stretch at its top speed: without a spring uniform motion needs a constant force."""
    speed = np.abs(phases.velocity[stretch.rows])
    fast = np.concatenate([[False], speed > _PLATEAU * float(np.quantile(speed, 0.9)), [False]])
    edges = np.flatnonzero(fast[1:] != fast[:-1])
    if edges.size == 0:
        return None
    lengths = edges[1::2] - edges[::2]
    longest = int(np.argmax(lengths))
    trim = phases.half_window + 1
    begin, end = stretch.first + int(edges[2 * longest]) + trim, stretch.first + int(edges[2 * longest + 1]) - trim
    return slice(begin, end) if end - begin >= _FEWEST_ROWS else None


def fit_uniform_motion(samples: Samples, phases: Phases, action: Action) -> UniformMotion | Outcome:
    """Return the fit, or the outcome where no uniform motion is there to fit."""
    rows, parts = steady_rows(samples, phases, action)
    if not parts:
        if _moves_against(samples, phases):
            return Outcome.UNPHYSICAL
        short = max(stretch.last - stretch.first for stretch in phases.stretches)
        return Outcome.RATE_TOO_LOW if short < 3 * _FEWEST_ROWS + phases.half_window else Outcome.NO_UNIFORM_MOTION
    return _fit(samples, action, rows, parts)


def _moves_against(samples: Samples, phases: Phases) -> bool:
    """Whether the stem moves where the force falls, and the other way: a channel's sign or zero is turned."""
    if any(stretch.driven for stretch in phases.stretches):
        return False
    off_m, off_n = samples.position_m - samples.position_m.mean(), samples.force_n - samples.force_n.mean()
    return float(off_m @ off_n) < -_AGAINST * math.sqrt(float(off_m @ off_m) * float(off_n @ off_n))


def _fit(
    samples: Samples, action: Action, rows: BoolArray, parts: list[tuple[Stretch, slice]]
) -> UniformMotion | Outcome:
    sense, speed, drift = np.zeros(samples.count), np.zeros(samples.count), np.zeros(samples.count)
    speeds = []
    for stretch, part in parts:
        sense[part] = stretch.direction
        time_s = samples.time_s[part] - samples.time_s[part].mean()
        speeds.append(abs(float(time_s @ samples.position_m[part]) / float(time_s @ time_s)))
        speed[part] = speeds[-1]
        drift[part] = stretch.direction * _speed_drift(time_s, samples.position_m[part], samples.position_noise_m)
    directions = frozenset(stretch.direction for stretch, _ in parts)
    reference = float(np.median(speeds))
    several = max(speeds) - min(speeds) > _SPEEDS_APART * reference
    names = [] if action is Action.DOUBLE else ["k"]
    names += ["A", "F_0"] if len(directions) == 2 else ["A"]
    columns = {"k": samples.position_m, "A": sense, "F_0": np.ones(samples.count)}
    matrix = [columns[name] for name in names]
    if several:
        matrix.append(sense * (speed - reference))
    noise = np.zeros((len(matrix), len(matrix)))
    if action is not Action.DOUBLE:
        noise[0, 0] = samples.position_noise_m**2
    fit = fit_linear(np.stack(matrix, axis=1), samples.force_n, rows, noise)
    if fit is None:
        return Outcome.NO_UNIFORM_MOTION
    # the attenuation by noise in x is known well enough here to be taken out
    coefficients = fit.coefficients + fit.noise_bias
    found = dict(zip(names, coefficients, strict=False))
    covariance = np.zeros((3, 3))
    places = [("k", "A", "F_0").index(name) for name in names]
    most = 0.5 * float(np.ptp(samples.force_n)) if len(directions) == 1 else abs(float(found["A"]))
    known = fit.covariance
    if action is not Action.DOUBLE:
        known = known + _by_drift(np.stack(matrix, axis=1)[rows], (sense * drift)[rows], most / reference)
    covariance[np.ix_(places, places)] = known[: len(names), : len(names)]
    viscous = (float(coefficients[-1]), float(np.sqrt(fit.covariance[-1, -1]))) if several else None
    one_way = next(iter(directions)) if len(directions) == 1 else 0
    return UniformMotion(
        spring_n_per_m=float(found.get("k", 0.0)),
        friction_n=float(found["A"]),
        preload_n=None if one_way else float(found["F_0"]),
        covariance=covariance,
        reference_speed=reference,
        viscous_n_s_per_m=viscous,
        directions=directions,
        rows=rows,
        residual_rms_n=fit.residual_rms,
    )


def _speed_drift(time_s: FloatArray, position_m: FloatArray, noise_m: float) -> FloatArray:
    """How the velocity of a part goes on from its mean, m/s, shape (n,), by a parabola; 0 where noise may be all of it.

    ``time_s`` (n,) are about their mean.
    """
    bend = time_s * time_s
    bend = bend - bend.mean()
    bend -= time_s * float(time_s @ bend) / float(time_s @ time_s)
    size = float(bend @ bend)
    if size <= 0.0:
        return np.zeros(time_s.size)
    curvature = float(bend @ position_m) / size
    sure = max(0.0, curvature * curvature - _SURELY**2 * noise_m**2 / size)
    return np.asarray(2.0 * np.copysign(np.sqrt(sure), curvature) * time_s)


def _by_drift(matrix: FloatArray, drift: FloatArray, most_viscous: float) -> FloatArray:
    """Covariance, (p, p), by F_v times speeds that drift, (n,): F_v is anything from 0 to A/v, and no column has it."""
    if not drift.any() or not np.isfinite(most_viscous):
        return np.zeros((matrix.shape[1], matrix.shape[1]))
    moved = np.linalg.lstsq(matrix, drift, rcond=None)[0] * most_viscous / np.sqrt(3.0)
    return np.asarray(np.outer(moved, moved))
