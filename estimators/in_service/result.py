"""What a record in service says: its units, its figures and their JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from estimators.in_service.figure import Figure
from estimators.in_service.travel import Travel

COUNTED_FROM_M: Final = 1.0  # position of a stand-in nameplate: 1 m is the whole travel


class Input(StrEnum):
    """Which channel says what drives the stem."""

    FORCE = "force"
    PRESSURE = "pressure"
    COMMAND = "command"


@dataclass(frozen=True, slots=True)
class Scale:
    """What is known of the units of a recording.

    ``travel_m`` and ``area_m2`` None where no nameplate says them. ``is_share``: positions are shares of the travel,
    1 m standing for all of it. ``command_percent_pa``: the command is in percent, of so many Pa each.
    """

    travel_m: float | None = None
    area_m2: float | None = None
    is_share: bool = False
    command_percent_pa: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """What a record in service says; ``figures`` by name, in SI units or those that ``Figure.unit`` names."""

    rows: int
    duration_s: float
    covered_s: float
    period_s: float
    is_even: bool
    gaps: int
    driven_by: Input
    position_unit: str
    position_noise: float
    is_reversed: bool
    moves: int
    breakaways: int
    figures: dict[str, Figure]
    travel: Travel
    notes: tuple[str, ...] = field(default_factory=tuple)


def to_json(found: Watched) -> dict[str, Any]:
    """Return the result as an object of JSON, ``breakaway/watch/1``."""
    factor = 100.0 if found.position_unit == "%" else 1.0
    travel = found.travel
    return {
        "schema": "breakaway/watch/1",
        "recording": {
            "samples": found.rows,
            "duration_s": found.duration_s,
            "covered_s": found.covered_s,
            "sample_period_s": found.period_s,
            "is_even": found.is_even,
            "gaps": found.gaps,
            "driven_by": str(found.driven_by),
            "position_unit": found.position_unit,
            "position_noise": found.position_noise,
            "is_reversed": found.is_reversed,
        },
        "moves": found.moves,
        "breakaways": found.breakaways,
        "figures": {name: one.to_json() for name, one in sorted(found.figures.items())},
        "travel": {
            "unit": found.position_unit,
            "total": travel.total * factor,
            "total_ci95": [end * factor for end in travel.total_ci95],
            "per_hour": travel.per_hour * factor,
            "cycles": travel.cycles,
            "lowest": travel.lowest * factor,
            "highest": travel.highest * factor,
            "mean": travel.mean * factor,
            "histogram": {"edges": (travel.edges * factor).tolist(), "time_shares": travel.shares.tolist()},
        },
        "notes": list(found.notes),
    }
