"""What a diagnosis says: a verdict, causes with their sentences, what each gains, and what else it could be."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from discrepancy.causes.base import Fitted
from discrepancy.gain import Gain, decisive
from discrepancy.least_squares import Fit
from discrepancy.residuals import Misfit


class Verdict(StrEnum):
    """What can be said of a misfit."""

    NONE = "none"
    NAMED = "named"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"
    NOT_ASSESSED = "not_assessed"


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause that was named, with its parameters and what it explains."""

    cause: str
    sentence: str
    action: str
    parameters: dict[str, Fitted]
    share_of_misfit: float

    def to_json(self) -> dict[str, Any]:
        """Return the cause as in the analysis object."""
        return {
            "cause": self.cause,
            "sentence": self.sentence,
            "action": self.action,
            "parameters": {
                name: {"value": entry.value, "ci95": [entry.low, entry.high], "unit": entry.unit}
                for name, entry in self.parameters.items()
            },
            "share_of_misfit": self.share_of_misfit,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """The answer; ``gains`` are all that were measured, ``before`` and ``after`` the data of the pictures.

    ``rival_fits`` are those of the causes that are not told apart, in their order, as far as they were fitted.
    """

    verdict: Verdict
    message: str = ""
    causes: tuple[Finding, ...] = ()
    not_told_apart_from: tuple[str, ...] = ()
    gains: tuple[Gain, ...] = ()
    before: Misfit | None = None
    after: Misfit | None = None
    baseline: Fit | None = None
    extended: Fit | None = None
    details: dict[str, Any] = field(default_factory=dict)
    rival_fits: tuple[Fit, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as the analysis object's ``discrepancy``."""
        told = decisive(self.gains)
        return {
            "verdict": str(self.verdict),
            "message": self.message,
            "causes": [finding.to_json() for finding in self.causes],
            "not_told_apart_from": list(self.not_told_apart_from),
            "separating_test": None,
            "gain": None if told is None else told.to_json(),
        }
