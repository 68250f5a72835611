"""What the two classic methods share: how a recording becomes an estimate."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from estimators.base import Estimate, Form, Outcome, failed
from estimators.classic.misfit import misfit_m
from estimators.classic.rough_estimate import FRICTION, rough_estimate
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

_LARGEST_RESIDUAL: Final = 1.3  # own choice: what uniform motion may leave beside the noise
_ROUNDING: Final = 1.0e-4  # of the friction


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
        """The corrected form where the recording repeats itself without noise, else what its windows of motion say."""
        if not self.adapts:
            return self._exact(motion)
        exact = self._exact(motion) if repeats_exactly(motion) else self._without_ramps(motion)
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

    def _without_ramps(self, motion: RecordedMotion) -> Estimate | None:  # noqa: ARG002
        """Return the estimate of a motion without noise that is never uniform; None where the method has none."""
        return None

    @abstractmethod
    def _exact(self, motion: RecordedMotion) -> Estimate:
        """Return the estimate by the published or the corrected form."""


def repeats_exactly(motion: RecordedMotion) -> bool:
    """Whether the friction of a recording without noise, or of a drive, is the same along the travel and in time."""
    uniform, samples = motion.uniform, motion.samples
    if uniform is None or (samples.position_noise_m > 0.0 and motion.action is Action.SPRING):
        return False
    noise_n = math.hypot(samples.force_noise_n, uniform.spring_n_per_m * samples.position_noise_m)
    rounding_n = _ROUNDING * abs(uniform.friction_n)
    return motion.action is Action.DOUBLE or uniform.residual_rms_n <= _LARGEST_RESIDUAL * noise_n + rounding_n


def _has(estimate: Estimate, symbols: Iterable[str]) -> bool:
    return all(estimate.value(symbol) is not None for symbol in symbols)


def _filled(exact: Estimate, rough: Estimate) -> Estimate:
    """What the corrected form gave of a valve that repeats itself, and what windows give of the rest."""
    given = {symbol: entry for symbol, entry in exact.parameters.items() if entry.value is not None}
    return replace(rough, parameters={**rough.parameters, **given})
