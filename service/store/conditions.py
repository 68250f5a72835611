"""How every valve of a large plant stands, by one light query: what the list is sorted by before a page is read."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine, select

from drivers.stands_at import StemVerdict
from service.model.check import CheckState
from service.model.run import Label, RunState
from service.store.schema_health import FIGURES
from service.store.schema_nightly import SCHEDULE_RUNS, VALVE_STATES
from service.store.schema_tests import TESTS


@dataclass(frozen=True, slots=True)
class ValveStanding:
    """The state of a valve's last test and of its stem; NE 107 state, effect and time of its last completed one.

    ``effect_percent`` is what was found does to the stem, percent of rated travel; None where nothing is known.
    """

    state: RunState
    safe_confirmed: bool | None
    last_at: datetime
    ne107: str | None
    completed_at: datetime | None
    stem: StemVerdict | None = None
    effect_percent: float | None = None

    @property
    def may_be_bad(self) -> bool:
        """Whether the last test may be an alarm, or its stem may still move: then the whole of it must be looked at."""
        is_astray = self.stem is not None and (self.stem.is_alarm or self.stem is StemVerdict.MOVING)
        return is_astray or self.safe_confirmed is False or self.state in (RunState.FAILED, RunState.INTERRUPTED)


def valve_standings(engine: Engine) -> dict[str, ValveStanding]:
    """Return how each valve that was ever tested stands; blocks."""
    states = VALVE_STATES.c
    names = (
        states.safe_confirmed,
        states.last_at,
        states.ne107,
        states.completed_at,
        states.stem,
        states.effect_percent,
    )
    query = select(states.valve, states.state, *names)
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return {
        row.valve: ValveStanding(
            RunState(row.state),
            *row[2:6],
            None if row.stem is None else StemVerdict(row.stem),
            row.effect_percent,
        )
        for row in rows
    }


def results_before(engine: Engine, at: datetime, valves: Collection[str]) -> dict[str, tuple[str | None, datetime]]:
    """Return the NE 107 state of each of these valves' last result before an instant, and when it came; blocks.

    What had no result by then is left out.
    """
    of_valve = FIGURES.alias("of_valve").c
    mine = (of_valve.valve == VALVE_STATES.c.valve) & (of_valve.at < at)
    newest = select(of_valve.number).where(mine).order_by(of_valve.number.desc()).limit(1)
    last = newest.correlate(VALVE_STATES).scalar_subquery()
    query = select(VALVE_STATES.c.valve, FIGURES.c.ne107, FIGURES.c.at)
    query = query.join_from(VALVE_STATES, FIGURES, FIGURES.c.number == last)
    with engine.connect() as connection:
        rows = connection.execute(query.where(VALVE_STATES.c.valve.in_(valves)))
        return {row.valve: (row.ne107, row.at) for row in rows}


def not_carried_out(engine: Engine, since: datetime, until: datetime) -> list[tuple[str, datetime, str]]:
    """Return the checks that were due in between and gave no result: valve, when and why, oldest first; blocks."""
    runs = SCHEDULE_RUNS.c
    ended = [state.value for state in (CheckState.SKIPPED, CheckState.FAILED, CheckState.INTERRUPTED)]
    query = select(runs.valve, runs.due_at, runs.reason).where(runs.due_at >= since, runs.due_at < until)
    with engine.connect() as connection:
        rows = connection.execute(query.where(runs.state.in_(ended)).order_by(runs.due_at, runs.id))
        return [(row.valve, row.due_at, row.reason) for row in rows]


def last_labelled(engine: Engine, labels: Sequence[Label]) -> set[str]:
    """Return the valves whose last test carries one of these labels; blocks."""
    query = select(VALVE_STATES.c.valve).join(TESTS, TESTS.c.number == VALVE_STATES.c.last_number)
    with engine.connect() as connection:
        return set(connection.scalars(query.where(TESTS.c.label.in_([label.value for label in labels]))))
