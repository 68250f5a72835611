"""The exact motion's fit of a valve that repeats itself: simulated positions nearest to the measured ones.

The search for causes in such valves begins at it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np

from estimators.base import Estimate, Outcome, failed, measured
from estimators.drive.recording import estimate_force_recording
from estimators.likelihood.conclusion import conclude
from estimators.likelihood.cycle_starts import with_jump_cycle
from estimators.likelihood.delay import searched_model
from estimators.likelihood.hopping import Hopping
from estimators.likelihood.input_errors import hopped_anew, refit, searched_anew, step_instants, with_input_errors
from estimators.likelihood.inputs.input_path import CommandedPath, InputPath, input_path
from estimators.likelihood.lag_exchange import with_other_lags
from estimators.likelihood.limit_exchange import with_other_limits
from estimators.likelihood.mass_scan import may_alias, with_scanned_mass
from estimators.likelihood.problem import Problem, pose
from estimators.likelihood.ramps import ramps_of
from estimators.likelihood.search import Found, search
from estimators.likelihood.staircase import read_staircase, with_stops
from estimators.likelihood.write_errors import reweighted
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

METHOD: Final = "exact_motion"
_MAY_BE_A_STAIRCASE: Final = (Outcome.NEVER_MOVED, Outcome.NO_UNIFORM_MOTION)
_WORTH_REFINING: Final = 100.0  # times the noise: a fit further off is at a wrong place, whatever the input's errors


@dataclass(frozen=True, slots=True)
class ExactMotionEstimator:
    """Output-error fit: white position noise, the exact motion, all parameters and nuisances at once.

    Unknown are m, k, F_v, F_c, F_s >= F_c, DV (weak prior), F_0, the position at the start, and travel stops where
    the stem touched them. A constant error of the position or of the pressure is the same as another F_0
    (S_a (P + p) - k (x + e) - F_0 has F_0 + k e - S_a p in its place), so neither is fitted beside it.
    A drive without a spring whose force was measured is fitted in its force: nothing holds a simulated position there.
    """

    method: str = METHOD

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; odd recordings give a named outcome."""
        if nameplate.actuator.action is Action.DOUBLE and recording.force_n is not None:
            return estimate_force_recording(recording, nameplate)
        with np.errstate(all="ignore"):
            motion = read_motion(recording, nameplate)
            if isinstance(motion, RecordedMotion) or motion in _MAY_BE_A_STAIRCASE:
                motion = read_staircase(recording, nameplate, motion) or motion
            if isinstance(motion, Outcome):
                return failed(self.method, motion)
            motion = with_stops(motion)
            path = input_path(recording, nameplate)
            if isinstance(path, Outcome):
                return failed(self.method, path)
            return self._fitted(motion, path)

    def _fitted(self, motion: RecordedMotion, path: InputPath) -> Estimate:
        problem = pose(motion, path)
        if problem is None:
            return failed(self.method, motion.uniform_outcome or Outcome.UNPHYSICAL)
        model = searched_model(problem, motion.samples.period_s)
        hopping = Hopping(
            motion.phases.moving_speed, problem.jumps, min(ramps_of(motion).rates_n_per_s, default=np.inf)
        )
        breakaways = len(motion.phases.breakaways)
        found = search(model, problem.trials, problem.rests, breakaways=breakaways, hopping=hopping)
        if found is None:
            return failed(self.method, Outcome.UNPHYSICAL)
        found = with_jump_cycle(found, motion, problem.rests)
        found = found if problem.is_noise_free else with_other_limits(found, hopping.slowest_n_per_s)
        aliased = may_alias(found.model.coordinates.values(found.point)["k"], motion.samples.period_s)
        if aliased and not (found.certificate.is_good or hopping.jumps or problem.is_noise_free):
            found = with_scanned_mass(found, hopping.speed_m_per_s)
        if isinstance(path, CommandedPath) and path.is_stepped:
            found = reweighted(found, path, motion, problem)
        found = self._with_input_errors(motion, path, found, hopping, problem)
        estimate = conclude(self.method, motion, problem, found)
        return _as_its_treads_tell(estimate, path) if isinstance(path, CommandedPath) and path.is_stepped else estimate

    @staticmethod
    def _with_input_errors(
        motion: RecordedMotion, path: InputPath, found: Found, hopping: Hopping, problem: Problem
    ) -> Found:
        """Search again and refit with the errors of the measured input as unknowns, where they matter."""
        # a command is known; its corners are as many as its lag asks for, so they have no fixed directions
        if motion.command_only:
            return with_other_lags(found)
        if found.certificate.ratio > _WORTH_REFINING:
            return found
        model = found.model
        values = model.coordinates.values(found.point)
        changed = path.variations(np.array([values[name] for name in model.input_names]))
        stepped = step_instants(model.corners(values), motion.samples.period_s)
        widened = with_input_errors(model, found.point, chain(changed, stepped))
        if not widened.deviations:
            return found
        point = searched_anew(model, widened, found, hopping, problem)
        found = refit(widened, found, point)
        # a valve of jumps that explains nothing yet is not found by some hops more
        return found if hopping.jumps and not found.certificate.is_near else hopped_anew(found, hopping)


def _as_its_treads_tell(estimate: Estimate, path: CommandedPath) -> Estimate:
    """Return the estimate with F_s no better known than to the tread that the stem broke away on (uniform)."""
    entry = estimate.parameters["F_s"]
    if entry.value is None or entry.std_error is None:
        return estimate
    tread_n = abs(float(path.fit.linear[1])) * float(np.median(np.abs(np.diff(path.level_n))))
    widened = measured(entry.value, float(np.hypot(entry.std_error, tread_n / np.sqrt(12.0))), note=entry.note)
    return replace(estimate, parameters={**estimate.parameters, "F_s": widened})
