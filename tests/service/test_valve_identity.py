"""What people know a valve by beside its tag: where it is written and where it is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from service.config.plant import Identity
from service.config.settings import faults_of, load_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service

SAID = {
    "description": "Feed to the <stripper>",
    "area": "Unit 1",
    "service": "Condensate, 120 °C",
    "manufacturer": "Acme",
    "model": "V-500",
    "serial_number": "00123/A",
}


@pytest.fixture
def named_file(plant_file: Path, plant_text: str) -> Path:
    keys = "".join(f'{name} = "{value}"\n' for name, value in SAID.items())
    plant_file.write_text(plant_text.replace('tag = "FV-101"\n', f'tag = "FV-101"\n{keys}', 1), encoding="utf-8")
    return plant_file


def test_a_plant_file_says_what_people_know_a_valve_by(named_file: Path) -> None:
    plant = load_plant(named_file)
    assert plant.valves["FV-101"].identity == Identity(**SAID)
    assert plant.valves["FV-102"].identity == Identity()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"Unit 1"', "1", ["valves[0].area = 1", "put it in quotes"]),
        ('"Unit 1"', '""', ["valves[0].area", "say something or remove it"]),
        ('"Unit 1"', f'"{"x" * 201}"', ["valves[0].area", "200 characters", "shorten it"]),
        ('"Unit 1"', '"Unit\\n1"', ["valves[0].area", "cannot be shown", "one line"]),
        ("serial_number", "serial_no", ["valves[0].serial_no", "unknown", "write serial_number"]),
    ],
)
def test_a_text_that_cannot_be_shown_is_refused(named_file: Path, old: str, new: str, says: list[str]) -> None:
    text = named_file.read_text(encoding="utf-8")
    assert old in text
    named_file.write_text(text.replace(old, new, 1), encoding="utf-8")
    _, faults = faults_of(named_file)
    assert len(faults) == 1
    for part in says:
        assert part in str(faults[0])


async def test_it_stands_in_the_answer_on_the_page_and_in_the_report(
    named_file: Path, rig: FakeRig, analyst: FakeAnalyst
) -> None:
    async with running_service(load_plant(named_file), rig, analyst) as client:
        one = (await client.get("/valves/FV-101")).json()
        assert {name: one[name] for name in SAID} == SAID
        other = (await client.get("/valves/FV-102")).json()
        assert {other[name] for name in SAID} == {None}
        first, second = (await client.get("/valves")).json()["valves"]
        assert (first["description"], first["area"]) == (SAID["description"], "Unit 1")
        assert (second["description"], second["area"]) == (None, None)

        run = await client.post("/tests/run", json={"valve": "FV-101"}, headers={"Prefer": "wait=20"})
        report = await client.get(f"/tests/{run.json()['id']}/report", headers={"Accept": "text/html"})
        page = await client.get("/ui/valves/FV-101")
        for shown in (report.text, page.text):
            assert "Feed to the &lt;stripper&gt;" in shown
            assert "<stripper>" not in shown
            for name, value in (("Area", "Unit 1"), ("Service", "Condensate, 120 °C"), ("Manufacturer", "Acme")):
                assert name in shown
                assert value in shown
            assert "V-500" in shown
            assert "00123/A" in shown
        plain = (await client.get("/ui/valves/FV-102")).text
        assert "Serial number" not in plain
        assert 'id="description"' not in plain
