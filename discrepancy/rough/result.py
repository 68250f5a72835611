"""The diagnosis as data: verdict, causes with sentence and action, remarks, gain and latent friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.latent import LatentCurve
from discrepancy.rough.misfit import RoughMisfit
from discrepancy.rough.prediction import Gain
from discrepancy.rough.saved_model import SavedModel
from discrepancy.rough.separating import Undecided


class Verdict(StrEnum):
    """What is said of a misfit."""

    NONE = "none"
    NAMED = "named"
    LIKELY = "likely"
    AMBIGUOUS = "ambiguous"
    UNEXPLAINED = "unexplained"
    NOT_ASSESSED = "not_assessed"


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause, or a remark: its sentence and action, parameters, and what it does.

    ``evidence`` is in nats beyond the model without it, None where it was seen directly.
    """

    cause: str
    sentence: str
    action: str
    parameters: Mapping[str, Fitted]
    share_of_misfit: float | None = None
    effect_percent_of_span: float | None = None
    evidence: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the finding as in the analysis object."""
        return {
            "cause": self.cause,
            "sentence": self.sentence,
            "action": self.action,
            "parameters": {name: entry.to_json() for name, entry in self.parameters.items()},
            "share_of_misfit": self.share_of_misfit,
            "effect_percent_of_span": self.effect_percent_of_span,
            "evidence_nats": self.evidence,
        }


@dataclass(frozen=True, slots=True, eq=False)
class RoughDiagnosis:
    """What is wrong with a valve whose friction scatters.

    ``latent`` is friction beyond the mean law before any cause, ``latent_after`` with the causes in the model.
    ``extended`` is the valve with its causes, the accepted ones too, as it may be accepted for later tests.
    ``not_looked_for`` says why causes that the stem would show were not looked for, "" where they were.
    ``undecided`` is what an ambiguous verdict leaves to be told apart; ``separating_test`` says how a hand does it.
    """

    verdict: Verdict
    message: str
    causes: tuple[Finding, ...] = ()
    not_told_apart_from: tuple[str, ...] = ()
    remarks: tuple[Finding, ...] = ()
    gain: Gain | None = None
    gains: tuple[Gain, ...] = ()
    latent: tuple[LatentCurve, ...] = ()
    latent_after: tuple[LatentCurve, ...] = ()
    misfit: RoughMisfit | None = None
    extended: SavedModel | None = None
    pictures: Mapping[str, Any] | None = None
    undecided: Undecided | None = None
    separating_test: str | None = None
    not_looked_for: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as the analysis object's ``discrepancy``."""
        return {
            "verdict": str(self.verdict),
            "message": self.message,
            "causes": [one.to_json() for one in self.causes],
            "not_told_apart_from": list(self.not_told_apart_from),
            "separating_test": self.separating_test,
            "misfit": None if self.misfit is None else self.misfit.to_json(),
            "remarks": [one.to_json() for one in self.remarks],
            "gain": None if self.gain is None else self.gain.to_json(),
            "gains": [one.to_json() for one in self.gains],
            "extended_model": None if self.extended is None else self.extended.to_json(),
            "pictures": None if self.pictures is None else dict(self.pictures),
            "latent_friction": [one.to_json() for one in self.latent],
            "details": {**self.details, "latent_friction_after": [one.to_json() for one in self.latent_after]},
        }
