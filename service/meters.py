"""What this process has measured since it started: samples, gaps, lateness, ends of motions, times of analyses."""

from __future__ import annotations

import threading
from collections import OrderedDict
from datetime import UTC, datetime
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest

from drivers.outcome import SampleBlock
from service.config.plant import Plant
from service.model.analysis import REPEATED
from service.model.run import ENDED_KEY, Run, RunState

_REMEMBERED: Final = 10_000  # tests that were counted already: each is stored several times
_JITTER_S: Final = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 2e-2, 5e-2, 0.1)
_LATE_S: Final = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0)
_ANALYSIS_S: Final = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0)


class Meters:
    """Counts every test once, by its bus; what is stored is what is counted. ``note`` is called from any thread.

    Lateness is counted while a test runs, as its samples are written down.
    """

    def __init__(self, plant: Plant) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._since = datetime.now(UTC)
        self._counted: OrderedDict[tuple[str, str], None] = OrderedDict()
        self._lock = threading.Lock()
        self._buses: dict[str, str] = {}
        self.read(plant)
        self._samples = self._by_bus("breakaway_samples", "samples that were recorded")
        self._gaps = self._by_bus("breakaway_sample_gaps", "samples that could not be had")
        self._missed = self._by_bus("breakaway_missed_slots", "sampling instants without a sample")
        self._motions = Counter(
            "breakaway_motions", "motions by how they ended", labelnames=["bus", "ended"], registry=self._registry
        )
        self._jitter = Histogram(
            "breakaway_sampling_jitter_seconds",
            "rms of a test's sampling periods about their median",
            labelnames=["bus"],
            registry=self._registry,
            buckets=_JITTER_S,
        )
        self._lateness = Histogram(
            "breakaway_sampling_lateness_seconds",
            "how long after its slot a polled sample began",
            labelnames=["bus"],
            registry=self._registry,
            buckets=_LATE_S,
        )
        self._analyses = Histogram(
            "breakaway_analysis_seconds",
            "from the end of the motion to the result",
            registry=self._registry,
            buckets=_ANALYSIS_S,
        )

    def read(self, plant: Plant) -> None:
        """Read anew which bus each valve is on."""
        self._buses = {**self._buses, **{tag: valve.wiring.command.bus for tag, valve in plant.valves.items()}}

    def _by_bus(self, name: str, text: str) -> Counter:
        return Counter(name, text, labelnames=["bus"], registry=self._registry)

    def note_samples(self, tag: str, block: SampleBlock) -> None:
        """Count how late samples of a running test were taken; those that a device took by itself have no slot here."""
        if block.late_s is not None:
            lateness = self._lateness.labels(self._buses.get(tag, ""))
            for late_s in block.late_s.tolist():
                lateness.observe(max(0.0, late_s))

    def note(self, run: Run) -> None:
        """Count what is new in a run; one of an earlier process, acknowledged now, is not counted again."""
        if run.started_at is None or run.started_at < self._since or run.motion_ended_at is None:
            return
        if run.quality is not None and self._first("motion", run.id):
            self._count_motion(run)
        is_first = REPEATED not in (run.analysis or {})  # one that is made again ends hours after its motion
        if is_first and run.state is RunState.COMPLETED and run.finished_at and self._first("analysis", run.id):
            self._analyses.observe((run.finished_at - run.motion_ended_at).total_seconds())

    def _count_motion(self, run: Run) -> None:
        bus, quality = self._buses.get(run.valve, ""), run.quality or {}
        self._motions.labels(bus, str(quality.get(ENDED_KEY, "unknown"))).inc()
        for counter, name in ((self._samples, "samples"), (self._gaps, "gaps"), (self._missed, "missed_slots")):
            counter.labels(bus).inc(max(0, int(quality.get(name) or 0)))
        jitter_s = quality.get("jitter_rms_s")
        if jitter_s is not None:
            self._jitter.labels(bus).observe(float(jitter_s))

    def _first(self, kind: str, run_id: str) -> bool:
        with self._lock:
            if (kind, run_id) in self._counted:
                return False
            self._counted[kind, run_id] = None
            while len(self._counted) > _REMEMBERED:
                self._counted.popitem(last=False)
            return True

    def text(self) -> bytes:
        """Return it all in Prometheus' text format."""
        return generate_latest(self._registry)
