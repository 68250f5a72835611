from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import time_machine
from typer.testing import CliRunner

from service.cli import app
from service.config.plant import Plant
from service.config.settings import load_plant
from service.schedules.plan import plan_night
from service.store.store import Store
from tests.service.nights import NIGHTLY, night_plant, plant_text
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.problem import assert_problem
from tests.support.running_service import running_service
from valve.errors import ConfigurationError, ValveError

EVENING = datetime(2026, 6, 30, 18, 0, tzinfo=UTC)
GATEWAYS = '[[gateways]]\nname = "g1"\nurl = "http://one:8321"\n[[gateways]]\nname = "g2"\nurl = "http://two:8321/"\n'


def _load(folder: Path, text: str) -> Plant:
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return load_plant(path)


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("Europe/Berlin", "Europe/Atlantis", r"schedules\[0\]\.zone = \"Europe/Atlantis\": no time zone has this name"),
        ("Europe/Berlin", "../passwd", r"no time zone has this name"),
        ("30 2 * * *", "61 2 * * *", r"schedules\[0\]\.cron .*no time of cron"),
        ("30 2 * * *", "0 0 31 2 *", r"no time of cron"),
        ('groups = ["all"]', 'groups = ["none"]', r"no group has this name"),
        ('groups = ["all"]', "", r"checks no valve"),
        ('"A1", "A2", "B1"', '"A1", "ZZ"', r"groups\[0\]\.valves\[1\] = \"ZZ\": no valve has this tag"),
        ('"triangle"', '"waltz"', r"sequence = \"waltz\".*unknown"),
        ('"triangle"', '"steps"', r"A1: .*step"),
        ("3600.0", "10.0", r"window_s"),
    ],
)
def test_a_schedule_that_cannot_be_is_refused_at_the_start(quick_path: Path, was: str, now: str, message: str) -> None:
    assert was in NIGHTLY
    with pytest.raises(ConfigurationError, match=message):
        night_plant(quick_path, NIGHTLY.replace(was, now))


@pytest.mark.parametrize(
    ("until", "mode", "message"),
    [
        ('{ F_s = "5 %" }', "captured", r"schedules\[0\]\.until .*A1: until needs a polled test"),
        ('{ F_x = "5 %" }', "polled", r"A1: until.F_x is unknown"),
        ('{ F_s = "77 %" }', "polled", r"at most 50 %"),
        ("{ F_s = 5 }", "polled", r"must be a percentage"),
        ("{}", "polled", r"until is empty"),
    ],
)
def test_an_until_that_a_schedules_tests_cannot_follow_is_refused_in_the_words_of_a_request(
    quick_path: Path, until: str, mode: str, message: str
) -> None:
    text = plant_text(NIGHTLY.replace("window_s", f"until = {until}\nwindow_s"))
    with pytest.raises(ConfigurationError, match=message):
        _load(
            quick_path,
            text.replace('mode = "captured"', f'mode = "{mode}"\n').replace("period_s = 0.001", "period_s = 0.02"),
        )


def test_a_schedule_of_a_valve_that_needs_a_permit_is_refused_for_no_schedule_has_one(tmp_path: Path) -> None:
    text = plant_text().replace("[valves.acquisition]", "[valves.permissives]\npermit = true\n[valves.acquisition]", 1)
    with pytest.raises(ConfigurationError, match=r'schedules\[0\]\.valves = "A1": its tests need a work permit'):
        _load(tmp_path, text)


@pytest.mark.parametrize(
    ("service", "gateways", "more", "message"),
    [
        ("", ("g1", "g2"), GATEWAYS, "several gateways.*say which this is"),
        ('gateway = "g3"', ("g1", "g2"), GATEWAYS, "no gateway has this name"),
        ('gateway = "g1"', ("g1", "g9"), GATEWAYS, r"buses\[1\]\.gateway = \"g9\""),
        ('gateway = "g1"', ("g1", ""), GATEWAYS, r"buses\[1\]\.gateway = null"),
        ("", ("g1", ""), "", r"buses\[0\]\.gateway.*no \[\[gateways\]\]"),
        ('database = "mysql://x/y"', ("", ""), "", "postgresql\\+psycopg address"),
        ('database = "postgresql+psycopg://a:hush@x/y"', ("", ""), "", "a password stands in it"),
        ('database_password_file = "secret"', ("", ""), "", "there is no service.database"),
    ],
)
def test_gateways_and_databases_that_cannot_be_are_refused(
    quick_path: Path, service: str, gateways: tuple[str, str], more: str, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        _load(quick_path, plant_text(more, service, gateways))
    assert "hush" not in str(caught.value)


def test_a_valve_needs_its_buses_at_one_gateway(quick_path: Path) -> None:
    text = plant_text(GATEWAYS, 'gateway = "g1"', ("g1", "g2"))
    second = text.replace(
        "[valves.acquisition]",
        '[valves.position]\nbus = "b"\ndevice_id = 9\nmap = "reference"\n[valves.acquisition]',
        1,
    )
    with pytest.raises(ConfigurationError, match="belong to gateways g1 and g2"):
        _load(quick_path, second)
    plant = _load(quick_path, text)
    assert (plant.gateway_of("A1"), plant.gateway_of("B1")) == ("g1", "g2")
    assert plant.is_ours("A1")
    assert not plant.is_ours("B1")


async def test_another_gateways_valve_is_refused_with_the_gateways_address(quick_path: Path) -> None:
    plant = _load(quick_path, plant_text(GATEWAYS, 'gateway = "g1"', ("g1", "g2")))
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        answer = await client.post("/tests/run", json={"valve": "B1"})
        assert_problem(answer, 421, "gateway g2 drives this valve", "http://two:8321")
        assert (answer.json()["gateway"], answer.json()["url"]) == ("g2", "http://two:8321")
        mine = await client.post("/tests/run", json={"valve": "A1"}, headers={"Prefer": "wait=10"})
        assert mine.json()["state"] == "completed"


@pytest.mark.parametrize("look_s", [0.0, 12.0])
def test_the_plan_has_one_valve_at_a_time_on_a_bus_and_says_who_comes_too_late(quick_path: Path, look_s: float) -> None:
    file = night_plant(quick_path, NIGHTLY.replace("3600.0", "60.0")).file
    text = file.read_text(encoding="utf-8").replace("stem_read_after_s = 0.0", f"stem_read_after_s = {look_s}")
    file.write_text(text, encoding="utf-8")
    checks = plan_night(load_plant(file), EVENING, EVENING + timedelta(hours=24))
    due = datetime(2026, 7, 1, 0, 30, tzinfo=UTC)
    assert [(check.valve, check.starts_at) for check in checks] == [
        ("A1", due),
        ("B1", due),
        ("A2", due + timedelta(seconds=70.0 + look_s)),  # the stem of A1 is looked at first
    ]
    assert [check.fits for check in checks] == [True, True, False]


def test_the_coming_night_is_shown_without_a_service(quick_path: Path) -> None:
    night_plant(quick_path)
    command = ["schedule", "show", "--config", str(quick_path / "plant.toml")]
    with time_machine.travel(EVENING, tick=False):
        shown = CliRunner().invoke(app, command, env={"COLUMNS": "80"})
        as_json = CliRunner().invoke(app, [*command, "--json"])
    assert shown.exit_code == 0, shown.output
    for text in ("Wed 2026-07-01 02:30", "02:31", "03:30", "nightly", "those of Europe/Berlin", "A2"):
        assert text in shown.output
    assert "…" not in shown.output
    checks = json.loads(as_json.output)["checks"]
    assert [check["valve"] for check in checks] == ["A1", "B1", "A2"]
    assert checks[0]["due_at"] == "2026-07-01T00:30:00+00:00"


def test_a_plant_without_schedules_is_told_which_section_is_missing() -> None:
    example = Path(__file__).parents[2] / "examples" / "plant.toml"
    shown = CliRunner().invoke(app, ["schedule", "show", "--config", str(example)], env={"COLUMNS": "140"})
    assert shown.exit_code == 0, shown.output
    assert "no [[schedules]]" in shown.output


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [(("show",), "needs the plant file"), (("run",), "needs the name"), (("show", "weekly"), "'weekly' is unknown")],
)
def test_the_schedule_command_says_what_it_needs(quick_path: Path, arguments: tuple[str, ...], reason: str) -> None:
    night_plant(quick_path)
    config = ["--config", str(quick_path / "plant.toml")] if "weekly" in arguments else []
    done = CliRunner().invoke(app, ["schedule", *arguments, *config])
    assert isinstance(done.exception, ValveError)
    assert reason in str(done.exception)


async def test_schedules_and_the_night_are_served_and_run_by_hand(quick_path: Path) -> None:
    plant = night_plant(quick_path)
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        listed = (await client.get("/schedules")).json()["schedules"]
        assert [(one["name"], one["zone"], one["valves"], one["last"]) for one in listed] == [
            ("nightly", "Europe/Berlin", ["A1", "A2", "B1"], None)
        ]
        assert listed[0]["next_due"] is not None
        planned = (await client.get("/schedules/night")).json()
        assert [(one["valve"], one["state"]) for one in planned] == [
            ("A1", "planned"),
            ("B1", "planned"),
            ("A2", "planned"),
        ]
        begun = await client.post("/schedules/nightly/run")
        assert begun.status_code == 202
        assert begun.json()["states"] == {"queued": 3}
        assert begun.json()["requested_by"] == "local"
        ended, done = False, list[dict[str, str]]()
        deadline = datetime.now(UTC) + timedelta(seconds=30)
        while not ended:
            night = (await client.get("/schedules/night")).json()
            done = [one for one in night if one["test_id"] is not None]
            ended = [one["state"] for one in done] == ["completed"] * 3
            assert datetime.now(UTC) < deadline, night
        last = (await client.get("/schedules")).json()["schedules"][0]["last"]
        assert last["states"] == {"completed": 3}
        test = (await client.get(f"/tests/{done[0]['test_id']}")).json()
        assert test["state"] == "completed"
        assert_problem(await client.post("/schedules/weekly/run"), 404, "'weekly' is unknown")
    log = (plant.service.store / "audit").glob("*")
    assert '"schedule.run"' in "".join(path.read_text(encoding="utf-8") for path in log)
    Store(plant.service.store).close()  # it was given back


async def test_valves_are_listed_by_page(quick_path: Path) -> None:
    async with running_service(night_plant(quick_path), FakeRig(), FakeAnalyst()) as client:
        whole = (await client.get("/valves")).json()
        assert [valve["tag"] for valve in whole["valves"]] == ["A1", "A2", "B1"]
        assert whole["next"] is None
        first = (await client.get("/valves", params={"limit": 2})).json()
        rest = (await client.get(first["next"])).json()
        assert [valve["tag"] for valve in first["valves"] + rest["valves"]] == ["A1", "A2", "B1"]
        assert rest["next"] is None


def test_a_schedule_runs_what_is_approved_alone(quick_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"schedules\[0\]\.sequence = \"triangle\".*approved_sequences"):
        night_plant(quick_path, service='approved_sequences = ["sine"]')
