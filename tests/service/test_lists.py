"""Lists: what they leave out when they are asked to, keys that nobody knows, CSV, names of files."""

from __future__ import annotations

import csv
import io
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from service.access.principal import Role
from service.config.plant import DatabaseAddress, Identity, Plant, PlantValve
from service.config.settings import load_plant
from service.model.run import Label, Run, RunState, new_run_id
from service.store.store import open_store
from tests.service.access.signed_in import body_of, signed_in
from tests.service.conftest import PLANT
from tests.service.health.analyses import analysis
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.plants import valve_text
from tests.support.problem import assert_problem
from tests.support.running_service import running_service

NOW = datetime.now(UTC).replace(microsecond=0)
SLASHED = "FV-103 A/B"


@pytest.fixture
def used(quick_path: Path, database_url: str) -> Plant:
    """Return a plant of three valves whose store has tests of two: FV-101 four, FV-102 one that failed."""
    path = quick_path / "plant.toml"
    path.write_text(PLANT + valve_text(SLASHED, "plc-1", 3), encoding="utf-8")
    plant = load_plant(path)
    if database_url.startswith("postgresql"):
        plant = replace(plant, service=replace(plant.service, database=DatabaseAddress(database_url)))
    with closing(open_store(plant.service)) as store:
        for days, valve, ne107, label, friction_n in (
            (40, "FV-101", "N", None, 500.0),
            (20, "FV-101", "M", Label.AS_FOUND, 700.0),
            (10, "FV-101", "N", Label.AS_LEFT, 510.0),
            (5, "FV-102", None, None, None),
            (1, "FV-101", "N", None, 505.0),
        ):
            at = NOW - timedelta(days=days)
            run = Run(id=new_run_id(at), valve=valve, sequence="triangle", created_at=at, label=label)
            run = store.runs.insert(run)
            if ne107 is None:
                store.runs.save(replace(run, state=RunState.FAILED, error='no answer, "at all"'))
                continue
            found = analysis(friction_n=friction_n, travel_m=0.09, dead_band_percent=7.5)
            found["health"] = {"ne107": ne107, "reasons": []}
            store.runs.save(replace(run, state=RunState.COMPLETED, finished_at=at, analysis=found))
    return plant


@asynccontextmanager
async def served(plant: Plant) -> AsyncIterator[httpx.AsyncClient]:
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        yield client


def at(days: float) -> str:
    return (NOW - timedelta(days=days)).strftime("%Y-%m-%dT%H:%M:%SZ")


async def test_tests_are_listed_by_what_is_asked_for(used: Plant) -> None:
    async with served(used) as client:

        async def days(query: str) -> list[int]:
            listed = body_of(await client.get(f"/tests?{query}"))["tests"]
            return [(NOW - datetime.fromisoformat(one["created_at"])).days for one in listed]

        assert await days("") == [1, 5, 10, 20, 40]
        assert await days("state=failed") == [5]
        assert await days("state=failed&state=completed&valve=FV-101") == [1, 10, 20, 40]
        assert await days("ne107=M") == [20]
        assert await days("ne107=M&ne107=N&label=as_left") == [10]
        assert await days("label=as_found&label=as_left") == [10, 20]
        assert await days(f"since={at(20)}&until={at(5)}") == [10, 20], "the first instant is in, the last is not"
        naive = (NOW - timedelta(days=5)).strftime("%Y-%m-%dT%H:%M:%S")
        assert await days(f"since={naive}") == [1, 5], "an instant without a zone is in UTC"
        assert await days("ne107=F") == []


async def test_the_next_page_asks_for_the_same(used: Plant) -> None:
    async with served(used) as client:
        found, address = [], f"/tests?valve=FV-101&state=completed&state=failed&ne107=N&since={at(50)}&limit=1"
        while address:
            page = body_of(await client.get(address))
            found += [one["id"] for one in page["tests"]]
            address = page["next"]
        assert [one[:8] for one in found] == [f"{NOW - timedelta(days=days):%Y%m%d}" for days in (1, 10, 40)]
        first = body_of(await client.get(f"/valves?limit=1&state=completed&state=failed&until={at(0)}"))
        assert [one["tag"] for one in first["valves"]] == ["FV-101"]
        second = body_of(await client.get(first["next"]))
        assert ([one["tag"] for one in second["valves"]], second["next"]) == (["FV-102"], None)


async def test_valves_are_listed_by_their_last_test(used: Plant) -> None:
    async with served(used) as client:

        async def tags(query: str) -> list[str]:
            return [one["tag"] for one in body_of(await client.get(f"/valves?{query}"))["valves"]]

        assert await tags("") == ["FV-101", "FV-102", SLASHED]
        assert await tags("state=failed") == ["FV-102"]
        assert await tags("ne107=N") == ["FV-101"]
        assert await tags("ne107=M") == [], "the state as it stands today, not one that it had"
        assert await tags(f"since={at(2)}") == ["FV-101"]
        assert await tags(f"until={at(2)}") == ["FV-102"]
        assert await tags("label=as_left") == [], "its last test has no label"


async def test_valves_and_tests_are_listed_by_area(used: Plant) -> None:
    def placed(tag: str, area: str | None) -> PlantValve:
        return replace(used.valves[tag], identity=Identity(area=area))

    areas = {"FV-101": "Unit 1", "FV-102": "Tank farm", SLASHED: "Unit 1"}
    plant = replace(used, valves={tag: placed(tag, area) for tag, area in areas.items()})
    async with served(plant) as client:

        async def tags(query: str) -> list[str]:
            return [one["tag"] for one in body_of(await client.get(f"/valves?{query}"))["valves"]]

        assert await tags("area=Unit%201") == ["FV-101", SLASHED], "one that was never tested is of its area, too"
        assert await tags("area=Unit%201&area=Tank%20farm&state=failed") == ["FV-102"]
        first = body_of(await client.get("/valves?area=Unit%201&limit=1"))
        assert [one["tag"] for one in body_of(await client.get(first["next"]))["valves"]] == [SLASHED]

        listed = body_of(await client.get("/tests?area=Tank%20farm"))["tests"]
        assert [one["valve"] for one in listed] == ["FV-102"]
        page = body_of(await client.get("/tests?area=Unit%201&limit=3"))
        rest = body_of(await client.get(page["next"]))
        assert [len(one["tests"]) for one in (page, rest)] == [3, 1]
        for path in ("valves", "tests"):
            assert_problem(await client.get(f"/{path}?area=Unit%209"), 422, "known here are Tank farm, Unit 1")


async def test_a_result_that_is_too_old_is_listed_as_it_stands_today(used: Plant) -> None:
    with closing(open_store(used.service)) as store:
        (last,) = store.runs.newest(1, valve="FV-101")
        old = NOW - timedelta(days=90)
        store.runs.save(replace(store.runs.get(last.id), created_at=old, label=Label.AS_LEFT))
    async with served(used) as client:
        for query, tags in (("ne107=N", []), ("ne107=C", ["FV-101"]), ("label=as_left", ["FV-101"])):
            assert [one["tag"] for one in body_of(await client.get(f"/valves?{query}"))["valves"]] == tags


@pytest.mark.parametrize(
    ("address", "parts"),
    [
        ("/tests?stat=failed", ("query.stat", "did you mean state?", "known here are limit, before, valve, area")),
        (
            "/valves?zzz=1&yyy=2",
            ("query.zzz", "query.yyy", "limit, after, area, state, ne107, label, since, until, format"),
        ),
        ("/valves/FV-101/trend?days=3", ("query.days", "known here are limit, format")),
        ("/valves/FV-101/comparison?found=x", ("query.found", "as_found, as_left")),
        ("/schedules?x=1", ("query.x", "none is known here")),
        ("/schedules/night?x=1", ("query.x", "known here are format")),
        ("/tests?state=done", ("query.state", "completed")),
        ("/tests?ne107=X", ("query.ne107",)),
        ("/tests?since=yesterday", ("query.since", "datetime")),
        ("/valves?since=0001-01-01T00:00:00%2B14:00", ("query.since", "no such instant")),
        ("/tests?format=xml", ("query.format", "csv")),
    ],
)
async def test_a_key_or_value_that_is_unknown_is_refused(
    client: httpx.AsyncClient, address: str, parts: tuple[str, ...]
) -> None:
    assert_problem(await client.get(address), 422, *parts)


async def test_users_and_tokens_take_no_unknown_key_and_say_nothing_to_who_may_not_see_them(quick_path: Path) -> None:
    async with signed_in(quick_path, "admin") as served:
        for path in ("/users", "/tokens"):
            assert_problem(await served.client.get(f"{path}?x=1", headers=served.tokens[Role.ADMIN]), 422, "query.x")
            assert_problem(await served.client.get(f"{path}?x=1", headers=served.tokens[Role.VIEWER]), 403)
        assert_problem(await served.client.get("/tests?x=1"), 401)


def rows_of(answer: httpx.Response) -> list[dict[str, str]]:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert answer.headers["vary"] == "Accept"
    return list(csv.DictReader(io.StringIO(answer.text)))


async def test_lists_and_trends_come_as_csv_with_their_figures(used: Plant) -> None:
    as_csv = {"Accept": "text/csv"}
    async with served(used) as client:
        answer = await client.get("/tests?limit=2", headers=as_csv)
        newest, failed = rows_of(answer)
        assert (newest["valve"], newest["state"], newest["ne107"]) == ("FV-101", "completed", "N")
        assert (newest["friction_mean_n"], newest["dead_band_percent"], newest["travel_m"]) == ("505.0", "7.5", "0.09")
        assert datetime.fromisoformat(newest["created_at"]) == NOW - timedelta(days=1)
        assert (failed["error"], failed["friction_mean_n"], failed["ne107"]) == ('no answer, "at all"', "", "")
        older = rows_of(await client.get(answer.links["next"]["url"], headers=as_csv))
        assert [row["label"] for row in older] == ["as_left", "as_found"]
        assert f'filename="tests_{datetime.now(UTC):%Y-%m-%d}.csv"' in answer.headers["content-disposition"]

        valves = rows_of(await client.get("/valves?format=csv"))
        assert [row["valve"] for row in valves] == ["FV-101", "FV-102", SLASHED]
        assert [row["friction_mean_n"] for row in valves] == ["505.0", "", ""]
        assert [row["state"] for row in valves] == ["completed", "failed", ""]

        trend = await client.get("/valves/FV-101/trend", headers=as_csv)
        assert [row["friction_mean_n"] for row in rows_of(trend)] == ["500.0", "700.0", "510.0", "505.0"]
        first = rows_of(trend)[0]
        assert [float(first[f"friction_mean_n{end}"]) for end in ("_low", "_high")] == [499.0, 501.0]
        assert 'filename="FV-101_trend_20' in trend.headers["content-disposition"]
        assert rows_of(await client.get("/schedules/night", headers=as_csv)) == []


@pytest.mark.parametrize(
    ("accept", "form", "kind"),
    [
        ("*/*", "", "application/json"),
        ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", "", "application/json"),
        ("application/json, text/csv;q=0.5", "", "application/json"),
        ("text/csv, */*;q=0.1", "", "text/csv"),
        ("text/csv", "json", "application/json"),
    ],
)
async def test_who_does_not_prefer_csv_gets_json(client: httpx.AsyncClient, accept: str, form: str, kind: str) -> None:
    for path in ("/tests", "/valves", "/schedules/night", "/valves/FV-101/trend"):
        answer = await client.get(path, headers={"Accept": accept}, params={"format": form} if form else {})
        assert answer.headers["content-type"].startswith(kind), answer.text


async def test_what_is_downloaded_is_named_by_tag_and_time(used: Plant) -> None:
    async with served(used) as client:
        body = {"valve": SLASHED, "sequence": "triangle"}
        test = body_of(await client.post("/tests/run", json=body, headers={"Prefer": "wait=30"}))
        name = f"FV-103-A-B_{datetime.fromisoformat(test['created_at']):%Y-%m-%d_%H%M%S}Z"
        for path, accept, ending in (
            ("recording", "text/csv", "csv"),
            ("recording", "application/vnd.apache.parquet", "parquet"),
            ("report", "application/pdf", "pdf"),
        ):
            answer = await client.get(f"/tests/{test['id']}/{path}", headers={"Accept": accept})
            assert f'filename="{name}.{ending}"' in answer.headers["content-disposition"], answer.headers
