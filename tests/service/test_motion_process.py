"""The motion process behind its socket: who may ask what, what survives whom, and what it trusts."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.faults import GatewayPathError
from drivers.motion.client import MotionClient, stopped_here
from drivers.motion.local_socket import LONGEST_LINE, connected, listening
from drivers.motion.motion import Motion
from drivers.motion.orders import Armed, Heard, MotionEnd, MotionLostError, Order
from drivers.motion.plant_read import valve_read
from drivers.motion.server import MotionServer
from drivers.motion.spool import Spool
from drivers.motion.wire_format import PROTOCOL, error_of, line_of, of_json, said_in, to_json
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.permissive import Permissive
from drivers.stands_at import StandsAt, StemVerdict
from service.config.plant import Plant
from tests.support.fake_rig import FakeRig
from tests.support.in_process import motion_on
from valve import messages
from valve.errors import (
    BusyError,
    DeviceError,
    InternalError,
    NotFoundError,
    PermissiveError,
    RequestError,
    ValveError,
    WaveformError,
)
from valve.messages import Message, joined, message_of, say, with_table
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, triangle

ID = "20261121T031502Z-9f3c01ab"
OTHER = "20261121T031503Z-9f3c01ac"


def order(run_id: str = ID, tag: str = "FV-101", rate: float = 1.0) -> Order:
    return Order(run_id, tag, triangle(2.0 / rate, 1, 10_000.0, 20_000.0), "triangle", 1, requested_by="anna")


@asynccontextmanager
async def listening_motion(motion: Motion, socket: Path) -> AsyncIterator[MotionServer]:
    server = MotionServer(motion, "breakaway 0")
    with listening(socket) as listener:
        listener.setblocking(False)
        listens = await asyncio.start_unix_server(server.accept, sock=listener, limit=LONGEST_LINE)
        try:
            yield server
        finally:
            listens.close()
            await server.close()


@asynccontextmanager
async def service_of(plant: Plant) -> AsyncIterator[MotionClient]:
    client = MotionClient(plant.service.motion_socket, plant.service.store / "journals")
    try:
        yield client
    finally:
        await client.close()


@pytest.fixture
async def motion(plant: Plant, rig: FakeRig) -> AsyncIterator[Motion]:
    (plant.service.store / "journals").mkdir(parents=True)
    made = motion_on(plant, rig)
    async with listening_motion(made, plant.service.motion_socket):
        yield made
        await made.shut_down("the test is over", 5.0)


async def test_samples_progress_and_the_end_come_as_the_rig_tells_them(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    heard: dict[str, list[Any]] = {"armed": [], "samples": [], "progress": [], "commanded": []}
    async with service_of(plant) as service:
        end = await service.play(
            order(),
            Heard(
                heard["armed"].append,
                heard["samples"].append,
                lambda share, phase: heard["progress"].append((share, phase)),
                lambda: heard["commanded"].append(True),
            ),
        )
        recording = end.outcome.recording
        assert recording is not None
        assert [(armed.entry_pa, armed.device) for armed in heard["armed"]] == [(1234.0, "fake device")]
        assert heard["armed"][0] == Armed(1234.0, "fake device", rig.shown)
        assert np.concatenate([block.time_s for block in heard["samples"]]).tolist() == recording.time_s.tolist()
        assert heard["progress"][-1] == (1.0, "playing")
        assert heard["commanded"] == [True]
        assert (end.outcome.ended, end.outcome.safe_confirmed, end.entry_pa) == (Ended.COMPLETED, True, 1234.0)
        assert (await service.left())[0].ended
        service.forget(ID)
        assert await service.left() == ()
    assert not motion.moves


async def test_a_motion_goes_on_without_the_service_and_the_next_one_hears_its_end(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    rig.duration_s = 0.6
    async with service_of(plant) as service:
        await service.take_aside(["plc-1"])
        playing = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
    with pytest.raises(MotionLostError, match="watchdog alone acts"):
        await playing
    assert motion.moves
    async with service_of(plant) as service:
        assert [(one.order.tag, one.ended) for one in await service.left()] == [("FV-101", False)]
        armed: list[Armed] = []
        end = await service.rejoin(ID, Heard(on_armed=armed.append))
        assert len(armed) == 1
        assert end.outcome.ended is Ended.COMPLETED
        assert end.outcome.recording is not None
        assert end.outcome.recording.samples == 200


async def test_an_end_that_nobody_heard_outlives_the_motion_process_too(plant: Plant, rig: FakeRig) -> None:
    first = motion_on(plant, rig)
    (plant.service.store / "journals").mkdir(parents=True)
    played = await first.play(order())
    second = motion_on(plant, FakeRig())
    ((left,), end) = await second.left(), await second.rejoin(ID)
    assert left.ended
    assert left.order.waveform.pressure_pa.tolist() == order().waveform.pressure_pa.tolist()
    assert played.outcome.recording is not None
    assert end.outcome.recording is not None
    assert end.outcome.recording.position_m.tolist() == played.outcome.recording.position_m.tolist()
    second.forget(ID)
    assert await second.left() == ()
    with pytest.raises(NotFoundError):
        await second.rejoin(ID)


async def test_buses_are_free_for_others_once_no_motion_of_a_service_that_is_gone_uses_them(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    rig.duration_s = 0.6
    others = motion_on(plant, FakeRig())
    async with service_of(plant) as service:
        await service.take_aside(["plc-1"])
        playing = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
    with pytest.raises(MotionLostError):
        await playing
    with pytest.raises(BusyError, match="another process"):
        await others.take_aside(["plc-1"])
    await motion.end_of(ID)
    await asyncio.sleep(0)
    await others.take_aside(["plc-1"])
    others.give_back(["plc-1"])


async def test_a_service_holds_a_bus_for_a_look_and_no_longer(plant: Plant, motion: Motion) -> None:
    others = motion_on(plant, FakeRig())
    async with service_of(plant) as service:
        async with service.hold(["plc-1"]):
            with pytest.raises(BusyError):
                await others.take_aside(["plc-1"])
        await service.left()  # heard behind the release
        await others.take_aside(["plc-1"])
        with pytest.raises(BusyError, match="another process"):
            async with service.hold(["plc-1"]):
                raise AssertionError
        others.give_back(["plc-1"])


async def test_there_is_one_service_and_whoever_else_asks_may_look_and_stop(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    rig.duration_s = 30.0
    async with service_of(plant) as service, service_of(plant) as second:
        playing = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
        with pytest.raises(BusyError, match="another service"):
            await second.connect(0.5)
        answers = await _said(
            plant, ("state", {}), ("play", {"order": to_json(order(OTHER))}), ("reload", {"kept": []})
        )
        assert answers[0]["answer"]["left"][0]["order"]["tag"] == "FV-101"
        assert [one["error"] for one in answers[1:]] == ["RequestError", "RequestError"]
        ends = await stopped_here(plant.service.motion_socket, "FV-101", "stopped on the gateway")
        assert [(one.tag, end.outcome.safe_confirmed) for one, end in ends] == [("FV-101", True)]
        end = await playing
        assert (end.outcome.ended, end.stopped) == (Ended.STOPPED, "stopped on the gateway")
        assert await stopped_here(plant.service.motion_socket, "FV-101", "again") == ()
    assert not motion.moves


async def _said(plant: Plant, *asked: tuple[str, dict[str, Any]]) -> list[dict[str, Any]]:
    reader, writer = await connected(plant.service.motion_socket)
    for number, (name, about) in enumerate(asked):
        writer.write(line_of({"id": number, "ask": name, **about}))
    answers = [json.loads(await reader.readline()) for _ in asked]
    writer.close()
    return sorted(answers, key=lambda one: one["id"])


async def test_what_nobody_understands_is_refused_and_ends_nobody_else(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    rig.duration_s = 1.0
    async with service_of(plant) as service:
        playing = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
        unknown, old = await _said(plant, ("fly", {}), ("own", {"protocol": 0}))
        assert "unknown" in unknown["text"]
        assert "version" in old["text"]
        for torn in (b"\xff\xfe\n", b"{}\n", b"[1]\n", b'{"say": "stop"}\n', b"{"):
            reader, writer = await connected(plant.service.motion_socket)
            writer.write(torn)
            writer.write_eof()
            assert await reader.read() == b""
            writer.close()
        assert (await playing).outcome.ended is Ended.COMPLETED
    assert not motion.moves


async def test_whoever_asks_cannot_change_what_a_valve_may_do(plant: Plant, rig: FakeRig, motion: Motion) -> None:
    async with service_of(plant) as service:
        with pytest.raises(WaveformError, match="FV-101"):
            await service.play(order(rate=1e4), Heard())
        with pytest.raises(NotFoundError, match="breakaway reload"):
            await service.play(order(tag="FV-9"), Heard())
        first = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
        with pytest.raises(BusyError, match="moves"):
            await service.play(order(OTHER), Heard())
        await first
    assert [one.run_id for one in rig.orders] == [ID]
    assert not motion.moves


async def test_an_order_of_somebody_who_has_read_another_plant_file_moves_nothing(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    mine = valve_read(plant.valves["FV-101"].wiring, plant.buses)
    async with service_of(plant) as service:
        with pytest.raises(PermissiveError, match="plant_file: service and motion process have read different ones"):
            await service.play(replace(order(), read="0" * 16), Heard())
        shown = {one.name: one.met for one in await service.permissives("FV-101", None, "0" * 16)}
        assert shown["plant_file"] is False
        assert rig.orders == []
        await service.play(replace(order(), read=mine), Heard())
        assert [one.met for one in await service.permissives("FV-101", None, mine)] == [True, True]
    assert [one.run_id for one in rig.orders] == [ID]


async def test_a_refusal_says_what_the_device_said_and_that_nothing_moved(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    rig.refusal = DeviceError("FV-101: another run owns the device: wait")
    async with service_of(plant) as service:
        with pytest.raises(DeviceError, match="another run owns"):
            await service.play(order(), Heard())
    assert not motion.moves


async def test_without_a_motion_process_it_is_said_how_to_start_one(plant: Plant) -> None:
    async with service_of(plant) as service:
        with pytest.raises(MotionLostError, match="breakaway motion --config"):
            await service.connect(0.0)
        service.stop(ID, "nobody is there")


async def test_a_socket_that_a_dead_process_left_is_replaced_and_one_that_is_answered_is_not(tmp_path: Path) -> None:
    deep = tmp_path / ("folder-" * 20) / "motion.sock"
    with listening(deep) as first:
        assert deep.stat().st_mode & 0o077 == 0
        with pytest.raises(RequestError, match="answers there already"):
            listening(deep)
        first.close()
    with listening(deep):
        pass


def test_what_moves_valves_loads_no_web_no_database_and_no_analysis() -> None:
    heavy = ("fastapi", "starlette", "uvicorn", "sqlalchemy", "scipy", "numba", "matplotlib", "pyarrow")
    loaded = (
        "import sys, drivers.motion.program, service.cli.motion, service.config.settings, service.server.logs; "
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def _blocks() -> list[SampleBlock]:
    time_s = np.array([0.0, 0.02])
    position_m = np.array([0.001, math.nan])
    return [
        SampleBlock(time_s, position_m, time_s, time_s, time_s, time_s, recorded=True, late_s=time_s),
        SampleBlock(time_s, position_m, time_s, time_s, None, None, recorded=False),
    ]


@pytest.mark.parametrize("block", _blocks())
def test_samples_are_the_same_on_the_other_side(block: SampleBlock) -> None:
    there = of_json(SampleBlock, json.loads(line_of(to_json(block))))
    for name in SampleBlock.__dataclass_fields__:
        np.testing.assert_equal(getattr(there, name), getattr(block, name))


@pytest.mark.parametrize(
    "error", [DeviceError("look"), GatewayPathError("no path"), BusyError("wait"), InternalError("ours")]
)
def test_an_error_is_of_its_kind_on_the_other_side(error: ValveError) -> None:
    there = error_of(json.loads(line_of(to_json(error))))
    assert (type(there), str(there)) == (type(error), str(error))


STUCK = say("stuck_in_tests", "{tag}: the stem stands at {at:.1f mm}: look at it", tag="FV-101", at=0.0123)
UNSAFE = say("unsafe_in_tests", "it shows {shown:g Pa}", shown=math.nan)


def _told(text: str | None, message: Message) -> bool:
    return isinstance(text, Message) and text.to_json() == message.to_json()


def _ended_badly() -> MotionEnd:
    seen = StandsAt(StemVerdict.UNKNOWN, datetime(2026, 11, 28, 3, 0, tzinfo=UTC), 0.5, stem_unread=STUCK)
    held = DeviceError(joined("; ", (STUCK, UNSAFE)))
    outcome = PlayOutcome(None, Ended.FAILED, False, held, ("plain", UNSAFE), 7, stands=seen, why_unsafe=UNSAFE)
    return MotionEnd(outcome, 1234.5, (STUCK,), STUCK)


def test_an_end_keeps_what_its_texts_were_made_of_on_the_disk(tmp_path: Path) -> None:
    spool, end = Spool(tmp_path), _ended_badly()
    spool.write(order(), end)
    there = spool.read(ID)
    assert there.outcome.error is not None
    assert end.outcome.error is not None
    assert _told(message_of(there.outcome.error), end.outcome.error.args[0])
    assert there.outcome.stands is not None
    assert _told(there.outcome.stands.stem_unread, STUCK)
    assert _told(there.outcome.why_unsafe, UNSAFE)
    assert there.outcome.notes == ("plain", UNSAFE)
    assert [type(note) for note in there.outcome.notes] == [str, Message]
    assert _told(there.faults[0], STUCK)
    assert _told(there.stopped, STUCK)


def test_an_end_that_an_earlier_version_left_is_read_as_texts(tmp_path: Path) -> None:
    spool, end = Spool(tmp_path), _ended_badly()
    spool.write(order(), end)
    path = spool.path(ID, ".end")
    left = json.loads(path.read_text())
    del left["messages"]
    path.write_text(json.dumps(left))
    there = spool.read(ID)
    assert str(there.outcome.error) == str(end.outcome.error)
    assert type(there.outcome.why_unsafe) is str
    assert there.outcome.stands == end.outcome.stands
    assert [one.order.run_id for one in spool.all()] == [ID]


async def test_what_is_said_over_the_socket_keeps_what_it_was_made_of(
    plant: Plant, rig: FakeRig, motion: Motion
) -> None:
    value = say("supply_in_tests", "{supply:.2f kPa}", supply=123456.0)
    rig.shown = (Permissive("supply", True, value, "some air", "look"),)
    armed: list[Armed] = []
    async with service_of(plant) as service:
        shown = await service.permissives("FV-101", None, "")
        assert _told(shown[0].value, value)
        assert (shown[0].limit, type(shown[0].limit)) == ("some air", str)
        rig.refusal = PermissiveError(STUCK)
        with pytest.raises(PermissiveError) as refused:
            await service.play(order(OTHER), Heard())
        assert _told(message_of(refused.value), STUCK)
        rig.refusal, rig.duration_s = None, 5.0
        playing = asyncio.create_task(service.play(order(), Heard(on_armed=armed.append)))
        await rig.moving.wait()
        service.stop(ID, STUCK)
        end = await playing
        assert _told(armed[0].permissives[0].value, value)
        assert _told(end.stopped, STUCK)


async def test_a_stop_without_the_service_is_heard_by_a_motion_process_that_knows_no_messages(
    plant: Plant, rig: FakeRig, motion: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[bytes] = []

    def noted(message: dict[str, Any]) -> bytes:
        lines.append(line_of(message))
        return lines[-1]

    monkeypatch.setattr("drivers.motion.client.line_of", noted)
    rig.duration_s = 5.0
    async with service_of(plant) as service:
        playing = asyncio.create_task(service.play(order(), Heard()))
        await rig.moving.wait()
        ((_, end),) = await stopped_here(plant.service.motion_socket, "FV-101", STUCK)
        assert end.stopped == STUCK
        await playing
    asked = [said for said in map(json.loads, lines) if said.get("ask") == "stop_and_wait"]
    assert [sorted(said) for said in asked] == [["ask", "id", "reason", "run_id"]]


def test_columns_of_numbers_are_not_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at: list[Any] = []
    whole = messages._messages_in

    def counted(document: Any) -> Iterator[tuple[str, Message]]:
        looked_at.append(document)
        return whole(document)

    monkeypatch.setattr(messages, "_messages_in", counted)
    column = np.linspace(0.0, 1.0, 10_000)
    block = SampleBlock(column, column, column, column, column, column, recorded=True)
    line = line_of({"run": ID, "event": "samples", "value": to_json(block)})
    of_json(SampleBlock, said_in(line)["value"])
    assert looked_at == []
    wave = Waveform("long", column, column)
    with_table({"order": to_json(replace(order(), waveform=wave))})
    assert 0 < len(looked_at) < 40


def test_an_end_is_the_same_after_the_disk(tmp_path: Path) -> None:
    time_s = np.linspace(0.0, 1.0, 50)
    about = Provenance(Acquisition.POLLED, "FV-101", requested_period_s=0.02, notes="n")
    recording = Recording(time_s, 0.1 * time_s, command_pa=time_s, sent_s=time_s, provenance=about)
    seen = StandsAt(StemVerdict.MOVING, datetime(2026, 11, 28, 3, 0, tzinfo=UTC), 0.5, safe_pa=2e4, stem_m=0.01)
    outcome = PlayOutcome(
        recording, Ended.FAILED, False, DeviceError("stuck"), ("one",), 7, stands=seen, why_unsafe="it shows 7 Pa"
    )
    end = MotionEnd(outcome, 1234.5, ("no disk",), "")
    spool = Spool(tmp_path)
    spool.write(order(), end)
    there = spool.read(ID)
    assert (there.entry_pa, there.faults, there.stopped) == (1234.5, ("no disk",), "")
    assert str(there.outcome.error) == "stuck"
    assert there.outcome.stands == seen
    assert there.outcome.recording is not None
    assert there.outcome.recording.provenance == about
    assert there.outcome.recording.pressure_pa is None
    (tmp_path / f"{ID}.npz").write_bytes(b"torn")
    with pytest.raises(InternalError, match="cannot be read"):
        spool.read(ID)
    (tmp_path / f"{ID}.end").write_bytes(b"{")
    assert spool.all() == ()
    spool.remove(ID)
    assert list(tmp_path.iterdir()) == []


async def test_a_service_that_reads_nothing_is_let_go_and_the_motion_goes_on(
    plant: Plant, rig: FakeRig, motion: Motion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.server._MOST_UNREAD", 1000)
    rig.duration_s = 1.0
    reader, writer = await connected(plant.service.motion_socket)
    writer.write(line_of({"id": 1, "ask": "own", "protocol": PROTOCOL}))
    await reader.readline()
    reader._transport.pause_reading()  # type: ignore[attr-defined]  # as one that hangs
    writer.write(line_of({"id": 2, "ask": "play", "order": to_json(order())}))
    await rig.moving.wait()
    for _ in range(20_000):
        if motion.moves:
            await asyncio.sleep(0.001)
    with contextlib.suppress(OSError):
        writer.close()
    assert (await motion.end_of(ID)).outcome.ended is Ended.COMPLETED
