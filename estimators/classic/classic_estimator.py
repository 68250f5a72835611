"""What the two classic methods share: how a recording becomes an estimate."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from estimators.base import Estimate, Form, Outcome, failed
from estimators.classic.misfit import misfit_m
from estimators.classic.rough_estimate import FRICTION, rough_estimate
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from valve.nameplate import Nameplate
from valve.recording import Recording


@dataclass(frozen=True, slots=True)
class ClassicEstimator(ABC):
    """A method of the paper in one of its forms; a subclass says what it makes of a motion."""

    method: ClassVar[str]  # name in the analysis object
    solves_jointly: ClassVar[bool]  # all unknowns at once, or step by step

    form: Form = Form.ROBUST

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; odd recordings give a named outcome."""
        return self.estimate_motion(read_motion(recording, nameplate))

    def estimate_motion(self, motion: RecordedMotion | Outcome) -> Estimate:
        """Return the estimate from what ``read_motion`` returned."""
        if isinstance(motion, Outcome):
            return failed(self.method, motion)
        with np.errstate(all="ignore"):
            estimate = self._estimate(motion)
            return replace(estimate, residual_rms_m=misfit_m(estimate, motion))

    def _estimate(self, motion: RecordedMotion) -> Estimate:
        """The slips' fit where the recording repeats itself to its noise, else what its windows of motion say."""
        if not self.adapts:
            return self._exact(motion)
        exact = self._repeating(motion)
        if exact is not None and _has(exact, FRICTION):
            return exact
        rough = rough_estimate(self.method, motion, jointly=self.solves_jointly)
        if rough is None:
            return self._exact(motion) if exact is None else exact
        if exact is None:
            return rough
        given = [symbol for symbol in FRICTION if rough.value(symbol) is not None]
        return exact if _has(exact, given) else _filled(exact, rough)

    @property
    def adapts(self) -> bool:
        """Whether the estimate suits itself to what the recording is: not in a form that is to stay as it is."""
        return self.form is Form.ROBUST

    @abstractmethod
    def _repeating(self, motion: RecordedMotion) -> Estimate | None:
        """Return the estimate of a valve that repeats itself to the noise; None where the recording is of no such."""

    @abstractmethod
    def _exact(self, motion: RecordedMotion) -> Estimate:
        """Return the estimate by the published or the corrected form."""


def _has(estimate: Estimate, symbols: Iterable[str]) -> bool:
    return all(estimate.value(symbol) is not None for symbol in symbols)


def _filled(exact: Estimate, rough: Estimate) -> Estimate:
    """What the slips gave of a valve that repeats itself, and what windows give of the rest."""
    given = {symbol: entry for symbol, entry in exact.parameters.items() if entry.value is not None}
    return replace(rough, parameters={**rough.parameters, **given})
