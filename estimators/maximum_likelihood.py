"""Maximum likelihood, as the product has it: the engine, which knows that friction scatters."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from estimators.base import Estimate, Outcome, failed
from estimators.engine.engine import METHOD, RoughFrictionEstimator
from valve.nameplate import Nameplate
from valve.recording import Recording


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
        try:
            with np.errstate(all="ignore"), warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # numpy's, of means over no rows
                return RoughFrictionEstimator().estimate(recording, nameplate)
        except (ArithmeticError, ValueError):  # also of singular matrices: numbers that no valve has
            return failed(METHOD, Outcome.NOT_COMPUTABLE)
