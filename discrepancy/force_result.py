"""The diagnosis of a force recording as data: verdict, causes with sentence and action, gains and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from discrepancy.force_causes.fitted import Fitted
from discrepancy.force_gain import ForceGain
from discrepancy.rough.result import Verdict


@dataclass(frozen=True, slots=True)
class ForceFinding:
    """One cause that was named, with its parameters and what it explains."""

    cause: str
    sentence: str
    action: str
    parameters: Mapping[str, Fitted]
    share_of_misfit: float

    def to_json(self) -> dict[str, Any]:
        """Return the cause as in the analysis object; a force recording has no spring that makes a length of it."""
        return {
            "cause": self.cause,
            "sentence": self.sentence,
            "action": self.action,
            "parameters": {name: entry.to_json() for name, entry in self.parameters.items()},
            "share_of_misfit": self.share_of_misfit,
            "effect_percent_of_span": None,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ForceDiagnosis:
    """What a drive's balance of forces misses, and why; ``pictures`` are small arrays for drawing."""

    verdict: Verdict
    message: str = ""
    causes: tuple[ForceFinding, ...] = ()
    not_told_apart_from: tuple[str, ...] = ()
    gains: tuple[ForceGain, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    pictures: Mapping[str, Any] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as in the analysis object."""
        told = next((one for one in self.gains if one.is_worse), self.gains[0] if self.gains else None)
        return {
            "verdict": str(self.verdict),
            "message": self.message,
            "causes": [one.to_json() for one in self.causes],
            "not_told_apart_from": list(self.not_told_apart_from),
            "gain": None if told is None else told.to_json(),
            "gains": [one.to_json() for one in self.gains],
            "pictures": None if self.pictures is None else dict(self.pictures),
        }
