"""How each valve stood at an earlier instant: what its last result was then, and whether that was too old already."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine

from service.config.plant import Plant, PlantValve
from service.health.staleness import Staleness
from service.store.conditions import results_before


@dataclass(frozen=True, slots=True)
class _Then:
    """One instant of one plant; ``known`` has None where a valve had no result by then."""

    at: datetime
    valves: Mapping[str, PlantValve]
    stale: Staleness
    known: dict[str, tuple[str | None, datetime] | None]


class EarlierResults:
    """The results of the newest instant that was asked for. What was found by then changes no more: it is read once."""

    def __init__(self) -> None:
        self._then: _Then | None = None

    def states(
        self, engine: Engine, plant: Plant, at: datetime, valves: Collection[str]
    ) -> dict[str, tuple[str | None, datetime] | None]:
        """Return NE 107 state and time of each valve's last result before ``at``, None where it had none; blocks."""
        known = self._at(plant, at).known
        missing = [tag for tag in valves if tag not in known]
        if missing:
            found = results_before(engine, at, missing)
            known.update({tag: found.get(tag) for tag in missing})
        return {tag: known[tag] for tag in valves}

    def as_it_stood(
        self, plant: Plant, at: datetime, tag: str, result: tuple[str | None, datetime | None]
    ) -> str | None:
        """Return the NE 107 state by which a result spoke for its valve at ``at``."""
        return self._at(plant, at).stale.oldest(tag, at).state(*result)

    def _at(self, plant: Plant, at: datetime) -> _Then:
        then = self._then
        if then is None or then.at != at or then.valves is not plant.valves:
            then = self._then = _Then(at, plant.valves, Staleness(plant), {})
        return then
