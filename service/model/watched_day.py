"""What a day in service said of a valve: the figures of ``breakaway watch``, or why there are none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, Final

from service.model.health_figures import Figure, Figures

#: Figures of a trend, and which figure in service stands beside each of them.
BESIDE: Final = {
    "friction_mean_n": "friction",
    "spring_rate_n_per_m": "spring_rate",
    "dead_band_percent": "dead_band_percent",
}


_SAME: Final = 1.0e-6  # relative: one number in other units


@dataclass(frozen=True, slots=True)
class JudgedBy:
    """The nameplate's travel, m, and effective area, m2, by which a day was judged; None where that is not known."""

    travel_m: float | None = None
    area_m2: float | None = None

    def is_like(self, other: JudgedBy) -> bool:
        """Whether figures by the one can be held against figures by the other."""
        pairs = ((self.travel_m, other.travel_m), (self.area_m2, other.area_m2))
        return all(
            one == two or (one is not None and two is not None and math.isclose(one, two, rel_tol=_SAME))
            for one, two in pairs
        )


@dataclass(frozen=True, slots=True)
class WatchedDay:
    """One valve and day, which is that on which its watching begins, by the plant's zone.

    ``rows`` were kept of it, between ``began_at`` and ``ended_at``. ``document`` is ``breakaway/watch/1``; None where
    nothing could be said, for the ``reason``.
    """

    valve: str
    day: date
    began_at: datetime
    ended_at: datetime
    rows: int
    judged_at: datetime
    software: str
    document: Mapping[str, Any] | None = None
    reason: str = ""
    judged_by: JudgedBy = JudgedBy()

    def figure(self, name: str) -> Figure | None:
        """Return a figure of the document, SI, by its name there; None where it is not known."""
        found = (self.document or {}).get("figures", {}).get(name)
        if found is None or found["value"] is None:
            return None
        return Figure(found["value"], None if found["ci95"] is None else (found["ci95"][0], found["ci95"][1]))

    @property
    def driven_by(self) -> str:
        """The signal that gave the forces: pressure or command; "" where nothing could be said."""
        return str((self.document or {}).get("recording", {}).get("driven_by", ""))

    @property
    def figures(self) -> Figures:
        """The figures that stand beside those of tests, by the names that trends have."""
        known = {name: self.figure(own) for name, own in BESIDE.items()}
        return {name: figure for name, figure in known.items() if figure is not None}


@dataclass(frozen=True, slots=True)
class FrictionInService:
    """The friction of one day in service, N, known since ``judged_at``; ``driven_by`` is the signal that gave it."""

    day: date
    friction: Figure
    judged_at: datetime
    driven_by: str = ""
    judged_by: JudgedBy = JudgedBy()


@dataclass(frozen=True, slots=True)
class ChangedInService:
    """What days in service say against a valve, in a sentence, and since when they do."""

    sentence: str
    since: datetime


@dataclass(frozen=True, slots=True)
class DayJudged:
    """What the file of a day says: its rows, when they begin and end, ``document`` and ``reason`` as in WatchedDay."""

    rows: int
    began_at: datetime
    ended_at: datetime
    document: dict[str, Any] | None = None
    reason: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return it as a worker answers it."""
        instants = {"began_at": self.began_at.isoformat(), "ended_at": self.ended_at.isoformat()}
        return {"rows": self.rows, **instants, "document": self.document, "reason": self.reason}

    @classmethod
    def from_json(cls, said: dict[str, Any]) -> DayJudged:
        """Return what ``to_json`` made."""
        began_at, ended_at = (datetime.fromisoformat(said[name]) for name in ("began_at", "ended_at"))
        return cls(said["rows"], began_at, ended_at, said["document"], said["reason"])
