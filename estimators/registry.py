"""The estimators that there are: add one by its file and a line in ESTIMATORS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from estimators.base import Estimate, Estimator, Outcome
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.motion.recorded_motion import MotionEstimator, RecordedMotion, read_motion
from valve.errors import NotFoundError
from valve.messages import say
from valve.nameplate import Nameplate
from valve.recording import Recording

# In the order of the analysis object.
ESTIMATORS: Final[dict[str, Callable[[], Estimator]]] = {
    "regression": RegressionEstimator,
    "garcia": GarciaEstimator,
    "maximum_likelihood": MaximumLikelihoodEstimator,
}


def estimator(name: str) -> Estimator:
    """Return the estimator of this name with its usual settings. Raises NotFoundError for another name."""
    if name not in ESTIMATORS:
        raise NotFoundError(
            say(
                "estimator_unknown",
                "estimator {name} is unknown: choose one of {all:, }",
                name=repr(name),
                all=tuple(ESTIMATORS),
            )
        )
    return ESTIMATORS[name]()


def estimate_all(
    recording: Recording, nameplate: Nameplate, motion: RecordedMotion | Outcome | None = None
) -> list[Estimate]:
    """Return every estimator's answer to this recording, in the order of ESTIMATORS; ``motion`` saves reading it."""
    motion = read_motion(recording, nameplate) if motion is None else motion
    estimates = []
    for make in ESTIMATORS.values():
        one = make()
        if isinstance(one, MotionEstimator):
            estimates.append(one.estimate_motion(motion))  # what these begin with is read once
        else:
            estimates.append(one.estimate(recording, nameplate))
    return estimates
