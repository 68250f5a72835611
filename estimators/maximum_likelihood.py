"""Maximum likelihood, as the product has it: the engine, which knows that friction scatters."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import Estimate, Outcome, failed
from estimators.engine.engine import METHOD, RoughFrictionEstimator
from estimators.exact_motion import ExactMotionEstimator
from estimators.samples import Samples, prepare
from estimators.steps.inputs import find_steps
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

_FEWEST_STEPS: Final = 3


@dataclass(frozen=True, slots=True)
class MaximumLikelihoodEstimator:
    """Estimates m, k, F_v, F_c, F_s, DV and F_0, with their intervals, by the marginal likelihood of the recording.

    Friction is rough along the travel, wanders in time and scatters from breakaway to breakaway; how much is fitted.
    """

    @property
    def method(self) -> str:
        """Name in the analysis object."""
        return METHOD

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; its status and message say what is wrong with a recording."""
        if is_served(recording, nameplate):
            try:
                with np.errstate(all="ignore"), warnings.catch_warnings():
                    warnings.simplefilter("ignore", RuntimeWarning)  # numpy's, of means over no rows
                    return RoughFrictionEstimator().estimate(recording, nameplate)
            except (ArithmeticError, ValueError):  # also of singular matrices: numbers that no valve has
                return failed(METHOD, Outcome.NOT_COMPUTABLE)
        return replace(ExactMotionEstimator().estimate(recording, nameplate), method=METHOD)


def is_served(recording: Recording, nameplate: Nameplate) -> bool:
    """Whether the engine takes this kind of recording; the exact motion's fit takes the others until it does.

    To be deleted as the engine learns the last kind: a force in steps, which has no rate at a breakaway.
    """
    if nameplate.actuator.action is Action.DOUBLE and recording.force_n is not None:
        return True
    samples = prepare(recording, nameplate)
    if not isinstance(samples, Samples):
        return True  # both say alike what is wrong
    return len(find_steps(samples.time_s, samples.force_n, samples.run_first)) < _FEWEST_STEPS
