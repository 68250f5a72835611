"""How every valve of a large plant stands, by one light query: what the list is sorted by before a page is read."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine, select

from service.runs.run import RunState
from service.store.schema import TESTS
from service.store.schema_health import FIGURES
from service.store.schema_nightly import VALVE_STATES


@dataclass(frozen=True, slots=True)
class ValveStanding:
    """The state of a valve's last test and the NE 107 state that its last completed one found."""

    state: RunState
    safe_confirmed: bool | None
    ne107: str | None
    at: datetime

    @property
    def may_be_bad(self) -> bool:
        """Whether the last test may stand as an alarm: then the whole of it must be looked at."""
        return self.safe_confirmed is False or self.state in (RunState.FAILED, RunState.INTERRUPTED)


def valve_standings(engine: Engine) -> dict[str, ValveStanding]:
    """Return how each valve that was ever tested stands; blocks."""
    query = select(
        VALVE_STATES.c.valve,
        TESTS.c.state,
        TESTS.c.safe_confirmed,
        FIGURES.c.ne107,  # not out of the health beside it, which is a document of some kilobytes
        TESTS.c.created_at,
    )
    query = query.join_from(VALVE_STATES, TESTS, TESTS.c.number == VALVE_STATES.c.last_number)
    query = query.join(FIGURES, FIGURES.c.number == VALVE_STATES.c.completed_number, isouter=True)
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return {valve: ValveStanding(RunState(state), safe, ne107, at) for valve, state, safe, ne107, at in rows}
