"""Accepted models in the database: the only module that turns their rows into models and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Engine, insert, select, update

from service.store.schema_models import MODELS


@dataclass(frozen=True, slots=True)
class AcceptedModel:
    """A model that stands for a valve: ``model`` is ``discrepancy.extended_model`` of the test ``test``."""

    number: int
    valve: str
    test: str
    model: Mapping[str, Any]
    accepted_at: datetime
    accepted_by: str


class ModelTable:
    """Accepted models by valve; every method is one transaction and may block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def accept(self, valve: str, test: str, model: Mapping[str, Any], who: str) -> AcceptedModel:
        """Store a model as the valve's own, in the place of the one before; it is on disk when this returns."""
        now = datetime.now(UTC)
        with self._engine.begin() as connection:
            connection.execute(self._standing(valve).values(withdrawn_at=now, withdrawn_by=who))
            values = {"valve": valve, "test": test, "model": dict(model), "accepted_at": now, "accepted_by": who}
            key = connection.execute(insert(MODELS).values(values)).inserted_primary_key
            number = 0 if key is None else int(key[0])
        return AcceptedModel(number, valve, test, model, now, who)

    def current(self, valve: str) -> AcceptedModel | None:
        """Return the model that stands for a valve, if any."""
        query = select(MODELS).where(MODELS.c.valve == valve, MODELS.c.withdrawn_at.is_(None))
        with self._engine.connect() as connection:
            row = connection.execute(query.order_by(MODELS.c.number.desc()).limit(1)).one_or_none()
        if row is None:
            return None
        return AcceptedModel(row.number, row.valve, row.test, row.model, row.accepted_at, row.accepted_by)

    def withdraw(self, valve: str, who: str) -> bool:
        """Take the valve's model back; whether there was one."""
        with self._engine.begin() as connection:
            changed = connection.execute(
                self._standing(valve).values(withdrawn_at=datetime.now(UTC), withdrawn_by=who)
            ).rowcount
        return bool(changed > 0)

    @staticmethod
    def _standing(valve: str) -> Any:
        return update(MODELS).where(MODELS.c.valve == valve, MODELS.c.withdrawn_at.is_(None))
