"""How every valve of a large plant stands, by one light query: what the list is sorted by before a page is read."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine, select

from service.runs.run import RunState
from service.store.schema_nightly import VALVE_STATES


@dataclass(frozen=True, slots=True)
class ValveStanding:
    """The state of a valve's last test, and the NE 107 state that its last completed one found, and when."""

    state: RunState
    safe_confirmed: bool | None
    last_at: datetime
    ne107: str | None
    completed_at: datetime | None

    @property
    def may_be_bad(self) -> bool:
        """Whether the last test may stand as an alarm: then the whole of it must be looked at."""
        return self.safe_confirmed is False or self.state in (RunState.FAILED, RunState.INTERRUPTED)


def valve_standings(engine: Engine) -> dict[str, ValveStanding]:
    """Return how each valve that was ever tested stands; blocks."""
    states = VALVE_STATES.c
    query = select(states.valve, states.state, states.safe_confirmed, states.last_at, states.ne107, states.completed_at)
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return {valve: ValveStanding(RunState(state), *others) for valve, state, *others in rows}
