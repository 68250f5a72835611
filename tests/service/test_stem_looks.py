"""Signal and stem after a motion: looked at, judged, told and an alarm where the stem is not there: promise 11."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from drivers.stands_at import RestRules, StandsAt, StemVerdict, stands_at
from service.config.settings import load_plant
from service.model.requester import LOCAL
from service.model.run import RunState
from service.model.stands_words import stands_sentence
from service.mqtt.messages import state_message
from service.runs.bus_owners import BusOwners
from service.store.store import Store
from service.words.messages import in_units
from service.words.units import UnitSystem
from simulator.faults import Fault, FaultKind
from tests.service.conftest import PLANT
from tests.service.stored_runs import runs_of
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.plants import bus_text, service_text, valve_text
from tests.support.running_service import running_service
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, standing_valve, wired_plant
from valve.errors import BusyError, ConfigurationError, PermissiveError, RequestError
from valve.messages import Message

JUDGED = "safe_position_m = 0.0\nsafe_position_tolerance_m = 0.002\nstem_read_after_s = {after_s}"
CLOSED = RestRules(0.0, 0.002, 10.0, 0.1016)
NOT_CLOSED = "Signal 0 kPa, read back. Stem 42.7 mm: 42 % OPEN: it has not closed."


def plant_of(folder: Path, after_s: float = 0.0) -> Path:
    """Write a plant of two valves on one bus whose safe position is closed."""
    judged = JUDGED.format(after_s=after_s)
    valves = valve_text("FV-101", "plc-1", stem=judged) + valve_text("FV-102", "plc-1", 2, stem=judged)
    path = folder / "plant.toml"
    path.write_text(service_text() + bus_text("plc-1", 5020) + valves, encoding="utf-8")
    return path


@asynccontextmanager
async def stuck_open(folder: Path, after_s: float = 0.0) -> AsyncIterator[tuple[httpx.AsyncClient, FakeRig]]:
    """Serve a plant whose stems stay at 42.7 mm."""
    rig = FakeRig()
    rig.stem_m = 0.0427
    async with running_service(load_plant(plant_of(folder, after_s)), rig, FakeAnalyst()) as client:
        yield client, rig


@pytest.fixture
def store(quick_path: Path) -> Iterator[Store]:
    store = Store(load_plant(plant_of(quick_path)).service.store)
    yield store
    store.close()


async def looked_at(client: httpx.AsyncClient, test: dict[str, Any]) -> dict[str, Any]:
    async with asyncio.timeout(20.0):
        while test["stands"] is None or test["stands"]["verdict"] == "moving":
            await asyncio.sleep(0.02)
            test = (await client.get(f"/tests/{test['id']}")).json()
    return test


def seen(rules: RestRules = CLOSED, **changes: Any) -> StandsAt:
    """Return a valve whose stem stayed at 42.7 mm."""
    known: dict[str, Any] = {"after_s": 10.0, "safe_pa": 0.0, "confirmed": True, "signal_pa": 0.02, "stem_m": 0.0427}
    return stands_at(rules, **(known | {"signal_tolerance_pa": 80.0} | changes))


OPEN = RestRules(0.1016, 0.002, 10.0, 0.1016)
HALF = RestRules(0.05, 0.002, 10.0, 0.1016)
TOLD = RestRules(travel_m=0.1016)
SENTENCES = {
    "not closed": (seen(), NOT_CLOSED),
    "closed": (seen(stem_m=-0.0003), "Signal 0 kPa, read back. Stem -0.3 mm: closed, as it should be."),
    "not opened": (seen(OPEN), "Signal 0 kPa, read back. Stem 42.7 mm: 42 % OPEN: it has not opened."),
    "open": (seen(OPEN, stem_m=0.1015), "Signal 0 kPa, read back. Stem 101.5 mm: open, as it should be."),
    "in between": (seen(HALF, stem_m=0.0501), "Signal 0 kPa, read back. Stem 50.1 mm: 49 % open, as it should be."),
    "not in between": (seen(HALF), "Stem 42.7 mm: 42 % OPEN: it is not at its safe position of 50 mm."),
    "beyond its seat": (seen(stem_m=-0.009), "-9 % OPEN: it is not at its safe position of 0 mm."),
    "not judged": (seen(TOLD), "Signal 0 kPa, read back. Stem 42.7 mm: 42 % open, not judged."),
    "not read": (
        seen(stem_m=None, stem_unread="bus gauge-1: no answer: check the gauge"),
        "Stem not read: Bus gauge-1: no answer: check the gauge. Nobody knows where it stands.",
    ),
    "neither read": (
        seen(TOLD, signal_pa=None, stem_m=None, signal_unread="no answer", stem_unread="no answer"),
        (
            "Signal was read back at its safe value of 0 kPa when the motion ended. Signal not read: No answer. "
            "Stem not read: No answer."
        ),
    ),
    "moving": (
        seen(is_over=False),
        (
            "Signal 0 kPa, read back. Stem 42.7 mm: 42 % open, moving to 0 mm (closed): it is looked at 10 s after the "
            "motion."
        ),
    ),
    "moving, and nobody saw where": (seen(is_over=False, stem_m=None), "Stem moving to 0 mm (closed): it is looked"),
    "moving somewhere": (seen(TOLD, is_over=False), "Stem 42.7 mm: 42 % open, may still move: it is looked at 10 s"),
    "not confirmed": (
        seen(confirmed=False, signal_pa=55_000.0),
        (
            "SAFE STATE NOT CONFIRMED: go and look at the valve. Signal 55 kPa, and its safe value of 0 kPa was not "
            "read back after the motion. Stem 42.7 mm"
        ),
    ),
    "confirmed too late": (seen(confirmed=False), "Signal 0 kPa now; that was not read back when the motion ended."),
    "somebody else's": (
        seen(signal_pa=55_000.0),
        "Signal was read back at its safe value of 0 kPa and is 55 kPa now: something else commands the valve.",
    ),
    "commanded by nobody": (
        seen(confirmed=None, signal_pa=55_000.0),
        "Signal 55 kPa; this test commanded nothing. Stem 42.7 mm: 42 % open, not judged.",
    ),
    "late": (seen(after_s=95.0), f"{NOT_CLOSED} Read 95 s after the motion."),
    "very late": (seen(after_s=3.1 * 86400.0), f"{NOT_CLOSED} Read 3 days after the motion."),
    "a short stem": (
        seen(RestRules(0.0, 0.0005, 10.0, 0.012), stem_m=0.00117),
        "Stem 1.17 mm: 10 % OPEN: it has not closed.",
    ),
}


def test_where_a_valve_stands_is_told_in_the_units_of_whoever_reads_it() -> None:
    told = in_units(stands_sentence(seen(confirmed=False, signal_pa=55_000.0)), UnitSystem.PSI)
    assert "Signal 7.98 psi, and its safe value of 0 psi was not read back after the motion." in told
    assert "Stem 1.68 in: 42 % OPEN: it has not closed." in told


@pytest.mark.parametrize(("stands", "said"), SENTENCES.values(), ids=list(SENTENCES))
def test_signal_and_stem_are_both_said(stands: StandsAt, said: str) -> None:
    assert said in stands_sentence(stands)
    assert "  " not in stands_sentence(stands)
    assert isinstance(stands_sentence(stands), Message)
    assert StandsAt.from_json(stands.to_json()) == stands


def test_only_a_declared_position_that_was_not_seen_is_an_alarm() -> None:
    alarms = {name for name, (stands, _) in SENTENCES.items() if stands.verdict.is_alarm}
    not_there = {"not closed", "not opened", "not in between", "beyond its seat", "not read", "a short stem"}
    assert alarms == not_there | {"not confirmed", "confirmed too late", "somebody else's", "late", "very late"}


async def test_a_stem_that_has_not_closed_is_an_alarm_everywhere_and_bars_the_next_test(quick_path: Path) -> None:
    async with stuck_open(quick_path) as (client, _):
        run = (await client.post("/tests/run", json={"valve": TAG}, headers={"Prefer": "wait=20"})).json()
        run = await looked_at(client, run)
        assert (run["state"], run["safe_confirmed"], run["needs_acknowledgement"]) == ("completed", True, True)
        assert run["stands"]["sentence"] == NOT_CLOSED
        assert (run["stands"]["verdict"], run["stands"]["stem_m"]) == ("not_there", 0.0427)
        assert run["stands"]["stem_percent"] == pytest.approx(42.03, abs=0.01)
        valve = (await client.get(f"/valves/{TAG}")).json()
        assert NOT_CLOSED in valve["alarms"][0]
        assert valve["last_test"]["stands"]["sentence"] == NOT_CLOSED
        assert valve["safe_position_m"] == 0.0
        refused = await client.post("/tests/run", json={"valve": TAG})
        assert refused.status_code == 423
        assert "STEM NOT AT ITS SAFE POSITION" in refused.json()["detail"]
        for path in ("/", f"/ui/valves/{TAG}", f"/ui/tests/{run['id']}", f"/tests/{run['id']}/report?format=html"):
            page = (await client.get(path)).text
            assert NOT_CLOSED in page, path
        for path in ("/", f"/ui/valves/{TAG}", f"/ui/tests/{run['id']}"):
            assert "not at its safe position" in (await client.get(path)).text.lower(), path
        assert "breakaway_stem_not_at_safe_position 1.0" in (await client.get("/metrics")).text
        said = (await client.post(f"/tests/{run['id']}/acknowledge", json={"note": "plug stuck, freed"})).json()
        assert (said["acknowledgement"], said["needs_acknowledgement"]) == ("plug stuck, freed", False)
        assert "breakaway_stem_not_at_safe_position 0.0" in (await client.get("/metrics")).text
        assert (await client.post("/tests/run", json={"valve": TAG})).status_code == 202


async def test_the_message_by_mqtt_has_both(quick_path: Path, store: Store) -> None:
    rig = FakeRig()
    rig.stem_m = 0.0427
    runs = runs_of(load_plant(plant_of(quick_path)), store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await runs.settled()
    said = state_message(store.runs.get(run.id))
    assert (said["alarm"], said["safe_confirmed"], said["stands_sentence"]) == (True, True, NOT_CLOSED)
    assert (said["stands"]["verdict"], said["stands"]["stem_percent"]) == ("not_there", pytest.approx(42.03, abs=0.01))
    await runs.shut_down()


async def test_a_stem_that_cannot_be_read_is_an_alarm_where_it_was_to_be_judged(quick_path: Path, store: Store) -> None:
    rig = FakeRig()
    rig.stem_m = None
    runs = runs_of(load_plant(plant_of(quick_path)), store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await runs.settled()
    after = store.runs.get(run.id)
    assert after.safe_confirmed is True, "the output is confirmed by the output"
    assert after.stands is not None
    assert after.stands.verdict is StemVerdict.UNKNOWN
    with pytest.raises(PermissiveError, match="acknowledge"):
        await runs.start("FV-101", "triangle", {})
    await runs.shut_down()


async def test_until_the_look_the_stem_is_said_to_move_its_bus_is_free_and_its_valve_is_not(
    quick_path: Path, store: Store
) -> None:
    plant, rig = load_plant(plant_of(quick_path, after_s=2.0)), FakeRig()
    rig.stem_m = 0.0427
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    ended = await runs.wait(run.id, 10.0)
    assert ended.state is RunState.COMPLETED, "neither the result nor a stop waits for the stem"
    assert ended.stands is not None
    assert ended.stands.verdict is StemVerdict.MOVING
    assert "moving to 0 mm (closed): it is looked at 2 s after the motion" in stands_sentence(ended.stands)
    with pytest.raises(BusyError, match="its stem may still move after test"):
        await runs.start("FV-101", "triangle", {})
    assert "the stem of FV-101 is looked at first" in runs.why_not_scheduled("FV-102")
    other = await runs.start("FV-102", "triangle", {})
    assert rig.looks == []
    await runs.settled()
    assert {store.runs.get(one.id).stands.verdict for one in (run, other)} == {StemVerdict.NOT_THERE}  # type: ignore[union-attr]
    assert sorted(tag for tag, _ in rig.looks) == ["FV-101", "FV-102"]
    assert all(2.0 <= after_s < 4.0 for _, after_s in rig.looks)
    await runs.shut_down()


async def test_nobody_acknowledges_a_stem_before_it_was_looked_at(quick_path: Path, store: Store) -> None:
    rig = FakeRig()
    rig.break_at = 0.5
    runs = runs_of(load_plant(plant_of(quick_path, after_s=60.0)), store, rig)
    run = await runs.start("FV-101", "triangle", {})
    assert (await runs.wait(run.id, 10.0)).state is RunState.FAILED
    with pytest.raises(RequestError, match="looked at 60 s after the motion: acknowledge when it was"):
        await runs.acknowledge(run.id, LOCAL, "it is shut")
    await runs.shut_down()


async def test_a_service_that_ends_before_leaves_the_look_to_the_next_start(quick_path: Path, store: Store) -> None:
    plant, rig = load_plant(plant_of(quick_path, after_s=60.0)), FakeRig()
    rig.stem_m = 0.0427
    runs = runs_of(plant, store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await runs.wait(run.id, 10.0)
    async with asyncio.timeout(5.0):
        await runs.shut_down()
    assert rig.looks == []
    assert store.runs.get(run.id).stands.verdict is StemVerdict.MOVING  # type: ignore[union-attr]
    again = runs_of(load_plant(plant_of(quick_path)), store, rig)
    await again.recover()
    await again.settled()
    assert store.runs.get(run.id).stands.verdict is StemVerdict.NOT_THERE  # type: ignore[union-attr]
    assert rig.recoveries == [], "its motion had ended"
    await again.shut_down()


async def test_a_look_that_fails_and_a_store_that_is_away_lose_no_alarm(
    quick_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()

    async def broken(*_: Any, **__: Any) -> StandsAt:
        raise RuntimeError("a fault of ours")

    note, left = store.runs.note_stands, 2

    def away(*arguments: Any) -> Any:
        nonlocal left
        left -= 1
        if left >= 0:
            raise OSError(5, "Input/output error")
        return note(*arguments)

    monkeypatch.setattr(rig, "stands", broken)
    monkeypatch.setattr(store.runs, "note_stands", away)
    monkeypatch.setattr("service.runs.stem_looks._STORE_AGAIN_S", 0.02)
    runs = runs_of(load_plant(plant_of(quick_path)), store, rig)
    run = await runs.start("FV-101", "triangle", {})
    await runs.settled()
    stands = store.runs.get(run.id).stands
    assert stands is not None
    assert (stands.verdict, left) == (StemVerdict.UNKNOWN, -1)
    assert "a fault of ours: report it" in stands_sentence(stands)
    await runs.shut_down()


async def test_a_look_that_is_due_comes_before_the_next_test_on_its_bus() -> None:
    owners = BusOwners()
    first = owners.claim("run-1", "A", {"bus-1", "bus-2"}, scheduled=True)
    owners.rest(first, {"bus-1"})
    assert owners.holder("A") == "run-1"
    assert "stem of A" in owners.why_not_scheduled("B", {"bus-1"})
    assert owners.why_not_scheduled("B", {"bus-2"}) == ""
    second = owners.claim("run-2", "B", {"bus-1"})  # people may, before it is due
    with pytest.raises(BusyError, match="run-2 of B"):
        await owners.look(first)
    owners.release(second)
    with pytest.raises(BusyError, match="the stem of A is looked at first"):
        owners.claim("run-3", "B", {"bus-1"})
    await owners.look(first)
    with pytest.raises(BusyError, match="stem of A"):
        owners.claim("run-4", "B", {"bus-1"})
    owners.release(first)
    assert owners.why_not_scheduled("A", {"bus-1", "bus-2"}) == ""


async def test_two_looks_that_are_due_on_one_bus_do_not_wait_for_each_other() -> None:
    owners = BusOwners()
    first = owners.claim("run-1", "A", {"bus-1"})
    owners.rest(first, {"bus-1"})
    second = owners.claim("run-2", "B", {"bus-1"})
    owners.rest(second, {"bus-1"})
    third = owners.claim("run-3", "C", {"bus-1"})
    for waiting in (first, second):
        with pytest.raises(BusyError, match="run-3 of C"):
            await owners.look(waiting)
    owners.release(third)
    await owners.look(first)
    with pytest.raises(BusyError, match="run-1 of A"):
        await owners.look(second)
    owners.rest(first, ())
    await owners.look(second)


async def test_on_real_wires_a_stem_that_is_not_where_it_should_be_is_seen(quick_path: Path) -> None:
    async with wired_plant(quick_path) as (path, _):
        text = path.read_text(encoding="utf-8").replace("stem_read_after_s = 0.0", JUDGED.format(after_s=0.5))
        path.write_text(text, encoding="utf-8")
        order = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 1.0, "low_pa": 3e4, "high_pa": 4e4}}
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            run = (await client.post("/tests/run", json=order, headers={"Prefer": "wait=30"})).json()
            assert run["stands"]["verdict"] == "moving"
            assert run["stands"]["stem_m"] is not None, "the last sample of the motion shows it"
            run = await looked_at(client, run)
        stands = run["stands"]
        assert run["safe_confirmed"] is True
        assert stands["signal_pa"] == pytest.approx(SAFE_PA, abs=100.0)
        assert stands["verdict"] == "not_there", f"{SAFE_PA} Pa do not close it"
        assert 0.01 < stands["stem_m"] < 0.09
        assert 0.5 <= stands["after_s"] < 5.0
        assert stands["sentence"].startswith("Signal 20 kPa, read back. Stem ")
        assert stands["sentence"].endswith("OPEN: it has not closed.")


async def test_on_real_wires_a_stem_that_sticks_open_is_no_safe_valve(quick_path: Path) -> None:
    valve = standing_valve(45_000.0, Fault(FaultKind.STUCK_STEM, 0.01))
    async with wired_plant(quick_path, valve=valve, safe="0.0") as (path, plant):
        text = path.read_text(encoding="utf-8").replace("stem_read_after_s = 0.0", JUDGED.format(after_s=0.5))
        path.write_text(text, encoding="utf-8")
        order = {"valve": TAG, "overrides": {"cycles": 1, "period_s": 1.0, "low_pa": 3e4, "high_pa": 4e4}}
        async with running_service(load_plant(path), None, FakeAnalyst()) as client:
            run = (await client.post("/tests/run", json=order, headers={"Prefer": "wait=30"})).json()
            run = await looked_at(client, run)
            refused = await client.post("/tests/run", json=order)
        assert asked_pa(plant) == pytest.approx(0.0, abs=10.0)
        assert run["safe_confirmed"] is True
        assert "Signal 0 kPa, read back. Stem " in run["stands"]["sentence"]
        assert run["stands"]["sentence"].endswith("OPEN: it has not closed.")
        assert refused.status_code == 423


BAD = {
    "far from the valve": ("safe_position_m = 5.0", ["safe_position_m = 5.0", "-0.01016 to 0.11176 m", "closed end"]),
    "a tolerance alone": ("safe_position_tolerance_m = 0.001", ["safe_position_tolerance_m", "missing", "remove"]),
    "a wide tolerance": (
        "safe_position_m = 0.0\nsafe_position_tolerance_m = 0.05",
        ["safe_position_tolerance_m = 0.05", "a quarter of the travel, 0.0254 m", "correct it"],
    ),
    "no tolerance at all": ("safe_position_m = 0.0\nsafe_position_tolerance_m = 0.0", ["above 0", "correct it"]),
    "no position": ('safe_position_m = "closed"', ["safe_position_m", '"closed"', "without quotes"]),
    "before the end": ("stem_read_after_s = -1.0", ["stem_read_after_s", "-1 s", "0 to 600 s"]),
    "an hour later": ("stem_read_after_s = 3600.0", ["stem_read_after_s", "3600 s", "0 to 600 s"]),
}


@pytest.mark.parametrize(("written", "expected"), BAD.values(), ids=list(BAD))
def test_a_bad_safe_position_is_refused_with_key_value_limit_and_remedy(
    plant_file: Path, written: str, expected: list[str]
) -> None:
    plant_file.write_text(PLANT.replace("stem_read_after_s = 0.0", written, 1), encoding="utf-8")
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file)
    said = str(caught.value)
    assert said.startswith("plant.toml: valves[0].")
    assert len(said.splitlines()) == 1
    for part in expected:
        assert part in said


def test_by_default_a_stem_is_looked_at_after_ten_seconds_and_not_judged(plant_file: Path) -> None:
    plant_file.write_text(PLANT.replace("stem_read_after_s = 0.0", ""), encoding="utf-8")
    rest = load_plant(plant_file).valves["FV-101"].wiring.rest
    assert (rest.position_m, rest.after_s, rest.travel_m) == (None, 10.0, 0.1016)
    plant_file.write_text(PLANT.replace("stem_read_after_s = 0.0", "safe_position_m = 0.0", 1), encoding="utf-8")
    rest = load_plant(plant_file).valves["FV-101"].wiring.rest
    assert rest.position_m == 0.0
    assert rest.tolerance_m == pytest.approx(0.02 * 0.1016)
