"""Figures and baselines in the database: the only module that turns their rows into what health is judged by."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Engine, delete, insert, or_, select, update

from service.model.health_figures import FIGURE_KINDS, Figure, figures_of
from service.model.past_test import Baseline, PastTest, is_good
from service.model.run import Label, Run
from service.store.schema_health import BASELINES, FIGURES
from service.store.schema_nightly import VALVE_STATES
from service.store.schema_tests import ANALYSES


def conditions_of(run: Run) -> str:
    """Name the motion of a run: its sequence, and what was overridden of it."""
    if not run.overrides:
        return run.sequence
    canonical = json.dumps(dict(run.overrides), sort_keys=True, separators=(",", ":"))
    return f"{run.sequence}#{hashlib.sha256(canonical.encode()).hexdigest()[:12]}"


def write_figures(connection: Connection, run: Run) -> None:
    """Keep the figures of a completed run, in its transaction; the first that passes acceptance becomes the baseline.

    So does one that passes and is labelled as left: what comes after a repair is held against how the valve was left.
    Another becomes it only where a person chooses it.
    """
    assert run.analysis is not None
    is_again = connection.execute(delete(FIGURES).where(FIGURES.c.number == run.number)).rowcount > 0
    row = _row(run, run.analysis)
    connection.execute(insert(FIGURES).values(row))
    if is_again or not (row["good"] and _acceptance(run.analysis).get("passed")):
        return
    if run.label is Label.AS_LEFT:
        _set_baseline(connection, run.valve, row["conditions"], run.id, "")
    elif _current(connection, run.valve, row["conditions"]) is None:
        values = {"valve": run.valve, "conditions": row["conditions"], "test_id": run.id, "set_by": ""}
        connection.execute(insert(BASELINES).values(values | {"set_at": datetime.now(UTC)}))


def _row(run: Run, analysis: Mapping[str, Any]) -> dict[str, Any]:
    discrepancy = analysis.get("discrepancy") or {}
    row: dict[str, Any] = {
        "number": run.number,
        "test_id": run.id,
        "valve": run.valve,
        "conditions": conditions_of(run),
        "at": run.created_at,
        "label": None if run.label is None else run.label.value,
        "ne107": (analysis.get("health") or {}).get("ne107"),
        "verdict": str(discrepancy.get("verdict") or "not_assessed")[:16],
        "causes": [str(cause["cause"]) for cause in discrepancy.get("causes") or ()],
        "good": is_good(analysis),
        "engine": analysis.get("engine"),
        "unmet": [str(one["name"]) for one in _acceptance(analysis).get("checks") or () if one["met"] is False],
    }
    for key, figure in figures_of(analysis).items():
        low, high = figure.ci95 or (None, None)
        row |= {key: figure.value, f"{key}_low": low, f"{key}_high": high}
    return row


def _acceptance(analysis: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Mapping[str, Any] = (analysis.get("health") or {}).get("acceptance") or {}
    return found


def _past(row: Any) -> PastTest:
    values = row._mapping
    figures = {}
    for key in FIGURE_KINDS:
        value, low, high = values[key], values[f"{key}_low"], values[f"{key}_high"]
        if value is not None:
            figures[key] = Figure(value, None if low is None or high is None else (low, high))
    return PastTest(
        row.test_id, row.at, figures, tuple(row.causes), row.verdict, row.label, row.ne107, tuple(row.unmet or ())
    )


def _current(connection: Connection, valve: str, conditions: str) -> Any:
    mine = (BASELINES.c.valve == valve) & (BASELINES.c.conditions == conditions) & BASELINES.c.withdrawn_at.is_(None)
    return connection.execute(select(BASELINES).where(mine).order_by(BASELINES.c.number.desc()).limit(1)).one_or_none()


def _set_baseline(connection: Connection, valve: str, conditions: str, test_id: str, who: str) -> None:
    """Set a baseline; those of the valve's other motions are of the time before it and fall."""
    now = datetime.now(UTC)
    standing = (BASELINES.c.valve == valve) & BASELINES.c.withdrawn_at.is_(None)
    connection.execute(update(BASELINES).where(standing).values(withdrawn_at=now))
    values = {"valve": valve, "conditions": conditions, "test_id": test_id, "set_by": who, "set_at": now}
    connection.execute(insert(BASELINES).values(values))


class FigureTable:
    """Figures of tests and baselines of valves; every method is one transaction and may block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def get(self, test_id: str) -> PastTest | None:
        """Return the figures of a test, if it has any."""
        with self._engine.connect() as connection:
            row = connection.execute(select(FIGURES).where(FIGURES.c.test_id == test_id)).one_or_none()
        return None if row is None else _past(row)

    def newest(
        self, valve: str, limit: int, *, conditions: str | None = None, label: Label | None = None
    ) -> list[PastTest]:
        """Return the newest tests of a valve that have figures, newest first; of one motion, or label, where named."""
        query = select(FIGURES).where(FIGURES.c.valve == valve)
        if conditions is not None:
            query = query.where(FIGURES.c.conditions == conditions)
        if label is not None:
            query = query.where(FIGURES.c.label == label.value)
        with self._engine.connect() as connection:
            rows = connection.execute(query.order_by(FIGURES.c.number.desc()).limit(limit)).all()
        return [_past(row) for row in rows]

    def friction_mean_n(self, numbers: Sequence[int]) -> dict[int, float]:
        """Return the mean friction, N, of tests by their numbers, of those that have one."""
        mean_n = FIGURES.c.friction_mean_n
        query = select(FIGURES.c.number, mean_n).where(FIGURES.c.number.in_(numbers), mean_n.is_not(None))
        with self._engine.connect() as connection:
            return {row.number: row.friction_mean_n for row in connection.execute(query)}

    def of_tests(self, numbers: Sequence[int]) -> dict[int, PastTest]:
        """Return the figures of tests by their numbers, of those that have any."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(FIGURES).where(FIGURES.c.number.in_(numbers))).all()
        return {row.number: _past(row) for row in rows}

    def of_ids(self, test_ids: Sequence[str]) -> dict[str, PastTest]:
        """Return the figures of tests by their ids, of those that have any."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(FIGURES).where(FIGURES.c.test_id.in_(test_ids))).all()
        return {row.test_id: _past(row) for row in rows}

    def with_loops(self, test_ids: Sequence[str]) -> frozenset[str]:
        """Return those of these tests whose signature has a loop that can be drawn: two points of one direction."""
        second = [
            ANALYSES.c.document["signature", "curve", way, "travel_m", 1].as_float().is_not(None)
            for way in ("up", "down")
        ]
        query = select(FIGURES.c.test_id).join(ANALYSES, ANALYSES.c.number == FIGURES.c.number)
        with self._engine.connect() as connection:
            return frozenset(connection.scalars(query.where(FIGURES.c.test_id.in_(test_ids), or_(*second))))

    def of_last_results(self, kinds: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return figures of these kinds, SI, of each valve's last completed test, by valve; what is unknown is out."""
        states, columns = VALVE_STATES.c, [FIGURES.c[kind] for kind in kinds]
        query = select(states.valve, *columns).join(FIGURES, FIGURES.c.number == states.completed_number)
        with self._engine.connect() as connection:
            rows = connection.execute(query).all()
        return {
            row.valve: {kind: value for kind, value in zip(kinds, row[1:], strict=True) if value is not None}
            for row in rows
        }

    def baseline(self, valve: str, conditions: str | None = None) -> Baseline | None:
        """Return the baseline of a valve's motion; without a motion the one that was set last."""
        standing = (BASELINES.c.valve == valve) & BASELINES.c.withdrawn_at.is_(None)
        query = select(FIGURES, BASELINES.c.set_by, BASELINES.c.set_at).join_from(
            BASELINES, FIGURES, BASELINES.c.test_id == FIGURES.c.test_id
        )
        if conditions is not None:
            query = query.where(BASELINES.c.conditions == conditions)
        with self._engine.connect() as connection:
            row = connection.execute(query.where(standing).order_by(BASELINES.c.number.desc()).limit(1)).one_or_none()
        return None if row is None else Baseline(_past(row), row.set_by, row.set_at)

    def baselines_before(self, engine: int) -> list[tuple[str, str]]:
        """Return valve and test of each baseline that stands and whose figures an earlier engine made, oldest first."""
        query = select(BASELINES.c.valve, BASELINES.c.test_id).join_from(
            BASELINES, FIGURES, BASELINES.c.test_id == FIGURES.c.test_id
        )
        older = FIGURES.c.engine.is_(None) | (FIGURES.c.engine < engine)
        query = query.where(BASELINES.c.withdrawn_at.is_(None), older).order_by(BASELINES.c.number)
        with self._engine.connect() as connection:
            return list(dict.fromkeys((row.valve, row.test_id) for row in connection.execute(query)))

    def set_baseline(self, run: Run, who: str) -> Baseline | None:
        """Make a test the valve's baseline; it is on disk when this returns. None where the test has no figures."""
        with self._engine.begin() as connection:
            found = connection.execute(select(FIGURES.c.conditions).where(FIGURES.c.test_id == run.id)).one_or_none()
            if found is None:
                return None
            _set_baseline(connection, run.valve, found.conditions, run.id, who)
        return self.baseline(run.valve, found.conditions)
