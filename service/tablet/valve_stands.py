"""How each valve stands, the worst first, and what the list of valves is made from."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated

from fastapi import Depends

from service.config.plant import Plant
from service.health.staleness import Staleness
from service.http.given import Given
from service.runs.service import Runs
from service.shown.words import Condition, condition_of
from service.store.conditions import ValveStanding, valve_standings
from service.store.store import Store


@dataclass(frozen=True, slots=True)
class Stand:
    """How a valve stands. ``at_rest`` leaves aside that it is under test now; ``standing`` is None without a test."""

    condition: Condition
    at_rest: Condition
    standing: ValveStanding | None


@dataclass(frozen=True, slots=True)
class ValveSource:
    """What the list of valves is made from."""

    plant: Plant
    store: Store
    runs: Runs
    staleness: Staleness


async def _valve_source(
    plant: Given[Plant], store: Given[Store], runs: Given[Runs], staleness: Given[Staleness]
) -> ValveSource:
    return ValveSource(plant, store, runs, staleness)


ValveSourceOf = Annotated[ValveSource, Depends(_valve_source)]


def valve_stands(source: ValveSource) -> dict[str, Stand]:
    """Return how each valve stands: worst first, then by what was found does to the stem, then by tag.

    Reads the database, so callers use a thread.
    """
    standings = valve_standings(source.store.engine)
    doubtful = [tag for tag, one in standings.items() if one.may_be_bad and tag in source.plant.valves]
    heads = source.store.runs.valve_heads(doubtful) if doubtful else {}
    stands, now = {}, datetime.now(UTC)
    for tag in source.plant.valves:
        standing = standings.get(tag)
        tested = (None, None) if standing is None else (standing.ne107, standing.completed_at)
        ne107 = source.staleness.oldest(tag, now).state(*tested)
        is_busy = source.runs.user_of(tag) is not None
        last = heads[tag].last if tag in heads else None
        at_rest = condition_of(last, ne107, is_busy=False, is_tested=standing is not None)
        condition = condition_of(last, ne107, is_busy=True, is_tested=True) if is_busy else at_rest
        stands[tag] = Stand(condition, at_rest, standing)

    def place(item: tuple[str, Stand]) -> tuple[int, float, str]:
        tag, stand = item
        effect = None if stand.standing is None else stand.standing.effect_percent
        return stand.condition.rank, -(effect or 0.0), tag

    return dict(sorted(stands.items(), key=place))
