"""Mass and viscous friction from all slips at once: Garcia's Eq. (14)-(18) with many points instead of three."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.classic.differences import backward_differences, noise_covariance
from estimators.classic.threshold_sweep import sweep_thresholds
from estimators.linear_fit import LinearFit, fit_trimmed
from estimators.motion.balance import Balance
from estimators.motion.phases import After, Stretch
from estimators.motion.ramp_speeds import ramp_speeds
from estimators.motion.recorded_motion import RecordedMotion, young_rows
from estimators.motion.settling import inertial_rows
from estimators.samples import BoolArray, FloatArray
from valve.nameplate import Action

# A transient is fitted over its first 1.25^n rows, n by the least expected error.
_GROWTH: Final = 1.25
_LENGTHS: Final = 48
_SPEEDS_APART: Final = 0.2
_LEAST_SHARE_APART: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class _Transient:
    """Rows (n,) of transients, their age in rows since they began, and the speed that each tends to."""

    chosen: BoolArray
    age: FloatArray
    tends_to: FloatArray
    sense: FloatArray


def fit_slips(motion: RecordedMotion, balance: Balance, *, coasting: bool) -> tuple[LinearFit | None, LinearFit | None]:
    """Fit F - k x - F_0 -+ A = m^ a + F_v^ (v - b) to the transients, b the speed that they tend to.

    Returns the fit that begins with (m^, F_v^) and the one without a mass that begins with F_v^. With ``coasting``
    also what coasts after a reversal of the force is used, for valves without stiction.
    """
    samples = motion.samples
    transient = _transients(motion, balance, coasting)
    velocity, acceleration = backward_differences(samples)
    rows = np.flatnonzero(transient.chosen & np.isfinite(acceleration))
    if rows.size == 0:
        return None, None
    preload = 0.0 if balance.preload is None else balance.preload[0]
    sense, tends_to = transient.sense[rows], transient.tends_to[rows]
    explained = balance.spring[0] * samples.position_m[rows] + preload + sense * balance.friction[0]
    target = samples.force_n[rows] - explained
    columns = [acceleration[rows], velocity[rows] - tends_to]
    other_speed = tends_to - sense * balance.speed
    apart = np.abs(other_speed) > _SPEEDS_APART * balance.speed
    # few rows coast, and what they tend to is another speed for certain
    if bool((sense * tends_to < 0.0).any()) or np.count_nonzero(apart) > _LEAST_SHARE_APART * rows.size:
        columns.append(other_speed)  # F_v itself, without bias: ramps of other speeds, and coasting
    matrix = np.stack(columns, axis=1)
    noise = np.zeros((len(columns), len(columns)))
    noise[:2, :2] = noise_covariance(samples.position_noise_m, samples.period_s)[:2, :2]
    young = young_rows(motion)[rows]
    key = _LENGTHS - np.floor(np.log1p(transient.age[rows]) / np.log(_GROWTH))
    full = _best(matrix, target, key, noise, young)
    # without a mass only what comes after its part can be fitted
    free = ~inertial_rows(motion, balance)[rows]
    return full, _best(matrix[free, 1:], target[free], key[free], noise[1:, 1:], young[free])


def _best(
    columns: FloatArray, target: FloatArray, key: FloatArray, noise: FloatArray, young: BoolArray
) -> LinearFit | None:
    """Fit over the length of the transients that has the least expected relative error."""
    sweep = sweep_thresholds(columns, target, key, noise, steps=_LENGTHS - 1, parts=_LENGTHS)
    judged = slice(0, min(2, columns.shape[1]))
    relative = np.minimum(sweep.std_error[:, judged] / np.abs(sweep.coefficients[:, judged]), 1.0) ** 2
    cost = np.where(np.isfinite(sweep.std_error).all(axis=1), relative.sum(axis=1), np.inf)
    if not np.isfinite(cost).any():
        return None
    best = int(np.argmin(cost)) + 1
    return fit_trimmed(columns, target, key > best * sweep.step_m_per_s, young, noise)


def _transients(motion: RecordedMotion, balance: Balance, coasting: bool) -> _Transient:
    count = motion.samples.count
    chosen = np.zeros(count, dtype=np.bool_)
    age, sense = np.zeros(count), np.zeros(count)
    for stretch in motion.phases.stretches:
        if motion.action is Action.SPRING and not _is_used(stretch, coasting):
            continue
        first, last = motion.phases.first_differenced_row(stretch), stretch.last
        if motion.action is Action.SPRING and stretch.driven:
            last = min(last, first + (last - first) // 2)  # what is settled by then says nothing of the transient
        if last < first:
            continue
        rows = slice(first, last + 1)
        chosen[rows] = True
        sense[rows] = stretch.direction
        if motion.action is Action.SPRING:
            age[rows] = np.arange(last + 1 - first)
    if motion.action is Action.SPRING:
        tends_to = np.where(chosen, ramp_speeds(motion.samples, motion.phases, balance.spring[0]), 0.0)
    else:
        tends_to = sense * balance.speed
    return _Transient(chosen, age, tends_to, sense)


def _is_used(stretch: Stretch, coasting: bool) -> bool:
    if stretch.after is After.BREAKAWAY:
        return stretch.driven
    return coasting and stretch.after is After.CORNER
