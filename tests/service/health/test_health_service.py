"""Health through the service: baselines, figures, trends, as found and as left."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from html import unescape
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.health_limits import HealthLimits
from tests.service.health.analyses import SPOT, analysis, named
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.errors import ConfigurationError

RUN = {"valve": "FV-101", "sequence": "triangle"}


class Found(FakeAnalyst):
    """Finds what the test says."""

    def __init__(self) -> None:
        super().__init__()
        self.result: dict[str, Any] = analysis()

    async def analyze(self, *args: Any, **others: Any) -> dict[str, Any]:
        await super().analyze(*args, **others)
        return dict(self.result)


@pytest.fixture
def plant(plant_file: Path) -> Plant:
    return load_plant(plant_file)


@pytest.fixture
def analyst() -> Found:
    return Found()


@pytest.fixture
async def client(plant: Plant, analyst: Found) -> AsyncIterator[httpx.AsyncClient]:
    async with running_service(plant, FakeRig(), analyst) as client:
        yield client


async def health(client: httpx.AsyncClient, **wanted: Any) -> tuple[str, dict[str, Any]]:
    answer = await client.post("/tests/run", json={**RUN, **wanted}, headers={"Prefer": "wait=10"})
    assert answer.status_code == 200, answer.text
    body = answer.json()
    assert body["state"] == "completed", body["error"]
    return body["id"], body["analysis"]["health"]


async def test_the_first_good_test_becomes_the_baseline_and_later_ones_are_held_against_it(
    client: httpx.AsyncClient, analyst: Found
) -> None:
    assert_problem(await client.get("/valves/FV-101/baseline"), 404, "no baseline yet")
    analyst.result = analysis(friction_n=None)
    analyst.result["signature"]["spring_rate_n_per_m"] = None
    assert (await health(client))[1]["ne107"] == "C"
    assert (await client.get("/valves/FV-101/baseline")).status_code == 404
    analyst.result = analysis()
    first, found = await health(client)
    assert (found["ne107"], found["baseline"]) == ("N", None)
    baseline = (await client.get("/valves/FV-101/baseline")).json()
    assert (baseline["test"], baseline["set_by"]) == (first, None)
    assert baseline["figures"]["friction_mean_n"] == {"value": 500.0, "ci95": [499.0, 501.0]}
    analyst.result = analysis(friction_n=700.0)
    _, found = await health(client)
    assert (found["ne107"], found["baseline"]["test"]) == ("M", first)
    listed = (await client.get("/valves")).json()["valves"][0]
    assert listed["health"]["ne107"] == "M"
    assert "Friction, mean: 700 N is 200.0 ± 1.4 N" in listed["health"]["reasons"][0]
    trend = (await client.get("/valves/FV-101")).json()["trend"]
    assert [point["value"] for point in trend[0]["points"]] == [500.0, 700.0]


async def test_the_trend_is_drawn_by_the_plants_clock_and_anew_when_the_zone_changes(
    client: httpx.AsyncClient, plant: Plant
) -> None:
    await health(client)
    newest, _ = await health(client)
    text, addresses = plant.file.read_text(encoding="utf-8"), []
    for zone in ("Asia/Kolkata", "America/Lima"):
        plant.file.write_text(text.replace("[service]", f'[service]\nzone = "{zone}"', 1), encoding="utf-8")
        assert (await client.post("/plant/reload")).status_code == 200
        found = re.search(r'src="([^"]+/trend\.svg[^"]+)"', (await client.get("/ui/valves/FV-101")).text)
        assert found is not None
        addresses.append(unescape(found[1]))
        for address in addresses:  # the service draws anew even for a page that still shows the old address
            assert f"Time: {zone}." in (await client.get(address)).text
        assert f"Time: {zone}." in (await client.get(f"/tests/{newest}/report?format=html")).text
    assert addresses[0] != addresses[1]


async def test_a_chosen_baseline_takes_the_place_of_the_old_one_and_is_audited(
    client: httpx.AsyncClient, analyst: Found, plant: Plant
) -> None:
    await health(client)
    analyst.result = named(friction_n=700.0)
    second, found = await health(client)
    assert found["ne107"] == "M"
    chosen = (await client.post("/valves/FV-101/baseline", json={"test": second})).json()
    assert (chosen["test"], chosen["set_by"]) == (second, "local")
    _, found = await health(client)
    assert found["ne107"] == "N", found["reasons"]
    audit = "".join(path.read_text() for path in (plant.service.store / "audit").glob("*.audit"))
    assert "baseline.set" in audit
    answer = await client.post("/valves/FV-102/baseline", json={"test": second})
    assert_problem(answer, 422, "one of FV-101, not of FV-102")


async def test_a_test_that_does_not_pass_becomes_the_baseline_only_where_a_person_accepts_it(
    client: httpx.AsyncClient, analyst: Found
) -> None:
    analyst.result = analysis(friction_n=700.0, dead_band_percent=58.8)
    first, found = await health(client, label="as_left")
    assert (found["ne107"], found["acceptance"]["passed"]) == ("M", False)
    assert_problem(await client.get("/valves/FV-101/baseline"), 404, "the first test that passes acceptance")
    page = (await client.get(f"/ui/tests/{first}")).text
    assert "This test does not become the baseline by itself" in page
    assert "Accept this test as the baseline" in page
    await client.post("/valves/FV-101/baseline", json={"test": first})
    assert "Accept this test as the baseline" not in (await client.get(f"/ui/tests/{first}")).text
    _, found = await health(client)
    assert found["ne107"] == "N"
    assert "Known since local chose the baseline: dead band." in found["reasons"]
    assert found["baseline"]["test"] == first


async def test_a_small_cause_is_a_remark_on_the_page_and_no_fault(client: httpx.AsyncClient, analyst: Found) -> None:
    analyst.result = named()
    analyst.result["discrepancy"]["causes"] = [SPOT | {"effect_percent_of_span": 0.075}]
    test, found = await health(client)
    assert (found["ne107"], found["remarks"]) == ("N", ["local_friction"])
    page = (await client.get(f"/ui/tests/{test}")).text
    assert '<h2 id="h-diagnosis">No fault found.</h2>' in page
    assert "<strong>Seen, does not matter yet:</strong> Friction is 260 N higher" in page
    assert "Look at stem and packing there" not in page
    assert (await client.get("/valves/FV-101/baseline")).json()["test"] == test


async def test_another_motion_has_its_own_baseline(client: httpx.AsyncClient, analyst: Found) -> None:
    first, _ = await health(client)
    analyst.result = analysis(friction_n=750.0)
    other, found = await health(client, overrides={"period_s": 10})
    assert (found["ne107"], found["baseline"]) == ("N", None)
    _, found = await health(client, overrides={"period_s": 10})
    assert found["baseline"]["test"] == other
    analyst.result = analysis()
    assert (await health(client))[1]["baseline"]["test"] == first
    await client.post("/valves/FV-101/baseline", json={"test": first})
    _, found = await health(client, overrides={"period_s": 10})
    assert found["baseline"] is None, "the other motion's baseline is of the time before the chosen one"


async def test_what_a_repair_changed_is_told_with_its_interval_and_becomes_the_baseline(
    client: httpx.AsyncClient, analyst: Found
) -> None:
    assert_problem(await client.get("/valves/FV-101/comparison"), 404, "no completed test is labelled as left")
    analyst.result = named(friction_n=800.0)
    before, _ = await health(client, label="as_found")
    analyst.result = analysis(friction_n=450.0)
    after, _ = await health(client, label="as_left")
    found = (await client.get("/valves/FV-101/comparison")).json()
    assert (found["as_found"], found["as_left"]) == (before, after)
    friction = found["changes"][0]
    assert (friction["change"], friction["sure"]) == (-350.0, True)
    assert friction["ci95"] == pytest.approx([-350.0 - 2.0**0.5, -350.0 + 2.0**0.5])
    assert found["sentences"] == ["Friction, mean fell by 350.0 ± 1.4 N, 43.8 %.", "No longer found: local friction."]
    page = (await client.get(f"/ui/tests/{after}?units=psi")).text
    assert "<li>Friction, mean fell by 78.68 ± 0.32 lbf, 43.8 %.</li><li>No longer found: local friction.</li>" in page
    assert "As found, as left" not in (await client.get(f"/ui/tests/{before}")).text
    assert (await client.get("/valves/FV-101/baseline")).json()["test"] == after
    turned = await client.get("/valves/FV-101/comparison", params={"as_found": after, "as_left": before})
    assert turned.json()["changes"][0]["change"] == 350.0
    answer = await client.get("/valves/FV-102/comparison", params={"as_found": before, "as_left": after})
    assert_problem(answer, 404, "no completed one of it")


async def test_a_change_too_small_to_matter_is_told_without_a_long_number(
    client: httpx.AsyncClient, analyst: Found
) -> None:
    analyst.result = analysis(friction_n=800_000.0)
    await health(client, label="as_found")
    analyst.result = analysis(friction_n=800_003.0)
    await health(client, label="as_left")
    (said,) = (await client.get("/valves/FV-101/comparison")).json()["sentences"]
    assert said == "Friction, mean rose by 3.0 ± 1.4 N, less than 0.1 %."


def test_a_wrong_limit_is_refused_with_its_key(plant_text: str, quick_path: Path) -> None:
    path = quick_path / "plant.toml"
    section = "[valves.health]\nfriction_up_percent = -5.0\n[valves.limits]"
    path.write_text(plant_text.replace("[valves.limits]", section, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"valves\[0\].health: health.friction_up_percent is -5"):
        load_plant(path)
    path.write_text(plant_text.replace("[valves.limits]", section.replace("-5.0", "40.0"), 1), encoding="utf-8")
    plant = load_plant(path)
    assert plant.valves["FV-101"].health.friction_up_percent == 40.0
    assert plant.valves["FV-102"].health == HealthLimits()
