"""Who is asked: the product, and answers made up for the grader's own tests."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from service.analysis.analysis import joined
from service.analysis.diagnosis import assess
from tests.bench.blind.cases import HELD_OUT, BlindCase
from tests.bench.blind.strengths import Expected
from tests.support.published_recordings import recorded
from valve.effects import EFFECTS


@dataclass(frozen=True, slots=True)
class Asked:
    """The ``discrepancy`` object, and how long the methods and the diagnosis took, s."""

    discrepancy: dict[str, Any]
    estimates_s: float = 0.0
    diagnosis_s: float = 0.0


Diagnoser = Callable[[BlindCase], Asked]


def product(case: BlindCase) -> Asked:
    """What the product says: maximum likelihood of the recordings as one, and the diagnosis."""
    _warm()
    begun_s = time.process_time()
    whole = joined(case.recordings)
    likelihood = MaximumLikelihoodEstimator().estimate(whole, case.nameplate)
    estimated_s = time.process_time()
    held_out = ((HELD_OUT, case.held_out),)
    found = assess(case.recordings, case.nameplate, [likelihood], held_out=held_out, estimated=whole)
    return Asked(found, estimated_s - begun_s, time.process_time() - estimated_s)


@cache
def _warm() -> None:
    """Load what is compiled, once a process, so that no case's time holds it."""
    made = recorded("nominal", period_s=20.0e-3, noise_m=20.0e-6)
    likelihood = MaximumLikelihoodEstimator().estimate(made.recording, made.nameplate)
    assess([made.recording], made.nameplate, [likelihood])


def oracle(case: BlindCase) -> Asked:
    """One that knows what is hidden, and which of it can be known."""
    if case.expected is Expected.UNEXPLAINED:
        return Asked(discrepancy_object("unexplained"))
    names = [one.cause for one in case.hidden]
    if not names or case.expected is Expected.HIDDEN:
        return Asked(discrepancy_object("none"))
    gain = {
        "held_out": HELD_OUT,
        "rmse_before_m": 10.0 * case.oracle_rmse_m,
        "rmse_after_m": case.oracle_rmse_m,
        "noise_floor_m": case.noise_m,
    }
    if case.expected is Expected.SET:
        rivals = [other for other in EFFECTS if other not in names][:1]
        return Asked(discrepancy_object("ambiguous", names, rivals, gain))
    return Asked(discrepancy_object("named", names, gain=gain))


def always_none(_case: BlindCase) -> Asked:
    """One that never sees anything."""
    return Asked(discrepancy_object("none"))


def always_wrong(case: BlindCase) -> Asked:
    """One that always names what is not there."""
    hidden = {one.cause for one in case.hidden}
    return Asked(discrepancy_object("named", [next(cause for cause in EFFECTS if cause not in hidden)]))


def always_all(_case: BlindCase) -> Asked:
    """One that cannot tell anything from anything: no use, and no lie."""
    first, *others = EFFECTS
    return Asked(discrepancy_object("ambiguous", [first], others))


def raising(_case: BlindCase) -> Asked:
    """One that fails."""
    raise ValueError("no answer")


def discrepancy_object(
    verdict: str, causes: list[str] | None = None, rivals: list[str] | None = None, gain: dict[str, Any] | None = None
) -> dict[str, Any]:
    """A ``discrepancy`` object as the contract has it."""
    found = [
        {"cause": cause, "sentence": "", "action": "", "parameters": {}, "share_of_misfit": 1.0}
        for cause in causes or []
    ]
    return {
        "verdict": verdict,
        "causes": found,
        "not_told_apart_from": rivals or [],
        "separating_test": None,
        "gain": gain,
    }


DIAGNOSERS: Final[dict[str, Diagnoser]] = {
    "product": product,
    "oracle": oracle,
    "always_none": always_none,
    "always_wrong": always_wrong,
    "always_all": always_all,
    "raising": raising,
}
