"""How many tests are in each state: counted once, then only what came since; a large plant has millions."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping

from sqlalchemy import Connection, Engine, func, select

from service.model.run import RunState
from service.store.schema_tests import TESTS

_UNFINISHED = tuple(state.value for state in RunState if not state.finished)


class StateCounts:
    """Counts the tests of a database. Tests that have ended keep their state: each is counted once a process.

    All but those whose analysis is made again, which is said by ``count_anew``.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._ended: Counter[str] = Counter()  # of the tests up to that number, all of which have ended
        self._up_to = 0
        self._lock = threading.Lock()

    def count_anew(self) -> None:
        """Count all once more at the next call."""
        with self._lock:
            self._ended, self._up_to = Counter(), 0

    def now(self) -> Mapping[RunState, int]:
        """Return how many tests are in each state that any of them is in; blocks."""
        with self._lock, self._engine.connect() as connection:
            first = connection.execute(select(func.min(TESTS.c.number)).where(TESTS.c.state.in_(_UNFINISHED))).scalar()
            last = connection.execute(select(func.max(TESTS.c.number))).scalar() or 0
            ended_to = last if first is None else first - 1
            if ended_to > self._up_to:
                self._ended += _between(connection, self._up_to, ended_to)
                self._up_to = ended_to
            counts = self._ended + _between(connection, self._up_to, last)
        return {RunState(state): count for state, count in counts.items()}


def _between(connection: Connection, above: int, last: int) -> Counter[str]:
    query = select(TESTS.c.state, func.count()).where(TESTS.c.number > above, TESTS.c.number <= last)
    return Counter({str(state): int(count) for state, count in connection.execute(query.group_by(TESTS.c.state))})
