"""The night in which a limit is met and a step below it: how often they hold, what is never said, how pages say it."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from service.config.settings import load_plant
from service.health.assess import assess
from service.health.judge import health_of
from service.health.results import Case, Health
from service.health.trend import Crossing, Slope, lines_through, slope_of
from service.model.health_figures import figures_of
from service.model.past_test import Baseline, PastTest
from service.model.run import Run, RunState, new_run_id
from service.shown.forecast import Forecast, all_forecasts, forecasts_of
from service.store.store import Store
from tests.bench.benchmarks.trends import CHOSEN, METHODS, back_tested, drawn, has_stepped, is_forecast, is_up
from tests.service.health.analyses import FACTS, LIMITS, analysis
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from valve.recording import FloatArray

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
CHOSEN_ONLY = {CHOSEN: METHODS[CHOSEN]}


def judged(friction_n: Sequence[float], half_n: float = 1.0) -> Health:
    """The last of these nights judged; the first is the baseline."""
    found = [analysis(friction_n=one, half_n=half_n) for one in friction_n]
    nights = [NOW - timedelta(days=len(found) - 1 - night) for night in range(len(found))]
    tests = [PastTest(f"{at:%j}", at, figures_of(one), (), "none") for at, one in zip(nights, found, strict=True)]
    return assess(Case(found[-1], NOW, FACTS, LIMITS, Baseline(tests[0]), tuple(tests[:-1])))


def friction(health: Health) -> dict[str, Any]:
    return next(one for one in health.to_json()["trends"] if one["name"] == "friction_mean_n")


@pytest.mark.parametrize(("law", "least"), [("linear", 0.88), ("linear, from 40 % of the time on", 0.88)])
def test_the_interval_of_the_night_holds_as_often_as_it_says(law: str, least: float) -> None:
    found = back_tested(law, CHOSEN_ONLY, valves=20, first_seed=8)[CHOSEN]
    assert found.given > 500
    assert found.held / found.given >= least  # 95 % of many; the nights of one valve are wrong together
    assert np.median(found.errors) < 12.0
    assert np.median(found.widths) < 120.0  # an interval that says nothing would always hold


def test_an_interval_that_forgets_the_wander_would_not_hold() -> None:
    others = {name: METHODS[name] for name in ("Theil-Sen, ranks, 60 tests",)}
    (found,) = back_tested("linear", others, valves=20, first_seed=8).values()
    assert found.held / found.given < 0.7


@pytest.mark.parametrize(("forgotten", "most"), [(0.0, 1), (10.0, 6)])
def test_valves_that_only_wander_are_not_said_to_run_to_a_limit(forgotten: float, most: int) -> None:
    figures, half = drawn(np.ones(91), 100, forgotten, np.random.default_rng(17))
    alarms = 0
    for night in range(5, 91):
        past = figures[: night + 1]
        found = METHODS[CHOSEN](past, 1.25 * past[0])
        alarms += int(np.sum(is_forecast(found, past, half) | is_up(past, half)))
    assert alarms <= most  # of 8600 valve-nights


def test_a_rise_within_the_limit_is_no_reason_and_one_beyond_it_is_found_at_once() -> None:
    draw = random.Random(5)
    steady = [500.0 * (1.0 + draw.gauss(0.0, 0.01)) for _ in range(30)]
    for nights in range(1, 30):
        within = [550.0 * (1.0 + draw.gauss(0.0, 0.01)) for _ in range(nights)]
        assert judged([*steady, *within]).ne107 == "N"
    assert judged([*steady, 660.0]).ne107 == "M"


@pytest.mark.parametrize("forgotten", [0.0, 3.0, 10.0])
def test_a_rise_of_ten_percent_is_found_within_a_week_and_hardly_ever_where_there_is_none(forgotten: float) -> None:
    truth: FloatArray = np.where(np.arange(37) < 30, 1.0, 1.1)
    figures, _ = drawn(truth, 100, forgotten, np.random.default_rng(7))
    found = np.array([has_stepped(figures[: night + 1]) for night in range(30, 37)])
    assert np.mean(found.any(axis=0)) > 0.7
    steady, _ = drawn(np.ones(61), 60, forgotten, np.random.default_rng(8))
    alarms = sum(int(np.sum(has_stepped(steady[: night + 1]))) for night in range(7, 61))
    assert alarms <= 2  # of 3240 valve-nights, which a valve's own follow each other


def steps(health: Health) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = health.to_json()["steps"]
    return found


@pytest.mark.parametrize(("to_n", "words"), [(560.0, "higher than before"), (440.0, "lower than before")])
def test_a_step_within_the_limit_is_told_with_its_day_and_its_interval(to_n: float, words: str) -> None:
    draw = random.Random(4)
    nights = [(500.0 if night < 20 else to_n) * (1.0 + draw.gauss(0.0, 0.02)) for night in range(24)]
    health = judged(nights)
    (found,) = steps(health)
    assert (found["name"], found["tests"]) == ("friction_mean_n", 4)
    assert datetime.fromisoformat(found["since"]) == NOW - timedelta(days=3)
    assert found["ci95"][0] <= to_n - 500.0 <= found["ci95"][1]
    assert found["before"] == pytest.approx(500.0, abs=8.0)
    (told,) = [one for one in health.notes if words in one]
    assert "since 2026-11-18, over 4 tests, " in told
    assert "125 N" in told
    assert health.ne107 == "N"


def test_one_odd_night_is_no_step_and_one_beyond_the_limit_is_told_once() -> None:
    draw = random.Random(4)
    steady = [500.0 * (1.0 + draw.gauss(0.0, 0.01)) for _ in range(20)]
    assert steps(judged([*steady, 600.0])) == []
    assert steps(judged([*steady, 600.0, *steady[:3]])) == []
    beyond = judged([*steady, 700.0, 700.0])
    assert beyond.ne107 == "M"
    assert not any("higher than before" in note for note in beyond.notes)


def test_where_a_line_is_sure_the_trend_tells_and_not_a_step() -> None:
    draw = random.Random(6)
    health = judged([500.0 + 1.5 * night + draw.gauss(0.0, 3.0) for night in range(50)])
    assert friction(health)["ci95"][0] > 0.0
    assert not any("higher than before" in note for note in health.notes)


@pytest.mark.parametrize("seed", range(6))
def test_the_back_test_judges_as_health_does(seed: int) -> None:
    truth: FloatArray = 500.0 + 125.0 * np.arange(50.0) / 55.0
    figures, half = drawn(truth, 1, 3.0, np.random.default_rng(seed))
    said = []
    for night in (20, 35, 42, 46, 49):
        past: FloatArray = figures[: night + 1]
        # a test's half width is a share of its own value there
        health = judged([float(one) for one in past[:, 0]], half_n=float(half[0] * past[0, 0]))
        found = METHODS[CHOSEN](past, 1.25 * past[0])
        expected = bool(is_forecast(found, past, half)[0]) and not bool(is_up(past, half)[0])
        said.append(any("runs to its limit" in one.sentence for one in health.findings) == expected)
    assert all(said)


def test_the_line_is_found_through_odd_nights_and_a_wander() -> None:
    draw = np.random.default_rng(3)
    values = 500.0 + 1.5 * np.arange(60) + 2.0 * draw.standard_normal(60)
    values[[20, 41]] += (400.0, -300.0)
    found = lines_through(np.arange(-59.0, 1.0), np.column_stack((values, values[::-1])))
    half = found.quantile * np.sqrt(found.covariance[2])
    assert np.all(np.abs(found.per_day - (1.5, -1.5)) < half)
    assert np.all(half < 0.15)
    assert found.level == pytest.approx([588.5, 500.0], abs=4.0)


def test_the_interval_ends_where_the_band_of_the_line_meets_the_level() -> None:
    slope = Slope(1.0, (0.4, 1.6), 100.0, NOW, 20, (25.0, 0.8, 0.36))
    for level in (110.0, 130.0, 160.0):
        met = slope.reaches(level)
        assert met is not None
        assert met.earliest is not None
        assert met.latest is not None
        assert met.earliest < met.at < met.latest
        for at, way in ((met.earliest, 1.0), (met.latest, -1.0)):
            days = (at - NOW).total_seconds() / 86400.0
            border = 100.0 + days + way * np.sqrt(25.0 + 2.0 * 0.8 * days + 0.36 * days**2)
            assert border == pytest.approx(level)
    assert slope.reaches(102.0) == replace(_met(slope, 102.0), earliest=NOW)
    assert slope.reaches(90.0) == replace(_met(slope, 90.0), at=NOW, earliest=NOW)
    assert _met(slope, 1200.0).latest is None, "2,700 days"
    assert slope.reaches(4000.0) is None
    assert Slope(1.0, (-0.1, 2.1), 100.0, NOW, 20).reaches(110.0) is None


def _met(slope: Slope, level: float) -> Crossing:
    found = slope.reaches(level)
    assert found is not None
    return found


def test_figures_that_are_all_the_same_have_no_trend() -> None:
    slope = slope_of([NOW + timedelta(days=day) for day in range(30)], [500.0] * 30)
    assert slope is not None
    assert not slope.is_sure
    assert slope_of([NOW + timedelta(days=day) for day in range(5)], [500.0] * 5) is None
    zero = judged([0.0] * 9)
    assert friction(zero)["reaches_limit_at"] is None


def test_the_result_has_the_night_with_its_interval_from_half_of_the_limit_on() -> None:
    draw = random.Random(2)
    worn = [500.0, *(500.0 + 1.6 * day + draw.gauss(0.0, 5.0) for day in range(1, 60))]
    health = judged(worn)
    trend = friction(health)
    at, earliest, latest = (
        datetime.fromisoformat(trend[f"reaches_limit_{end}"]) for end in ("at", "earliest", "latest")
    )
    assert earliest < at < latest
    assert (at - NOW).days == pytest.approx(125.0 / 1.6 - 59.0, abs=4.0)
    assert trend["level"] == pytest.approx(594.4, abs=6.0)
    sentence = next(one.sentence for one in health.findings if "runs to its limit" in one.sentence)
    assert f"by the trend of 60 tests it gets there about {at:%Y-%m-%d}." in sentence
    early = friction(judged(worn[:30]))
    assert early["per_day"] > 1.0
    assert [early[f"reaches_limit_{end}"] for end in ("at", "earliest", "latest")] == [None] * 3


def forecast(days: float, earliest: float | None, latest: float | None, name: str = "friction_mean_n") -> Forecast:
    ends = (None if one is None else NOW + timedelta(days=one) for one in (earliest, latest))
    return Forecast(name, "Friction", NOW + timedelta(days=days), *ends)


@pytest.mark.parametrize(
    ("found", "words", "report"),
    [
        (forecast(22, 21, 34), "in about 3 weeks, 12 December to 25 December", "2026-12-13 (2026-12-12 to 2026-12-25)"),
        (
            forecast(25, 21, 48),
            "in about 4 weeks, 12 December to 8 January 2027",
            "2026-12-16 (2026-12-12 to 2027-01-08)",
        ),
        (forecast(9, 7, 12), "in about 9 days, 28 November to 3 December", "2026-11-30 (2026-11-28 to 2026-12-03)"),
        (forecast(1.1, 0.4, 2), "in about 1 day, 21 November to 23 November", "2026-11-22 (2026-11-21 to 2026-11-23)"),
        (forecast(100, 60, 170), "in about 3 months, January 2027 to May 2027", "2027-03 (2027-01 to 2027-05)"),
        (
            forecast(10, 0, 70),
            "in less than a month, 21 November to 30 January 2027",
            "2026-12-01 (2026-11-21 to 2027-01-30)",
        ),
        (forecast(200, 90, None), "in about 7 months, not before February 2027", "2027-06 (not before 2027-02)"),
        (forecast(200, None, None), "in about 7 months", "2027-06"),  # of an earlier version
        (forecast(-9, -12, -6), "now", "2026-11-12 (2026-11-09 to 2026-11-15)"),
        (forecast(-2, -9, 6), "now, 21 November to 27 November", "2026-11-19 (2026-11-12 to 2026-11-27)"),
    ],
)
def test_words_are_as_round_as_the_interval_is_wide(found: Forecast, words: str, report: str) -> None:
    assert found.sentence(NOW, UTC) == f"Friction meets its limit {words}."
    assert found.dates(UTC) == f"about {report}"


def test_days_are_by_the_plants_clock() -> None:
    late = Forecast("travel_m", "Travel", *(datetime(2026, 12, day, 20, 0, tzinfo=UTC) for day in (16, 12, 18)))
    assert late.span(NOW, ZoneInfo("Asia/Tokyo")) == "13 December to 19 December"
    assert late.span(NOW, ZoneInfo("America/Lima")) == "12 December to 18 December"
    assert late.dates(ZoneInfo("Asia/Tokyo")) == "about 2026-12-17 (2026-12-13 to 2026-12-19)"


def test_one_friction_is_told_and_none_that_is_beyond_its_limit_or_a_year_away() -> None:
    def trend(name: str, days: float) -> dict[str, Any]:
        return {"name": name, "reaches_limit_at": (NOW + timedelta(days=days)).isoformat()}  # of an earlier version

    both = [
        trend("friction_mean_n", 40),
        trend("friction_coulomb_n", 50),
        trend("travel_m", 30),
        trend("bench_low_pa", 400),
    ]
    found = forecasts_of({"trends": both}, NOW)
    assert [(one.name, one.limit_words) for one in found] == [
        ("travel_m", "travel: limit"),
        ("friction_mean_n", "limit"),
    ]
    assert len(all_forecasts({"trends": both})) == 3
    beyond = [{"name": "friction_mean_n", "kept": False}, {"name": "travel_m", "kept": True}]
    assert [one.name for one in forecasts_of({"trends": both, "changes": beyond}, NOW)] == ["travel_m"]
    assert forecasts_of(None, NOW) == forecasts_of({}, NOW) == []


async def test_list_page_report_and_interface_tell_the_forecast(plant_text: str, quick_path: Path) -> None:
    file = quick_path / "plant.toml"
    file.write_text(plant_text.replace("[service]", '[service]\nzone = "Asia/Tokyo"', 1), encoding="utf-8")
    plant = load_plant(file)
    draw, now = random.Random(2), datetime.now(UTC)
    store = Store(plant.service.store)
    for night in range(40):
        at = now - timedelta(days=39 - night)
        found = analysis(friction_n=500.0 + 2.2 * night + draw.gauss(0.0, 5.0))
        run = Run(id=new_run_id(at), valve="FV-101", sequence="triangle", state=RunState.COMPLETED, created_at=at)
        found["health"] = health_of(store.figures, plant.valves["FV-101"], run, found)
        store.runs.insert(replace(run, started_at=at, finished_at=at, quality={}, safe_confirmed=True, analysis=found))
    store.close()
    (told,) = [one for one in all_forecasts(found["health"]) if one.name == "friction_mean_n"]
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        listed = (await client.get("/")).text
        assert f'<span class="aside forecast">limit {told.soon(now)}</span>' in listed
        page = (await client.get("/ui/valves/FV-101")).text
        assert told.sentence(now, ZoneInfo("Asia/Tokyo")) in page
        picture = (await client.get("/ui/figures/valves/FV-101/trend.svg")).text
        assert "Dotted: the trend on to its limit" in picture
        report = (await client.get(f"/tests/{run.id}/report?format=html")).text
        assert f"a month, at its limit {told.dates(ZoneInfo('Asia/Tokyo'))}" in report
        trends = (await client.get("/valves")).json()["valves"][0]["health"]["trends"]
        assert trends[0]["reaches_limit_earliest"] < trends[0]["reaches_limit_at"] < trends[0]["reaches_limit_latest"]
        schemas = (await client.get("/openapi.json")).json()["components"]["schemas"]
        entry = schemas["ValveSummary"]["properties"]["health"]["properties"]["trends"]["items"]["properties"]
        assert set(trends[0]) <= set(entry)


async def test_page_report_and_interface_tell_the_step(plant_text: str, quick_path: Path) -> None:
    file = quick_path / "plant.toml"
    file.write_text(plant_text, encoding="utf-8")
    plant = load_plant(file)
    draw, now = random.Random(2), datetime.now(UTC)
    store = Store(plant.service.store)
    for night in range(24):
        at = now - timedelta(days=23 - night)
        found = analysis(friction_n=(500.0 if night < 20 else 560.0) + draw.gauss(0.0, 8.0))
        run = Run(id=new_run_id(at), valve="FV-101", sequence="triangle", state=RunState.COMPLETED, created_at=at)
        found["health"] = health_of(store.figures, plant.valves["FV-101"], run, found)
        store.runs.insert(replace(run, started_at=at, finished_at=at, quality={}, safe_confirmed=True, analysis=found))
    store.close()
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        assert "Friction, mean: since " in (await client.get("/ui/valves/FV-101")).text
        report = (await client.get(f"/tests/{run.id}/report?format=html")).text
        assert f"N higher since {now - timedelta(days=3):%Y-%m-%d}" in report
        (step,) = (await client.get("/valves")).json()["valves"][0]["health"]["steps"]
        schemas = (await client.get("/openapi.json")).json()["components"]["schemas"]
        entry = schemas["ValveSummary"]["properties"]["health"]["properties"]["steps"]["items"]["properties"]
        assert set(step) == set(entry)
