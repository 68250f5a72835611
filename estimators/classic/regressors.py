"""Method 1's regression vector (Romano & Garcia 2007, Eq. 6) for every row, as published and corrected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import Form
from estimators.classic.differences import backward_differences, noise_covariance
from estimators.classic.threshold_sweep import ThresholdSweep, sweep_thresholds
from estimators.linear_fit import LinearFit, fit_trimmed
from estimators.motion.balance import Balance
from estimators.motion.ramp_speeds import ramp_speeds
from estimators.motion.recorded_motion import RecordedMotion, young_rows
from estimators.motion.settling import inertial_rows
from estimators.motion.stops import rows_off_stops
from estimators.samples import BoolArray, FloatArray
from valve.nameplate import Action

_NOISE_SIGMAS: Final = 4.5  # a stem at rest seems to move by less than that
_LEAST_SHARE_APART: Final = 0.05  # of the rows
_SPEEDS_APART: Final = 0.2  # ramp speeds that differ by less than this share of their median count as one


@dataclass(frozen=True, slots=True, eq=False)
class Regressors:
    """Columns (n, p) with their names, the force, and the speed that thresholds are compared with, 0 where unusable.

    ``m``: acceleration. ``F_v``: velocity beyond the ramp's speed b. ``A``: direction. ``k``: position. ``F_0``: 1.
    ``steady``: b beyond its usual value, where the ramps had several speeds; its coefficient is F_v without bias.
    A is F_c + F_v times ``reference_speed``.
    """

    columns: FloatArray
    names: tuple[str, ...]
    force_n: FloatArray
    speed: FloatArray
    noise: FloatArray
    young: BoolArray
    inertial: BoolArray
    reference_speed: float
    least_threshold: float  # m/s: below it noise alone makes a stem at rest look moving

    def without_mass(self) -> Regressors:
        """Return the regressors without the acceleration, for the rows in which it is felt no more."""
        speed = np.where(self.inertial, 0.0, self.speed)
        return replace(self, columns=self.columns[:, 1:], names=self.names[1:], noise=self.noise[1:, 1:], speed=speed)

    def sweep(self, steps: int, parts: int) -> ThresholdSweep:
        """Return Eq. (5) for every threshold of Eq. (7)."""
        return sweep_thresholds(self.columns, self.force_n, self.speed, self.noise, steps=steps, parts=parts)

    def fit(self, threshold_m_per_s: float) -> LinearFit | None:
        """Return Eq. (5) for the rows that are faster than the threshold."""
        return fit_trimmed(self.columns, self.force_n, self.speed > threshold_m_per_s, self.young, self.noise)


def published_regressors(motion: RecordedMotion, *, preload: bool) -> Regressors:
    """Every row off the stops; the speed is that of its backward difference."""
    samples = motion.samples
    velocity, acceleration = backward_differences(samples)
    usable = np.isfinite(acceleration) & rows_off_stops(samples, motion.stops)
    velocity, acceleration = np.where(usable, velocity, 0.0), np.where(usable, acceleration, 0.0)
    sense = np.sign(velocity)
    reference = motion.phases.moving_speed
    columns = {"m": acceleration, "F_v": velocity - reference * sense, "A": sense}
    made = _made(motion, columns, np.abs(velocity), sense, preload=preload)
    noise_m_per_s = float(np.sqrt(noise_covariance(samples.position_noise_m, samples.period_s)[1, 1]))
    return replace(made, reference_speed=reference, least_threshold=_NOISE_SIGMAS * noise_m_per_s)


def corrected_regressors(motion: RecordedMotion, spring_n_per_m: float | None, *, preload: bool) -> Regressors:
    """Rows whose differences reach over driven motion alone; the speed is windowed against noise.

    ``spring_n_per_m`` gives the speed b of each ramp; without it b is the usual speed of the motion.
    """
    samples, phases = motion.samples, motion.phases
    velocity, acceleration = backward_differences(samples)
    usable = np.isfinite(acceleration) & rows_off_stops(samples, motion.stops)
    usable &= phases.differenced_rows(samples.count, coasting=motion.action is Action.DOUBLE)
    sense = np.where(usable, np.sign(phases.velocity), 0.0)
    velocity, acceleration = np.where(usable, velocity, 0.0), np.where(usable, acceleration, 0.0)
    if motion.action is Action.SPRING and spring_n_per_m is not None and spring_n_per_m > 0.0:
        tends_to = np.where(usable, ramp_speeds(samples, phases, spring_n_per_m), 0.0)
        reference = float(np.median(np.abs(tends_to[usable]))) if usable.any() else 0.0
    else:
        reference = phases.moving_speed
        tends_to = reference * sense
    columns = {"m": acceleration, "F_v": np.where(usable, velocity - tends_to, 0.0), "A": sense}
    other = tends_to - reference * sense
    apart = np.abs(other) > _SPEEDS_APART * reference
    if np.count_nonzero(apart) > _LEAST_SHARE_APART * np.count_nonzero(usable):
        columns["steady"] = other
    speed = np.where(usable, np.abs(phases.velocity), 0.0)
    made = _made(motion, columns, speed, sense, preload=preload)
    inertial = made.inertial
    if motion.uniform is not None:
        inertial = inertial_rows(motion, Balance.of(motion.uniform, Form.CORRECTED, motion.action))
    return replace(made, reference_speed=reference, young=young_rows(motion), inertial=inertial)


def _made(
    motion: RecordedMotion, columns: dict[str, FloatArray], speed: FloatArray, sense: FloatArray, *, preload: bool
) -> Regressors:
    samples = motion.samples
    if motion.action is Action.SPRING:
        columns["k"] = samples.position_m
    moving = speed > 0.0
    both_ways = bool((sense[moving] > 0.0).any() and (sense[moving] < 0.0).any())
    if preload and both_ways and not motion.one_direction:
        columns["F_0"] = np.ones(samples.count)
    names = tuple(columns)
    noise = np.zeros((len(names), len(names)))
    known = noise_covariance(samples.position_noise_m, samples.period_s)
    places = [names.index(name) for name in ("m", "F_v", "k") if name in names]
    noise[np.ix_(places, places)] = known[: len(places), : len(places)]
    return Regressors(
        columns=np.stack(list(columns.values()), axis=1),
        names=names,
        force_n=samples.force_n,
        speed=speed,
        noise=noise,
        young=np.zeros(samples.count, dtype=np.bool_),
        inertial=np.zeros(samples.count, dtype=np.bool_),
        reference_speed=0.0,
        least_threshold=0.0,
    )
