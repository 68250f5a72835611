"""How every valve of a large plant stands, by one light query: what the list is sorted by before a page is read."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine, select

from drivers.stands_at import StemVerdict
from service.runs.run import RunState
from service.store.schema_nightly import VALVE_STATES


@dataclass(frozen=True, slots=True)
class ValveStanding:
    """The state of a valve's last test and of its stem, and the NE 107 state of its last completed one, and when."""

    state: RunState
    safe_confirmed: bool | None
    last_at: datetime
    ne107: str | None
    completed_at: datetime | None
    stem: StemVerdict | None = None

    @property
    def may_be_bad(self) -> bool:
        """Whether the last test may be an alarm, or its stem may still move: then the whole of it must be looked at."""
        is_astray = self.stem is not None and (self.stem.is_alarm or self.stem is StemVerdict.MOVING)
        return is_astray or self.safe_confirmed is False or self.state in (RunState.FAILED, RunState.INTERRUPTED)


def valve_standings(engine: Engine) -> dict[str, ValveStanding]:
    """Return how each valve that was ever tested stands; blocks."""
    states = VALVE_STATES.c
    names = (states.safe_confirmed, states.last_at, states.ne107, states.completed_at, states.stem)
    query = select(states.valve, states.state, *names)
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return {
        row.valve: ValveStanding(RunState(row.state), *row[2:6], None if row.stem is None else StemVerdict(row.stem))
        for row in rows
    }
