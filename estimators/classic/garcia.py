"""Method 2, Garcia's force balances (Garcia 2007; Romano & Garcia 2007, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from estimators.base import Estimate, Form, Outcome, absent, failed
from estimators.classic.classic_estimator import ClassicEstimator
from estimators.classic.conclusion import conclude
from estimators.classic.friction_parameters import friction_parameters, has_stiction
from estimators.classic.garcia_points import published_points
from estimators.classic.misfit import Fallback
from estimators.classic.slip_fit import fit_slips
from estimators.classic.transients import Setting, judge_transients
from estimators.linear_fit import LinearFit
from estimators.motion.balance import Balance, viscous_bounds
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.settling import viscous_from_settling
from estimators.motion.static_friction import BreakawayForces, breakaway_forces
from estimators.motion.uniform_motion import UniformMotion
from valve.messages import say

_NO_LIMIT_VELOCITY = say(
    "no_limit_velocity", "the method does not give it; on ramps of one speed it cannot be told from F_s"
)


@dataclass(frozen=True, slots=True)
class GarciaEstimator(ClassicEstimator):
    """Method 2: k and F_c from uniform motion, F_s from breakaways, m and F_v from slips, by balances of forces.

    As published each comes from the two or three points of its equations and there is no preload. The corrected
    form uses all points of their kind, fits the preload and takes out the bias of backward differences. For a
    valve without stiction (no slip jump) m and F_v come from the ends of the ramps, as far as these show them.
    """

    method: ClassVar[str] = "garcia"
    solves_jointly: ClassVar[bool] = False

    def _exact(self, motion: RecordedMotion) -> Estimate:
        if motion.uniform is None:
            return failed(self.method, motion.uniform_outcome or Outcome.NO_UNIFORM_MOTION)
        if self.form is not Form.PUBLISHED:
            return self._corrected(motion, motion.uniform)
        if motion.has_preload:
            return failed(self.method, Outcome.PRELOAD_IGNORED)
        return self._published(motion, motion.uniform)

    def _corrected(self, motion: RecordedMotion, uniform: UniformMotion) -> Estimate:
        balance = Balance.of(uniform, self.form, motion.action)
        preload = 0.0 if balance.preload is None else balance.preload[0]
        forces = breakaway_forces(motion.samples, motion.phases, balance.spring[0], preload)
        slip_free = forces is None or not has_stiction(balance, forces)
        full, massless = fit_slips(motion, balance, coasting=slip_free)
        return self._concluded(
            motion,
            balance,
            full=full,
            massless=massless,
            forces=forces,
            steady=uniform.viscous_n_s_per_m,
        )

    def _published(self, motion: RecordedMotion, uniform: UniformMotion) -> Estimate:
        points = published_points(motion, uniform)
        if points is None:
            return failed(self.method, Outcome.NO_UNIFORM_MOTION)
        return self._concluded(
            motion, points.balance, full=points.slip, massless=None, forces=points.breakaway, steady=None
        )

    def _concluded(
        self,
        motion: RecordedMotion,
        balance: Balance,
        *,
        full: LinearFit | None,
        massless: LinearFit | None,
        forces: BreakawayForces | None,
        steady: tuple[float, float] | None,
    ) -> Estimate:
        raw: dict[str, float] = {"k": balance.spring[0], "A": balance.friction[0]}
        if balance.preload is not None:
            raw["F_0"] = balance.preload[0]
        if full is not None:
            raw |= {"m": float(full.coefficients[0]), "F_v": float(full.coefficients[1])}
            raw["F_c"] = raw["A"] - balance.speed * raw["F_v"]
        if forces is not None:
            raw["F_s"] = forces.value
        diagnostics: dict[str, Any] = {"form": str(self.form), "raw": raw}
        if not balance.is_physical:
            return failed(self.method, Outcome.UNPHYSICAL, diagnostics)
        settling = viscous_from_settling(motion.samples, motion.phases, balance)
        measured_bounds = settling is not None and self.form is not Form.PUBLISHED
        bounds = settling or viscous_bounds(balance)
        setting = Setting.of(motion, balance, bounds, bounds_are_measured=measured_bounds)
        transients = judge_transients(full, massless, steady, setting)
        parameters, outcomes = friction_parameters(
            balance, transients, forces, motion.one_way_outcome, max(motion.phases.directions)
        )
        parameters |= {"m": transients.mass, "F_v": transients.viscous, "DV": absent(_NO_LIMIT_VELOCITY)}
        fallback = Fallback.of(motion, transients, balance)
        return conclude(
            self.method,
            motion,
            parameters=parameters,
            outcomes=outcomes,
            transients=transients,
            diagnostics=diagnostics,
            fallback=fallback,
        )
