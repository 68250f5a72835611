"""Several uploaded recordings of one valve, and held-out ones, reach the analysis; nothing is kept."""

from __future__ import annotations

from pathlib import Path

from service.config.settings import load_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service

CSV = "time_s,command_pa,position_m\n0,0,0\n0.1,1000,0.0001\n0.2,2000,0.0002\n"
NAMEPLATE = 'tag = "X"\n[actuator]\ndiaphragm_area_m2 = 0.06452\ntravel_m = 0.1016\n'


async def test_several_recordings_and_held_out_ones_are_analysed_together(plant_file: Path) -> None:
    plant, analyst = load_plant(plant_file), FakeAnalyst()
    async with running_service(plant, FakeRig(), analyst) as client:
        names = (("recording", "a.csv"), ("recording", "b.csv"), ("held_out", "sine.csv"))
        files = [(part, (name, CSV)) for part, name in names]
        answer = await client.post("/recordings/analyze", files=files, data={"nameplate": NAMEPLATE})
        assert answer.status_code == 200, answer.text
        together, held_out, *_ = analyst.asked[0]
        assert len(together) == 1
        assert [name for name, _ in held_out] == ["sine.csv"]
        assert analyst.uploads == 1  # behind the tests of this plant
        text = [("held_out", (None, "no file")), ("recording", ("a.csv", CSV))]
        answer = await client.post("/recordings/analyze", files=text, data={"nameplate": NAMEPLATE})
        assert_problem(answer, 422, "part held_out is missing or no file")
    left = files_in(plant.service.store / "uploads")
    assert left == []


async def test_a_file_of_ones_own_is_understood_and_what_is_open_is_asked_for(plant_file: Path) -> None:
    plant, analyst = load_plant(plant_file), FakeAnalyst()
    own = "Zeit [ms];Druck [bar];Hub\n0;0,1;0\n100;0,2;25,5\n200;0,3;51,0\n".encode("utf-16")
    async with running_service(plant, FakeRig(), analyst) as client:
        for mapping, status in (("", 422), ("position_m=Hub [mm]", 200), ("hub=Hub", 422)):
            data = {"nameplate": NAMEPLATE} | ({"map": mapping} if mapping else {})
            answer = await client.post("/recordings/analyze", files={"recording": ("hub.csv", own)}, data=data)
            assert answer.status_code == status, answer.text
            if not mapping:
                assert_problem(answer, 422, '--map "position_m=Hub [%]"')
        twice = {"nameplate": NAMEPLATE, "map": ["position_m=Hub [mm]", "position_m=Hub [mm]"]}
        answer = await client.post("/recordings/analyze", files={"recording": ("a.csv", own)}, data=twice)
        assert_problem(answer, 422, "one nameplate or valve, and at most one map")
    assert files_in(plant.service.store / "uploads") == []


async def test_a_valve_of_the_plant_stands_for_its_nameplate_and_the_page_has_the_form(plant_file: Path) -> None:
    plant, analyst = load_plant(plant_file), FakeAnalyst()
    async with running_service(plant, FakeRig(), analyst) as client:
        files = {"recording": ("a.csv", CSV)}
        for data, status in (
            ({"valve": "FV-101"}, 200),
            ({"valve": "FV-999"}, 422),
            ({"valve": "FV-101", "nameplate": NAMEPLATE}, 422),
            ({}, 422),
        ):
            answer = await client.post("/recordings/analyze", files=files, data=data)
            assert answer.status_code == status, answer.text
        page = await client.get("/ui/recordings", headers={"Accept": "text/html"})
        assert page.status_code == 200
        assert all(part in page.text for part in ('name="recording"', "<option>FV-101</option>", 'name="map"'))


def files_in(folder: Path) -> list[Path]:
    return list(folder.iterdir())
