"""Method 1, linear regression (Ravanbod-Shirazi & Besancon-Voda 2003; Romano & Garcia 2007, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np

from estimators.base import Estimate, Form, Outcome, absent, failed
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.conclusion import conclude
from estimators.classic.differences import without_bias
from estimators.classic.friction_parameters import friction_parameters
from estimators.classic.limit_velocity import limit_velocity
from estimators.classic.misfit import Fallback, misfit_m
from estimators.classic.regressors import Regressors, corrected_regressors, published_regressors
from estimators.classic.threshold_sweep import ThresholdSweep
from estimators.classic.transients import Setting, is_resolved, judge_transients
from estimators.linear_fit import LinearFit
from estimators.motion.balance import Balance, heaviest_mass_kg, viscous_bounds
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.settling import viscous_from_settling
from estimators.motion.static_friction import BreakawayForces, breakaway_forces, published_breakaway_forces
from estimators.motion.uniform_motion import UniformMotion
from valve.errors import ParameterError
from valve.messages import say
from valve.nameplate import Action

_TRIFLE: Final = 1.0e-3  # own choice, of the travel: F_s and DV stand in


@dataclass(frozen=True, slots=True, eq=False)
class _FirstStep:
    """Eq. (5): the sweep, the thresholds chosen for (m and F_v, the rest), and the fits there."""

    regressors: Regressors
    sweep: ThresholdSweep
    chosen: tuple[int, int] | None
    full: LinearFit | None
    massless: LinearFit | None
    rest: LinearFit | None
    rest_names: tuple[str, ...]
    clear: bool  # m and F_v show so well that nothing simpler is needed

    def coefficient(self, name: str) -> tuple[float, float] | None:
        """Coefficient of the fit for the rest, with its standard error, or None where it has none."""
        if self.rest is None or name not in self.rest_names:
            return None
        place = self.rest_names.index(name)
        return float(self.rest.coefficients[place]), float(self.rest.std_error[place])


@dataclass(frozen=True, slots=True)
class RegressionEstimator(ClassicEstimator):
    """Method 1 in its three steps: F = m a + F_v v + F_c sgn v + k x by least squares above a threshold of speed.

    ``thresholds`` is S and ``parts`` Z of Eq. (7). ``threshold`` fixes s; without it the threshold is the one with
    the least expected error (scatter and noise bias), for the corrected form one for m and F_v and one for the rest.
    That cannot fall into a plateau of wrong values, as looking for constancy does at s = 2 to 3.
    ``preload`` adds a constant to Eq. (4): by default in the corrected form only.
    """

    method: ClassVar[str] = "regression"
    solves_jointly: ClassVar[bool] = True

    thresholds: int = 1200
    parts: int = 1500
    threshold: int | None = None
    preload: bool | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.thresholds <= self.parts:
            raise ParameterError(
                say(
                    "thresholds_outside_parts",
                    "regression: thresholds is {thresholds}, it must lie between 1 and parts ({parts}): correct it",
                    thresholds=self.thresholds,
                    parts=self.parts,
                )
            )
        if self.threshold is not None and not 1 <= self.threshold <= self.thresholds:
            raise ParameterError(
                say(
                    "threshold_outside",
                    "regression: threshold is {threshold}, it must lie between 1 and {thresholds}: correct it",
                    threshold=self.threshold,
                    thresholds=self.thresholds,
                )
            )

    @property
    def _fits_preload(self) -> bool:
        return self.form is not Form.PUBLISHED if self.preload is None else self.preload

    @property
    def adapts(self) -> bool:
        """Whether the estimate suits itself to the recording: neither that as published nor that at a threshold."""
        return self.form is Form.ROBUST and self.threshold is None and self._fits_preload

    def _without_ramps(self, motion: RecordedMotion) -> Estimate | None:
        """The regression on a motion that is never uniform, where without noise it follows all of it."""
        if motion.uniform is not None or motion.samples.position_noise_m > 0.0 or motion.action is not Action.SPRING:
            return None
        found = self._exact(motion)
        missed_m = misfit_m(found, motion)
        trifle_m = _TRIFLE * float(np.ptp(motion.samples.position_m))
        return found if missed_m is not None and missed_m < trifle_m else None

    def _exact(self, motion: RecordedMotion) -> Estimate:
        if motion.has_preload and not self._fits_preload:
            return failed(self.method, Outcome.PRELOAD_IGNORED)
        first = self._first_step(motion)
        balance = self._balance(motion, first)
        if balance is None:
            swamped = Outcome.NOISE_TOO_HIGH if motion.samples.position_noise_m > 0.0 else Outcome.NO_UNIFORM_MOTION
            return failed(self.method, motion.uniform_outcome or swamped)
        raw = _raw_values(balance, first)
        if not balance.is_physical:
            return failed(self.method, Outcome.UNPHYSICAL, {"raw": raw})
        bounds = viscous_from_settling(motion.samples, motion.phases, balance) or viscous_bounds(balance)
        setting = Setting.of(motion, balance, bounds)
        settled = None if first.clear else self._settled_rows(motion)
        steady = first.coefficient("steady") if settled is None else settled.viscous_n_s_per_m
        transients = judge_transients(first.full, first.massless, steady, setting)
        forces = self._breakaways(motion, balance)
        if forces is not None:
            raw["F_s"] = forces.value
        parameters, outcomes = friction_parameters(
            balance, transients, forces, motion.one_way_outcome, max(motion.phases.directions)
        )
        second = limit_velocity(first.sweep, raw.get("F_c"), raw.get("F_v"), first.regressors.reference_speed)
        parameters |= {"m": transients.mass, "F_v": transients.viscous, "DV": absent(second.note)}
        fallback = Fallback.of(motion, transients, balance)
        diagnostics: dict[str, Any] = {
            "form": str(self.form),
            "raw": raw,
            "thresholds": first.chosen,
            "threshold_step_m_per_s": first.sweep.step_m_per_s,
            "eq8_limit_velocity_m_per_s": second.value_m_per_s,
            "eq8_threshold": second.threshold,
        }
        return conclude(
            self.method,
            motion,
            parameters=parameters,
            outcomes=outcomes,
            transients=transients,
            diagnostics=diagnostics,
            fallback=fallback,
        )

    def sweep(self, motion: RecordedMotion) -> tuple[ThresholdSweep, tuple[str, ...], float]:
        """Return Eq. (5) for every threshold, the coefficients' names and the speed that A is meant at (Figure 2)."""
        regressors = self._regressors(motion)
        return regressors.sweep(self.thresholds, self.parts), regressors.names, regressors.reference_speed

    def _regressors(self, motion: RecordedMotion) -> Regressors:
        if self.form is Form.PUBLISHED:
            return published_regressors(motion, preload=self._fits_preload)
        if motion.uniform is not None or motion.action is Action.DOUBLE:
            spring = None if motion.uniform is None else motion.uniform.spring_n_per_m
            return corrected_regressors(motion, spring, preload=self._fits_preload)
        # the speeds of the ramps need a spring rate: a first fit without them gives it
        rough = self._fitted(motion, corrected_regressors(motion, None, preload=self._fits_preload)).coefficient("k")
        return corrected_regressors(motion, None if rough is None else rough[0], preload=self._fits_preload)

    def _first_step(self, motion: RecordedMotion) -> _FirstStep:
        return self._fitted(motion, self._regressors(motion))

    def _fitted(self, motion: RecordedMotion, regressors: Regressors) -> _FirstStep:
        """Eq. (5) at the chosen thresholds: with the mass, and without it where that shows m or F_v badly."""
        sweep = regressors.sweep(self.thresholds, self.parts)
        chosen = self._chosen(sweep, regressors)
        full = rest = massless = None
        names, spring = regressors.names, 0.0
        if chosen is not None:
            full = regressors.fit(chosen[0] * sweep.step_m_per_s)
        if full is not None and "k" in names:
            spring = abs(float(full.coefficients[names.index("k")]))
        heaviest_kg = heaviest_mass_kg(motion.moving_mass_kg)
        clear = full is not None and _is_clear(full, heaviest_kg, spring, motion.samples.period_s)
        needs_rest = clear or self._settled_rows(motion) is None
        if chosen is not None and needs_rest:
            rest = full if chosen[0] == chosen[1] else regressors.fit(chosen[1] * sweep.step_m_per_s)
        if not clear:
            light = regressors.without_mass()
            light_sweep = light.sweep(self.thresholds, self.parts)
            light_chosen = self._chosen(light_sweep, light)
            if light_chosen is not None:
                massless = light.fit(light_chosen[0] * light_sweep.step_m_per_s)
                if rest is None and needs_rest:
                    names, rest = light.names, light.fit(light_chosen[1] * light_sweep.step_m_per_s)
        return _FirstStep(regressors, sweep, chosen, full, massless, rest, names, clear)

    def _settled_rows(self, motion: RecordedMotion) -> UniformMotion | None:
        """What gives k, A and F_0 where hidden transients would pull at them: uniform motion alone."""
        if self.form is Form.PUBLISHED or motion.uniform is None:
            return None
        return motion.uniform if motion.uniform.directions == motion.phases.directions else None

    def _chosen(self, sweep: ThresholdSweep, regressors: Regressors) -> tuple[int, int] | None:
        """Threshold numbers for (m and F_v, the rest) by the least expected error; None where none is determined."""
        determined = np.asarray(np.isfinite(sweep.std_error).all(axis=1))
        if self.threshold is not None:
            return (self.threshold, self.threshold) if determined[self.threshold - 1] else None
        determined &= sweep.thresholds_m_per_s >= regressors.least_threshold
        if not determined.any():
            return None
        relative = np.minimum(sweep.std_error / np.abs(sweep.coefficients), 1.0) ** 2
        relative[~determined] = np.inf
        moving = [place for place, name in enumerate(regressors.names) if name in ("m", "F_v")]
        resting = [place for place, name in enumerate(regressors.names) if name in ("A", "k")]
        if self.form is Form.PUBLISHED:
            moving = resting = moving + resting
        first = int(np.argmin(relative[:, moving].sum(axis=1))) + 1
        return first, int(np.argmin(relative[:, resting].sum(axis=1))) + 1

    def _balance(self, motion: RecordedMotion, first: _FirstStep) -> Balance | None:
        """k, A and F_0: from the regression, or from settled rows alone where hidden transients would pull at k."""
        settled = self._settled_rows(motion)
        if not first.clear and settled is not None:
            return Balance.of(settled, self.form, motion.action)
        friction = first.coefficient("A")
        if friction is None:
            return None
        return Balance(
            spring=first.coefficient("k") or (0.0, 0.0),
            friction=friction,
            preload=first.coefficient("F_0"),
            speed=first.regressors.reference_speed,
            # rows of one direction alone leave the preload in the friction, whatever else the stem did
            one_direction=motion.one_direction or (self._fits_preload and first.coefficient("F_0") is None),
            form=self.form,
            action=motion.action,
        )

    def _breakaways(self, motion: RecordedMotion, balance: Balance) -> BreakawayForces | None:
        if self.form is Form.PUBLISHED and not self._fits_preload:
            return published_breakaway_forces(motion.samples, motion.phases, balance.spring[0])
        preload = 0.0 if balance.preload is None else balance.preload[0]
        return breakaway_forces(motion.samples, motion.phases, balance.spring[0], preload)


def _raw_values(balance: Balance, first: _FirstStep) -> dict[str, float]:
    """Values before any judgement, by symbol; m and F_v as fitted to differences."""
    raw = {"k": balance.spring[0], "A": balance.friction[0]}
    if balance.preload is not None:
        raw["F_0"] = balance.preload[0]
    if first.full is not None:
        raw |= {"m": float(first.full.coefficients[0]), "F_v": float(first.full.coefficients[1])}
        raw["F_c"] = raw["A"] - balance.speed * raw["F_v"]
    return raw


def _is_clear(fit: LinearFit, heaviest_kg: float, spring_n_per_m: float, period_s: float) -> bool:
    """Whether m and F_v are known to 15 %, m is one that the valve can have, and their transients are resolved."""
    mass, viscous = (float(value) for value in fit.coefficients[:2])
    # F_v itself is about k T larger than F_v^
    known = fit.std_error[0] < 0.15 * mass and fit.std_error[1] < 0.15 * abs(viscous + spring_n_per_m * period_s)
    if not known or mass > heaviest_kg:
        return False
    dynamics = without_bias(mass, viscous, spring_n_per_m, period_s)
    return dynamics is not None and (spring_n_per_m == 0.0 or is_resolved(dynamics, period_s))
