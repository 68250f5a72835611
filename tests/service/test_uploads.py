"""Several uploaded recordings of one valve, and held-out ones, reach the analysis; nothing is kept."""

from __future__ import annotations

from pathlib import Path

from service.settings import load_plant
from tests.service.fake_rig import FakeAnalyst, FakeRig
from tests.service.problem import assert_problem
from tests.service.running_service import running_service

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
        text = [("held_out", (None, "no file")), ("recording", ("a.csv", CSV))]
        answer = await client.post("/recordings/analyze", files=text, data={"nameplate": NAMEPLATE})
        assert_problem(answer, 422, "part held_out is missing or no file")
    left = files_in(plant.service.store / "uploads")
    assert left == []


def files_in(folder: Path) -> list[Path]:
    return list(folder.iterdir())
