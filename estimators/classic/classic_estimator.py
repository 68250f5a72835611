"""What the two classic methods share: how a recording becomes an estimate that its whole motion has judged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from estimators.base import Estimate, Form, Outcome, failed
from estimators.classic.misfit import misfit_m
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.proof.proven import proven
from valve.nameplate import Nameplate
from valve.recording import Recording


@dataclass(frozen=True, slots=True)
class ClassicEstimator(ABC):
    """A method of the paper in one of its forms; a subclass says what it makes of a motion."""

    method: ClassVar[str]  # name in the analysis object

    form: Form = Form.ROBUST

    @property
    def is_judged(self) -> bool:
        """Whether the whole motion judges the estimate: not that of a form that is to stay as published."""
        return self.form is Form.ROBUST

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; odd recordings give a named outcome."""
        return self.estimate_motion(read_motion(recording, nameplate))

    def estimate_motion(self, motion: RecordedMotion | Outcome) -> Estimate:
        """Return the estimate from what ``read_motion`` returned."""
        if isinstance(motion, Outcome):
            return failed(self.method, motion)
        with np.errstate(all="ignore"):
            found = self._found(motion)
            estimate = proven(found, motion) if self.is_judged else found
            if estimate.residual_rms_m is None:  # the whole motion tells it by the way
                estimate = replace(estimate, residual_rms_m=misfit_m(found, motion))
            return estimate

    @abstractmethod
    def _found(self, motion: RecordedMotion) -> Estimate:
        """Return the estimate before the whole motion judges it."""
