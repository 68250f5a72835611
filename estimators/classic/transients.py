"""Mass and viscous friction from transients: bias undone, resolution and noise judged (either method's last step)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import Form, Outcome, ParameterEstimate, absent, measured
from estimators.classic.differences import Dynamics, without_bias, without_bias_massless
from estimators.linear_fit import LinearFit
from estimators.motion.balance import Balance, heaviest_mass_kg
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from valve.messages import say

# A transient is followed where its time constants last for 5 samples, its fast part where that lasts for half a one.
_FEWEST_SAMPLES_OF_TRANSIENT: Final = 5.0
_FEWEST_SAMPLES_OF_FAST_PART: Final = 0.5
_CAPTURE_PERIOD_S: Final = 2.0e-3  # sampling faster than that is no remedy any more
_LARGEST_INERTIA: Final = 0.1  # share of F_v that a mass left out may make
_MORE_THAN_NOISE: Final = 1.5
_ROUNDING: Final = 1.0e-5  # of the friction
_SEVERAL_SPEEDS: Final = say("from_several_speeds", "from ramps of several speeds")
_FROM_SETTLING: Final = say("from_settling", "from the settling of the slips")


@dataclass(frozen=True, slots=True)
class Transients:
    """m and F_v as parameters, the F_v that F_c is computed with (value, standard error), and what hides them."""

    mass: ParameterEstimate
    viscous: ParameterEstimate
    viscous_used: tuple[float, float]
    outcome: Outcome | None
    published_bias: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Setting:
    """What the transients are judged with: k in N/m, the sampling period in s, a bound of the mass in kg, the noises.

    ``viscous_bounds`` is what stands for F_v where the fits show nothing (middle, standard error), N s/m;
    ``bounds_are_measured`` says that it comes from the slips' settling and may be given as F_v.
    """

    spring_n_per_m: float
    period_s: float
    moving_mass_kg: float | None
    viscous_bounds: tuple[float, float]
    form: Form
    position_noise_m: float
    force_noise_n: float
    friction_n: float
    bounds_are_measured: bool = False

    @classmethod
    def of(
        cls,
        motion: RecordedMotion,
        balance: Balance,
        viscous_bounds: tuple[float, float],
        *,
        bounds_are_measured: bool = False,
    ) -> Setting:
        """The setting of this recording."""
        return cls(
            spring_n_per_m=balance.spring[0],
            period_s=motion.samples.period_s,
            moving_mass_kg=motion.moving_mass_kg,
            viscous_bounds=viscous_bounds,
            form=balance.form,
            position_noise_m=motion.samples.position_noise_m,
            force_noise_n=motion.samples.force_noise_n,
            friction_n=balance.friction[0],
            bounds_are_measured=bounds_are_measured,
        )

    def explains(self, massless: LinearFit) -> bool:
        """Whether what a fit without a mass leaves is no more than noise."""
        viscous = abs(float(massless.coefficients[0]))
        of_position = math.hypot(self.spring_n_per_m, math.sqrt(2.0) * viscous / self.period_s) * self.position_noise_m
        noise_n = math.hypot(self.force_noise_n, of_position)
        return massless.residual_rms <= _MORE_THAN_NOISE * noise_n + _ROUNDING * self.friction_n

    @property
    def heaviest_kg(self) -> float:
        """Mass that the moving parts surely do not exceed, kg."""
        return heaviest_mass_kg(self.moving_mass_kg)

    @property
    def unresolved(self) -> Outcome:
        """Outcome where noise or the rate hides a transient: the one whose remedy is left."""
        noisy = self.position_noise_m > 0.0 and self.period_s <= _CAPTURE_PERIOD_S
        return Outcome.NOISE_TOO_HIGH if noisy else Outcome.TRANSIENTS_NOT_RESOLVED


def is_resolved(dynamics: Dynamics, period_s: float) -> bool:
    """Whether a transient is followed: its time constants, F_v/k together, last for 5 samples."""
    return dynamics.slow_s >= _FEWEST_SAMPLES_OF_TRANSIENT * period_s


def judge_transients(
    full: LinearFit | None, massless: LinearFit | None, steady: tuple[float, float] | None, setting: Setting
) -> Transients:
    """Return m and F_v from a fit whose first coefficients are (m^, F_v^), or F_v from one without a mass.

    ``massless`` begins with F_v^; ``steady`` is F_v from ramps of several speeds with its standard error.
    """
    found = _from_full(full, setting)
    if found is None or found.viscous.value is None:
        alone = _from_massless(massless, setting)
        if alone is not None and alone.viscous.value is not None:
            mass = found.mass if found is not None and found.mass.value is not None else alone.mass
            found = Transients(mass, alone.viscous, alone.viscous_used, alone.outcome)
    if found is None:
        found = _hidden(setting)
    elif found.viscous_used[1] > setting.viscous_bounds[1] and found.viscous.value is None:
        hidden = _hidden(setting)
        found = replace(found, viscous=hidden.viscous, viscous_used=setting.viscous_bounds)
    if (
        steady is not None
        and steady[0] > 0.0
        and (found.viscous.std_error is None or steady[1] < found.viscous.std_error)
    ):
        viscous = measured(*steady, note=_SEVERAL_SPEEDS)
        if viscous.value is not None:
            outcome = None if found.mass.value is not None else found.outcome
            found = Transients(found.mass, viscous, steady, outcome, found.published_bias)
    return found


def _from_full(full: LinearFit | None, setting: Setting) -> Transients | None:
    """From (m^, F_v^); None where they are no valve's at all."""
    if full is None:
        return None
    pair = full.coefficients[:2]
    covariance = full.covariance[:2, :2] + np.outer(full.noise_bias[:2], full.noise_bias[:2])
    dynamics = _inverted(pair, setting)
    if dynamics is None:
        return None
    reason = setting.unresolved.message
    if setting.form is Form.PUBLISHED:
        value, error = pair, np.sqrt(np.diag(covariance))
    else:
        value = np.array([dynamics.mass_kg, dynamics.viscous_n_s_per_m])
        error = _propagated(lambda p: _inverted(p, setting), pair, covariance)
    if setting.form is not Form.PUBLISHED and dynamics.mass_kg > setting.heaviest_kg:
        return None
    if setting.spring_n_per_m > 0.0 and not is_resolved(dynamics, setting.period_s):
        return None
    bias = (float(pair[0] / dynamics.mass_kg - 1.0), float(pair[1] / dynamics.viscous_n_s_per_m - 1.0))
    notes: list[str] = ["", ""]
    if setting.form is Form.PUBLISHED:
        notes = [
            say(
                "differences_bias_it",
                "backward differences bias it by about {share:+.1f %}: the corrected form takes this out",
                share=share,
            )
            if abs(share) > 0.001
            else ""
            for share in bias
        ]
    mass = measured(float(value[0]), float(error[0]), note=notes[0], reason=reason)
    if dynamics.fast_s < _FEWEST_SAMPLES_OF_FAST_PART * setting.period_s:
        mass = absent(
            say(
                "faster_than_samples",
                "its time constant of {fast:.2g ms} is below half a sampling period: {why}",
                fast=dynamics.fast_s,
                why=Outcome.TRANSIENTS_NOT_RESOLVED.message,
            )
        )
    viscous = measured(float(value[1]), float(error[1]), note=notes[1], reason=reason)
    complete = mass.value is not None and viscous.value is not None
    return Transients(
        mass,
        viscous,
        (float(value[1]), float(error[1])),
        None if complete else setting.unresolved,
        bias if setting.form is Form.PUBLISHED else None,
    )


def _inverted(pair: FloatArray, setting: Setting) -> Dynamics | None:
    return without_bias(float(pair[0]), float(pair[1]), setting.spring_n_per_m, setting.period_s)


def _propagated(
    function: Callable[[FloatArray], Dynamics | None], at: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Standard errors of (m, F_v) by differences of the inversion; infinite where a step leaves its domain."""
    jacobian = np.zeros((2, 2))
    for column in range(2):
        step = 1.0e-4 * abs(at[column])
        moved = [function(at + sign * step * np.eye(2)[column]) for sign in (1.0, -1.0)]
        if moved[0] is None or moved[1] is None:
            return np.array([math.inf, math.inf])
        jacobian[0, column] = (moved[0].mass_kg - moved[1].mass_kg) / (2.0 * step)
        jacobian[1, column] = (moved[0].viscous_n_s_per_m - moved[1].viscous_n_s_per_m) / (2.0 * step)
    return np.asarray(np.sqrt(np.clip(np.diag(jacobian @ covariance @ jacobian.T), 0.0, None)))


def _from_massless(massless: LinearFit | None, setting: Setting) -> Transients | None:
    """F_v where the inertia is too fast to be seen; a mass within bounds would add m |l| to it."""
    if massless is None or not setting.explains(massless):
        return None
    fitted = float(massless.coefficients[0])
    value = without_bias_massless(fitted, setting.spring_n_per_m, setting.period_s)
    if value is None or not value > 0.0:
        return None
    rate = setting.spring_n_per_m / value
    if rate * setting.period_s > 1.0 / _FEWEST_SAMPLES_OF_TRANSIENT:
        return None
    most = setting.heaviest_kg * rate
    if most > _LARGEST_INERTIA * value:
        return None
    error = math.hypot(float(massless.std_error[0]) * value / fitted, most / math.sqrt(12.0))
    value += 0.5 * most
    if setting.form is Form.PUBLISHED:
        value = fitted
    viscous = measured(value, error, reason=setting.unresolved.message)
    fast_s = setting.heaviest_kg / value
    if fast_s >= setting.period_s:
        return Transients(absent(setting.unresolved.message), viscous, (value, error), setting.unresolved)
    note = say(
        "mass_acts_briefly",
        "even {mass:.3g kg} would act for {fast:.2g ms} only: {why}",
        mass=setting.heaviest_kg,
        fast=fast_s,
        why=Outcome.MASS_HIDDEN.message,
    )
    outcome = Outcome.MASS_HIDDEN if viscous.value is not None else setting.unresolved
    return Transients(absent(note), viscous, (value, error), outcome)


def _hidden(setting: Setting) -> Transients:
    """Neither m nor F_v is seen in differences; the settling of the slips may still tell F_v."""
    outcome = setting.unresolved
    viscous = absent(outcome.message)
    if setting.bounds_are_measured:
        viscous = measured(*setting.viscous_bounds, note=_FROM_SETTLING, reason=outcome.message)
    return Transients(absent(outcome.message), viscous, setting.viscous_bounds, outcome)
