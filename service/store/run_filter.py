"""Which stored tests are meant, as a condition on their rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from sqlalchemy import ColumnElement, Connection, exists, func, select

from service.model.run import Label, RunState
from service.store.schema_health import FIGURES
from service.store.schema_tests import TESTS

_FEW: Final = 2000  # tests of a state: so many are looked up one by one faster than all are walked past


@dataclass(frozen=True, slots=True)
class RunFilter:
    """Which runs are meant; what is empty or None asks for nothing. ``ne107`` is what the test itself found.

    ``since`` and ``until``: asked for at the first or later, and before the second. ``valves`` is None for all.
    """

    valve: str | None = None
    states: Sequence[RunState] = ()
    ne107: Sequence[str] = ()
    labels: Sequence[Label] = ()
    since: datetime | None = None
    until: datetime | None = None
    valves: Sequence[str] | None = None

    def conditions(self) -> list[ColumnElement[bool]]:
        """Return what a row of tests must meet."""
        tests, found = TESTS.c, FIGURES.c
        asked: list[tuple[bool, Callable[[], ColumnElement[bool]]]] = [
            (self.valve is not None, lambda: tests.valve == self.valve),
            (self.valves is not None, lambda: tests.valve.in_(self.valves or ())),
            (bool(self.states), lambda: tests.state.in_([state.value for state in self.states])),
            (bool(self.labels), lambda: tests.label.in_([label.value for label in self.labels])),
            (self.since is not None, lambda: tests.created_at >= self.since),
            (self.until is not None, lambda: tests.created_at < self.until),
            (
                bool(self.ne107),
                lambda: exists().where(found.number == tests.number, found.ne107.in_(list(self.ne107))),
            ),
        ]
        return [*(condition() for is_asked, condition in asked if is_asked), *self._bounds(tests.number)]

    def _bounds(self, number: ColumnElement[int]) -> list[ColumnElement[bool]]:
        """Return between which numbers the tests of the asked time lie: newest first, a walk begins and ends there.

        It follows from the times themselves, so it stays true where the clock was set back. ``+ 0`` has the index of
        times read for it: both databases would walk all numbers for a plain minimum.
        """
        of_time = TESTS.alias("of_time").c
        asked = [] if self.since is None else [of_time.created_at >= self.since]
        asked += [] if self.until is None else [of_time.created_at < self.until]
        bounds: list[ColumnElement[bool]] = []
        if self.since is not None:
            bounds.append(number >= select(func.min(of_time.number + 0)).where(*asked).scalar_subquery())
        if self.until is not None:
            bounds.append(number <= select(func.max(of_time.number + 0)).where(*asked).scalar_subquery())
        return bounds

    def narrowed(self, connection: Connection) -> list[ColumnElement[bool]]:
        """Return what lets the database begin with the few tests of these NE 107 states, where they are few."""
        if not self.ne107:
            return []
        found = select(FIGURES.c.number).where(FIGURES.c.ne107.in_(list(self.ne107)), *self._bounds(FIGURES.c.number))
        numbers = connection.scalars(found.limit(_FEW + 1)).all()
        return [TESTS.c.number.in_(numbers)] if len(numbers) <= _FEW else []
