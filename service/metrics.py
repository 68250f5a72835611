"""``/metrics`` for Prometheus, counted from the store when it is asked: a restart forgets nothing, no test waits."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Response
from prometheus_client import PROCESS_COLLECTOR, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector
from sqlalchemy import func, select

from service.access.needs import needs
from service.access.principal import Right
from service.parts import Parts, parts_of
from service.problems import PROBLEMS
from service.runs.run import RunState
from service.store.schema import TESTS

router = APIRouter(tags=["service"], responses=PROBLEMS)
_NE107: Final = ("N", "C", "S", "M", "F")


class PlantCollector(Collector):
    """The plant at one moment. Reads the store, so it may block."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def collect(self) -> Iterator[Metric]:
        """Yield every family."""
        info = GaugeMetricFamily("breakaway_build", "1; the label is the version", labels=["version"])
        info.add_metric([self._parts.version], 1.0)
        yield info
        yield from self._tests()
        yield from self._valves()
        entries = CounterMetricFamily("breakaway_audit_entries", "entries of this gateway's audit log")
        entries.add_metric([], self._parts.audit.head[0])
        yield entries

    def _tests(self) -> Iterator[Metric]:
        with self._parts.store.engine.connect() as connection:
            counted = {
                str(state): int(count)
                for state, count in connection.execute(select(TESTS.c.state, func.count()).group_by(TESTS.c.state))
            }
            unsafe = connection.execute(
                select(func.count()).where(TESTS.c.safe_confirmed.is_(False), TESTS.c.acknowledged_at.is_(None))
            ).scalar_one()
        tests = GaugeMetricFamily("breakaway_tests", "tests in the store by state", labels=["state"])
        for state in RunState:
            tests.add_metric([state.value], counted.get(state.value, 0))
        yield tests
        alarms = GaugeMetricFamily(
            "breakaway_safe_state_not_confirmed",
            "tests that left a valve in doubt, not acknowledged",
        )
        alarms.add_metric([], int(unsafe))
        yield alarms

    def _valves(self) -> Iterator[Metric]:
        heads = self._parts.store.runs.valve_heads()
        busy = GaugeMetricFamily("breakaway_valve_under_test", "1 while a test uses the valve", labels=["valve"])
        health = GaugeMetricFamily(
            "breakaway_valve_ne107",
            "1 for the NE 107 state of the last completed test",
            labels=["valve", "state"],
        )
        finished = GaugeMetricFamily(
            "breakaway_valve_last_test_timestamp_seconds", "when the last test ended", labels=["valve"]
        )
        for tag in sorted(self._parts.plant.valves):
            busy.add_metric([tag], float(self._parts.runs.user_of(tag) is not None))
            head = heads.get(tag)
            if head is None:
                continue
            if head.last.finished_at is not None:
                finished.add_metric([tag], head.last.finished_at.timestamp())
            known = (head.health or {}).get("ne107")
            for state in _NE107 if known in _NE107 else ():
                health.add_metric([tag, state], float(state == known))
        yield from (busy, finished, health)


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[needs(Right.VIEW)],
    responses={200: {"content": {"text/plain": {}}, "description": "Prometheus' text format"}},
)
async def metrics(parts: Annotated[Parts, Depends(parts_of)]) -> Response:
    """Return the plant's metrics. Prometheus sends a viewer's token where sign-in is on."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(PROCESS_COLLECTOR)
    registry.register(PlantCollector(parts))
    counted = await asyncio.to_thread(generate_latest, registry)
    return Response(counted + parts.meters.text(), media_type=CONTENT_TYPE_LATEST)
