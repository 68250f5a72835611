"""The night's page of a large plant: the first load stays small, and every check is found."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from service.config.plant import Plant
from service.config.settings import load_plant
from service.model.check import Check, CheckState
from service.model.run import Run, RunState, new_run_id
from service.store.store import Store
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.made_analysis import made_analysis
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.running_service import running_service

VALVES = 500
MOST_BYTES = 100_000
NOW = datetime.now(UTC)


def plant_of(folder: Path) -> Plant:
    """Return a plant of 500 valves that are all due in 10 hours."""
    due = NOW + timedelta(hours=10)
    tags = [f"XV-{number}" for number in range(VALVES)]
    text = service_text("") + "".join(bus_text(f"bus-{number}", 5020 + number) for number in range(5))
    for number, tag in enumerate(tags):
        text += valve_text(tag, f"bus-{number // 100}", 1 + number % 100, signal=False)
    text += (
        f'[[schedules]]\nname = "nightly"\ncron = "{due.minute} {due.hour} * * *"\nzone = "UTC"\n'
        f'sequence = "triangle"\nwindow_s = 80000.0\nvalves = [{", ".join(f"{tag!r}" for tag in tags)}]\n'
    )
    (folder / "plant.toml").write_text(text, encoding="utf-8")
    return load_plant(folder / "plant.toml")


def fill(plant: Plant) -> None:
    """Store a night: one valve needs maintenance, 20 were skipped, the others are normal."""
    store, at = Store(plant.service.store), NOW - timedelta(hours=6)
    for number, tag in enumerate(plant.valves):
        check = store.schedule_runs.insert(Check("nightly", f"{at:%Y-%m-%dT%H:%M}", tag, at, 3600.0, "triangle", "bus"))
        assert check is not None
        if number % 25 == 0:
            store.schedule_runs.end(check.id, CheckState.SKIPPED, f"{tag}: its line is under pressure", at)
            continue
        run = Run(id=new_run_id(at), valve=tag, sequence="triangle", state=RunState.COMPLETED, created_at=at)
        analysis = {"health": made_analysis(ne107="M" if tag == "XV-333" else "N")["health"]}
        store.runs.insert(replace(run, started_at=at, finished_at=at, analysis=analysis))
        store.schedule_runs.take_up(check.id, "once", at)
        store.schedule_runs.note_test(check.id, run.id)
        store.schedule_runs.end(check.id, CheckState.COMPLETED, "", at)
    store.close()


def rows(text: str, table: str) -> list[str]:
    """Return the valves of a table in their order."""
    found = re.search(rf'<table class="list" id="{table}">.*?</table>', text, re.DOTALL)
    return [] if found is None else re.findall(r'href="/ui/valves/([^"]+)"', found[0])


async def test_a_night_of_500_valves_loads_small_and_every_check_is_reached(quick_path: Path) -> None:
    plant = plant_of(quick_path)
    fill(plant)
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        answer = await client.get("/ui/night")
        assert len(answer.content) < MOST_BYTES
        first = rows(answer.text, "last")
        assert (len(first), first[20]) == (50, "XV-333"), "no result first, then the worst"
        assert (len(rows(answer.text, "night")), "500 of 500 checks, 50 on this page" in answer.text) == (50, True)
        every: list[str] = []
        for number in range(1, 11):
            text = (await client.get("/ui/night", params={"page": number, "coming": number})).text
            every += rows(text, "last")
            assert len(rows(text, "night")) == 50
        assert sorted(every) == sorted(plant.valves)
        chips = dict(re.findall(r'<li><a href="(/ui/night\?[^"]+)"[^>]*><span><strong>(\d+)</strong>', answer.text))
        assert sorted(map(int, chips.values())) == [1, 20, 479]
        worst = next(address for address, count in chips.items() if count == "1")
        chosen = (await client.get(worst)).text
        assert rows(chosen, "last") == ["XV-333"]
        assert "479" in chosen, "the other choices stay"
        named = (await client.get("/ui/night", params={"find": "xv-33"})).text
        assert set(rows(named, "last")) == set(rows(named, "night")) == {"XV-33", *(f"XV-33{n}" for n in range(10))}
        assert rows((await client.get("/ui/night", params={"page": 9999})).text, "last"), "the last page there is"
