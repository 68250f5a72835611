"""A valve's past as pages and report need it: last tests, baseline, the trend of each figure with its limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from service.config.plant import PlantValve
from service.figures.trend import Ahead, Trend, TrendPoint
from service.health.changes import allowed, facts_of
from service.model.acknowledgement import needs_acknowledgement
from service.model.health_figures import FIGURE_KINDS, Figure
from service.model.past_test import Baseline, PastTest
from service.model.run import Run
from service.model.watched_day import WatchedDay
from service.shown.diagnosis_words import plain_cause
from service.shown.forecast import all_forecasts
from service.shown.words import STATES
from service.store.figure_table import conditions_of
from service.store.store import Store
from service.words.names import named
from valve.messages import say

_TREND_TESTS: Final = 40
_VERDICTS: Final = {
    "none": say("in_short_none", "no fault found"),
    "unexplained": say("in_brief_unexplained", "unexplained"),
}
_TRENDS: Final = ("friction_mean_n", "spring_rate_n_per_m", "bench_low_pa", "dead_band_percent")


@dataclass(frozen=True, slots=True)
class ValvePast:
    """What is known of a valve's tests, newest first; ``baseline`` is the test that later ones are held against.

    ``figures`` are those of each test; ``same_motion`` those of tests with the motion of ``judged``, the test that is
    looked at, or else the newest completed one. ``watched`` are the newest days in service.
    """

    newest: tuple[Run, ...]
    latest: Run | None
    baseline: Run | None
    figures: tuple[PastTest, ...]
    same_motion: tuple[PastTest, ...]
    held_against: Baseline | None
    valve: PlantValve | None
    judged: Run | None = None
    watched: tuple[WatchedDay, ...] = ()

    @property
    def trends(self) -> tuple[Trend, ...]:
        """Each figure over the tests of one motion, oldest first."""
        return tuple(self._trend(name) for name in _TRENDS)

    def _trend(self, name: str) -> Trend:
        kind = FIGURE_KINDS[name]
        was = None if self.held_against is None else self.held_against.test.figures.get(name)
        base = None if was is None else was.value
        limits, points = self._limits(name, was), tuple(self._points(name))
        return Trend(name, kind.words, kind.unit, points, base, limits, self._ahead(name, limits), self._watched(name))

    def _watched(self, name: str) -> tuple[TrendPoint, ...]:
        known = ((day.ended_at, day.figures.get(name)) for day in reversed(self.watched))
        return tuple(TrendPoint(at, figure.value, figure.ci95) for at, figure in known if figure is not None)

    def _ahead(self, name: str, limits: tuple[float | None, float | None]) -> Ahead | None:
        """Return how a figure runs on by the newest test of the motion, unless its baseline is another one now."""
        run, held = self.judged, self.held_against
        health = None if run is None or run.analysis is None else run.analysis.get("health")
        if run is None or health is None or held is None or not self.same_motion:
            return None
        is_newest = self.same_motion[0].test_id == run.id
        if not is_newest or (health.get("baseline") or {}).get("test") != held.test.test_id:
            return None
        trend = next((one for one in health.get("trends") or () if one["name"] == name), None)
        forecast = next((one for one in all_forecasts(health) if one.name == name), None)
        if trend is None or forecast is None or trend.get("level") is None:
            return None
        limit = limits[1] if trend["per_day"] > 0.0 else limits[0]
        if limit is None:
            return None
        return Ahead(float(trend["level"]), limit, forecast.at, forecast.earliest, forecast.latest)

    def _limits(self, name: str, was: Figure | None) -> tuple[float | None, float | None]:
        if was is None or self.valve is None:
            return None, None
        up, down = allowed(name, was, self.valve.health, facts_of(self.valve))
        return None if down is None else was.value - down, None if up is None else was.value + up

    def _points(self, name: str) -> Iterator[TrendPoint]:
        for test in reversed(self.same_motion):
            if name in test.figures:
                figure = test.figures[name]
                yield TrendPoint(test.at, figure.value, figure.ci95, test.label or "")


def past_of(store: Store, tag: str, valve: PlantValve | None, run: Run | None = None) -> ValvePast:
    """Return a valve's past, with the baseline of ``run``'s motion, or of the newest completed test's.

    Reads the database, so callers on the event loop use a thread.
    """
    latest = store.runs.last_completed(tag)
    of_motion = run if run is not None else latest
    held: Baseline | None = None
    same: tuple[PastTest, ...] = ()
    if of_motion is not None:
        conditions = conditions_of(of_motion)
        held = store.figures.baseline(tag, conditions)
        same = tuple(store.figures.newest(tag, _TREND_TESTS, conditions=conditions))
    return ValvePast(
        tuple(store.runs.newest(_TREND_TESTS, valve=tag)),
        latest,
        None if held is None else store.runs.get(held.test.test_id),
        tuple(store.figures.newest(tag, _TREND_TESTS)),
        same,
        held,
        valve,
        of_motion,
        tuple(store.watched.newest(tag, _TREND_TESTS)),
    )


def history_row(run: Run, test: PastTest | None) -> dict[str, Any]:
    """Return a test as the valve's page lists it."""
    friction = None if test is None else test.figures.get("friction_mean_n") or test.figures.get("friction_coulomb_n")
    return {
        "id": run.id,
        "at": run.created_at,
        "label": "" if run.label is None else named(run.label.value),
        "sequence": named(run.sequence),
        "state": STATES[run.state],
        "is_bad": needs_acknowledgement(run),
        "friction_n": None if friction is None else friction.value,
        "friction_ci95": None if friction is None else friction.ci95,
        "diagnosis": diagnosis_words(test),
    }


def diagnosis_words(test: PastTest | None) -> str:
    """Return what a test found in a few words; a dash where that is nothing."""
    if test is None:
        return "–"
    if test.causes:
        cause = plain_cause(test.causes[0])
        return say("or_another", "{cause}, or another", cause=cause) if test.verdict == "ambiguous" else cause
    return _VERDICTS.get(test.verdict, "–")
