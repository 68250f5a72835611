"""``/metrics`` for Prometheus, counted from the store when it is asked: a restart forgets nothing, no test waits."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import PROCESS_COLLECTOR, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector

from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink, MotionLostError
from service.access.needs import needs
from service.access.principal import Right
from service.config.plant import Plant
from service.health.staleness import Staleness
from service.http.given import Given, part_if_given
from service.http.problems import PROBLEMS
from service.meters import Meters
from service.model.health_figures import MAIN_FIGURES
from service.model.plant_alarm import AlarmKind
from service.model.run import RunState
from service.mqtt.metrics import BrokerCollector
from service.runs.motion_watch import MotionWatch
from service.runs.service import Runs
from service.store.conditions import valve_standings
from service.store.store import Store

router = APIRouter(tags=["service"], responses=PROBLEMS)
_NE107: Final = ("N", "C", "S", "M", "F")
# By figure: the name in Prometheus, with its unit, and what it is.
_FIGURES: Final = {
    "friction_mean_n": ("breakaway_valve_friction_newtons", "mean friction of the last completed test"),
    "dead_band_percent": ("breakaway_valve_dead_band_percent", "dead band of the last completed test"),
    "travel_m": ("breakaway_valve_travel_meters", "travel that the last completed test went through"),
}


@dataclass(frozen=True, eq=False, slots=True)
class PlantCollector(Collector):
    """The plant at one moment. Reads the store, so it may block."""

    version: str
    plant: Plant
    store: Store
    runs: Runs
    staleness: Staleness
    audit: AuditLog
    watch: MotionWatch

    def collect(self) -> Iterator[Metric]:
        """Yield every family."""
        info = GaugeMetricFamily("breakaway_build", "1; the label is the version", labels=["version"])
        info.add_metric([self.version], 1.0)
        yield info
        yield self._alarms()
        yield from self._tests()
        yield from self._valves()
        yield from self._figures()
        entries = CounterMetricFamily("breakaway_audit_entries", "entries of this gateway's audit log")
        entries.add_metric([], self.audit.head[0])
        yield entries

    def _alarms(self) -> Metric:
        standing = {alarm.kind for alarm in self.watch.alarms}
        alarms = GaugeMetricFamily("breakaway_plant_alarm", "1 while this alarm of the plant stands", labels=["alarm"])
        for kind in AlarmKind:
            alarms.add_metric([kind.value], float(kind in standing))
        return alarms

    def _tests(self) -> Iterator[Metric]:
        counted = self.store.state_counts.now()
        unsafe = self.store.runs.count_in_doubt()
        tests = GaugeMetricFamily("breakaway_tests", "tests in the store by state", labels=["state"])
        for state in RunState:
            tests.add_metric([state.value], counted.get(state, 0))
        yield tests
        alarms = GaugeMetricFamily(
            "breakaway_safe_state_not_confirmed",
            "tests that left a valve in doubt, not acknowledged",
        )
        alarms.add_metric([], unsafe)
        yield alarms
        astray = GaugeMetricFamily(
            "breakaway_stem_not_at_safe_position",
            "tests that left a stem not seen at its declared safe position, not acknowledged",
        )
        astray.add_metric([], self.store.runs.count_stems_astray())
        yield astray

    def _valves(self) -> Iterator[Metric]:
        standings, now = valve_standings(self.store.engine), datetime.now(UTC)
        busy = GaugeMetricFamily("breakaway_valve_under_test", "1 while a test uses the valve", labels=["valve"])
        health = GaugeMetricFamily(
            "breakaway_valve_ne107",
            "1; the label is the NE 107 state as it stands today",
            labels=["valve", "state"],
        )
        stale = GaugeMetricFamily(
            "breakaway_valve_stale",
            "1 where no result of a tested valve is new enough for it",
            labels=["valve"],
        )
        untested = GaugeMetricFamily(
            "breakaway_valve_never_tested", "1 where no test of the valve was ever asked for", labels=["valve"]
        )
        last = GaugeMetricFamily(
            "breakaway_valve_last_test_timestamp_seconds", "when the last test was asked for", labels=["valve"]
        )
        result = GaugeMetricFamily(
            "breakaway_valve_last_result_timestamp_seconds",
            "when the last test that completed was asked for",
            labels=["valve"],
        )
        for tag in sorted(self.plant.valves):
            busy.add_metric([tag], float(self.runs.user_of(tag) is not None))
            standing, oldest = standings.get(tag), self.staleness.oldest(tag, now)
            untested.add_metric([tag], float(standing is None))
            stale.add_metric([tag], float(standing is not None and oldest.is_stale(standing.completed_at)))
            known = (
                oldest.state(None, None) if standing is None else oldest.state(standing.ne107, standing.completed_at)
            )
            if known in _NE107:
                health.add_metric([tag, known], 1.0)
            if standing is None:
                continue
            last.add_metric([tag], standing.last_at.timestamp())
            if standing.completed_at is not None:
                result.add_metric([tag], standing.completed_at.timestamp())
        yield from (busy, stale, untested, last, result, health)

    def _figures(self) -> Iterator[Metric]:
        found = self.store.figures.of_last_results(MAIN_FIGURES)
        for kind in MAIN_FIGURES:
            name, words = _FIGURES[kind]
            family = GaugeMetricFamily(name, words, labels=["valve"])
            for tag in sorted(self.plant.valves):
                value = found.get(tag, {}).get(kind)
                if value is not None:
                    family.add_metric([tag], value)
            yield family


class PrecedenceCollector(Collector):
    """Whether the thread that polls comes before other work."""

    def __init__(self, allowed: bool) -> None:
        self._allowed = allowed

    def collect(self) -> Iterator[Metric]:
        """Yield the one family."""
        yield GaugeMetricFamily(
            "breakaway_polling_precedence",
            "1 where the system allows the thread that polls real-time precedence",
            float(self._allowed),
        )


class WatchCollector(Collector):
    """What became of the slots in which valves in service are read, since the motion process started."""

    def __init__(self, slots: Mapping[str, Mapping[str, int]]) -> None:
        self._slots = slots

    def collect(self) -> Iterator[Metric]:
        """Yield the one family."""
        family = CounterMetricFamily(
            "breakaway_watch_slots",
            "slots of valves in service: read, missed as the bus or the process was late, failed; rows kept, and "
            "dropped as the disk was late",
            labels=["valve", "outcome"],
        )
        for tag, counted in sorted(self._slots.items()):
            for outcome, count in counted.items():
                family.add_metric([tag, outcome], count)
        yield family


async def _of_plant(
    request: Request,
    plant: Given[Plant],
    store: Given[Store],
    runs: Given[Runs],
    *,
    staleness: Given[Staleness],
    audit: Given[AuditLog],
    watch: Given[MotionWatch],
) -> PlantCollector:
    return PlantCollector(request.app.version, plant, store, runs, staleness, audit, watch)


async def _broker(request: Request) -> BrokerCollector | None:
    return part_if_given(request.app, BrokerCollector)


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[needs(Right.VIEW)],
    responses={200: {"content": {"text/plain": {}}, "description": "Prometheus' text format"}},
)
async def metrics(
    of_plant: Annotated[PlantCollector, Depends(_of_plant)],
    broker: Annotated[BrokerCollector | None, Depends(_broker)],
    plant: Given[Plant],
    motion: Given[MotionLink],
    meters: Given[Meters],
) -> Response:
    """Return the plant's metrics. Prometheus sends a viewer's token where sign-in is on."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(PROCESS_COLLECTOR)
    registry.register(of_plant)
    if motion.precedence is not None:
        registry.register(PrecedenceCollector(motion.precedence))
    if any(valve.wiring.watch is not None for valve in plant.valves.values()):
        with contextlib.suppress(MotionLostError):
            registry.register(WatchCollector(await motion.watched()))
    if broker is not None:
        registry.register(broker)
    counted = await asyncio.to_thread(generate_latest, registry)
    return Response(counted + meters.text(), media_type=CONTENT_TYPE_LATEST)
