"""A valve's past as the pages need it: the last tests, the baseline, and the trend of each figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from service.figures.trend import Trend, TrendPoint
from service.runs.run import Label, Run, RunState
from service.store.store import Store

_TREND_TESTS: Final = 40
_TRENDS: Final = (
    ("friction_mean_n", "friction, mean", "N"),
    ("spring_rate_n_per_m", "spring rate", "N/m"),
    ("bench_set_low", "bench set, low end", "Pa"),
    ("dead_band_percent", "dead band", "percent"),
)


@dataclass(frozen=True, slots=True)
class ValvePast:
    """What is known of a valve's tests, newest first; ``baseline`` is the test that later ones are held against."""

    newest: tuple[Run, ...]
    completed: tuple[Run, ...]
    baseline: Run | None

    @property
    def trends(self) -> tuple[Trend, ...]:
        """Each figure over the completed tests, oldest first."""
        base = None if self.baseline is None else (self.baseline.analysis or {}).get("signature")
        return tuple(
            Trend(name, meaning, unit, tuple(_points(self.completed, name)), _value(base, name))
            for name, meaning, unit in _TRENDS
        )


def past_of(store: Store, tag: str) -> ValvePast:
    """Return a valve's past; reads the database, so callers on the event loop use a thread."""
    newest = tuple(store.runs.newest(_TREND_TESTS, valve=tag))
    completed = tuple(store.runs.get(run.id) for run in newest if run.state is RunState.COMPLETED)
    return ValvePast(newest, completed, _baseline(completed))


def _baseline(completed: tuple[Run, ...]) -> Run | None:
    """Return the newest test after a repair; where there is none, the oldest known."""
    left = next((run for run in completed if run.label is Label.AS_LEFT), None)
    return left or (completed[-1] if completed else None)


def _value(signature: Mapping[str, Any] | None, name: str) -> float | None:
    if signature is None:
        return None
    if name == "bench_set_low":
        bench = signature.get("bench_set_pa")
        value = None if not bench else bench[0]
    else:
        value = signature.get(name)
    return None if value is None else float(value)


def _points(completed: tuple[Run, ...], name: str) -> list[TrendPoint]:
    points = []
    for run in reversed(completed):
        signature = (run.analysis or {}).get("signature")
        value = _value(signature, name)
        if value is None or signature is None:
            continue
        ci95 = ((signature.get("intervals") or {}).get(name) or {}).get("ci95")
        points.append(TrendPoint(run.created_at, value, None if ci95 is None else (ci95[0], ci95[1]), run.label or ""))
    return points
