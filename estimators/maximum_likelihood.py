"""Maximum likelihood on the exact motion: the parameters whose simulated positions are nearest to the measured ones."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np

from estimators.base import Estimate, Outcome, failed
from estimators.likelihood.conclusion import conclude, searched_model
from estimators.likelihood.force_recording import estimate_force_recording
from estimators.likelihood.input_errors import refit, step_instants, with_input_errors
from estimators.likelihood.input_path import InputPath, input_path
from estimators.likelihood.model import StemModel
from estimators.likelihood.problem import pose
from estimators.likelihood.search import Found, search
from estimators.likelihood.staircase import read_staircase
from estimators.recorded_motion import RecordedMotion, read_motion
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

_MAY_BE_A_STAIRCASE: Final = (Outcome.NEVER_MOVED, Outcome.NO_UNIFORM_MOTION)
_WORTH_REFINING: Final = 100.0  # times the noise: a fit further off is at a wrong place, whatever the input's errors


@dataclass(frozen=True, slots=True)
class MaximumLikelihoodEstimator:
    """Output-error fit: white position noise, the exact motion, all parameters and nuisances at once.

    Unknown are m, k, F_v, F_c, F_s >= F_c, DV (weak prior), F_0, the position at the start, and travel stops where
    the stem touched them. A constant error of the position or of the pressure is the same as another F_0
    (S_a (P + p) - k (x + e) - F_0 has F_0 + k e - S_a p in its place), so neither is fitted beside it.
    A drive without a spring whose force was measured is fitted in its force: nothing holds a simulated position there.
    """

    method: str = "maximum_likelihood"

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; odd recordings give a named outcome."""
        if nameplate.actuator.action is Action.DOUBLE and recording.force_n is not None:
            return estimate_force_recording(recording, nameplate)
        motion = read_motion(recording, nameplate)
        if motion in _MAY_BE_A_STAIRCASE:
            motion = read_staircase(recording, nameplate) or motion
        if isinstance(motion, Outcome):
            return failed(self.method, motion)
        path = input_path(recording, nameplate)
        if isinstance(path, Outcome):
            return failed(self.method, path)
        with np.errstate(all="ignore"):
            return self._fitted(motion, path)

    def _fitted(self, motion: RecordedMotion, path: InputPath) -> Estimate:
        problem = pose(motion, path)
        if problem is None:
            return failed(self.method, motion.uniform_outcome or Outcome.UNPHYSICAL)
        model = searched_model(problem, motion.samples.period_s)

        def refined(found: Found) -> tuple[StemModel, Found] | None:
            # a command is known; its corners are as many as its lag asks for, so they have no fixed directions
            if found.certificate.ratio > _WORTH_REFINING or motion.command_only:
                return None
            values = model.coordinates.values(found.point)
            changed = path.variations(np.array([values[name] for name in model.input_names]))
            stepped = step_instants(model.corners(values), motion.samples.period_s)
            widened = with_input_errors(model, found.point, chain(changed, stepped))
            return (widened, refit(widened, found)) if widened.deviations else None

        def explains(found: Found) -> bool:
            better = refined(found)
            return better is not None and better[1].certificate.is_good

        found = search(model, problem.trials, problem.rests, explains)
        if found is None:
            return failed(self.method, Outcome.UNPHYSICAL)
        better = refined(found)
        if better is not None:
            model, found = better
        return conclude(self.method, motion, problem, model, found)
