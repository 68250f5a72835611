"""Stop asks nothing but memory and the bus: no database, no thread, no unexpired session. Watching is activity."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
import time_machine
from fastapi import FastAPI

from service.access import authentication
from service.access.access import Access
from service.access.principal import Principal, Role
from service.access.stop_grants import JUST_BEFORE_S, StopGrants
from service.audit.verify import Verdict, entries_of, verify
from service.cli.accounts import accounts
from service.config.settings import load_plant
from service.http.given import part_of
from service.model.requester import RequesterKind
from service.runs.service import Runs
from service.store.store import Store
from simulator.assembly import SimulatedPlant
from simulator.record import Event, Happening
from tests.service.access.signed_in import PASSWORD, body_of, signed_in
from tests.support.databases import postgresql_database
from tests.support.fake_rig import FakeAnalyst
from tests.support.in_process import app_of
from tests.support.problem import assert_problem
from tests.support.running_service import running_application
from tests.support.stopwatch import Stopwatch
from tests.support.wired_plant import SAFE_PA, TAG, asked_pa, wired_plant

LONG = {"valve": TAG, "overrides": {"cycles": 10, "period_s": 20.0, "low_pa": 30_000.0, "high_pa": 40_000.0}}
ON_THE_WIRE_S = 0.05  # asked of a stop, beside the transaction under way


@dataclass
class Hole:
    """A way to PostgreSQL that turns black: connections stay open and are accepted, and nothing comes any more."""

    to: tuple[str, int]
    black: asyncio.Event = field(default_factory=asyncio.Event)
    again: asyncio.Event = field(default_factory=asyncio.Event)
    port: int = 0
    open: set[asyncio.StreamWriter] = field(default_factory=set)

    async def pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.open.add(writer)
        if self.black.is_set():
            await self.again.wait()
            await self._end(writer)
            return
        there, back = await asyncio.open_connection(*self.to)
        self.open.add(back)
        await asyncio.gather(self._one_way(reader, back), self._one_way(there, writer))

    async def _one_way(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(65536):
                if self.black.is_set():
                    await self.again.wait()
                writer.write(data)
        await self._end(writer)

    async def _end(self, writer: asyncio.StreamWriter) -> None:
        self.open.discard(writer)
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()

    async def end(self) -> None:
        """Let everything through and close what is left."""
        self.again.set()
        await asyncio.gather(*(self._end(writer) for writer in tuple(self.open)))


@asynccontextmanager
async def black_hole(to: tuple[str, int]) -> AsyncIterator[Hole]:
    hole = Hole(to)
    server = await asyncio.start_server(hole.pass_on, "127.0.0.1", 0)
    hole.port = server.sockets[0].getsockname()[1]
    try:
        yield hole
    finally:
        server.close()
        await hole.end()
        await server.wait_closed()


@contextmanager
def no_thread_free() -> Iterator[None]:
    """Keep every thread of the event loop's pool busy until the block ends."""
    done, loop = threading.Event(), asyncio.get_running_loop()
    for _ in range(80):
        loop.run_in_executor(None, done.wait)
    try:
        yield
    finally:
        done.set()


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not true():  # noqa: ASYNC110  - a wire sets no event
            await asyncio.sleep(0.02)


@dataclass
class Moving:
    """A test that moves a simulated valve on a wire, and the wire's record."""

    app: FastAPI
    plant: SimulatedPlant
    config: Path
    client: httpx.AsyncClient
    token: str
    test: dict[str, Any]
    csrf: str

    @property
    def runs(self) -> Runs:
        return part_of(self.app, Runs)

    @property
    def access(self) -> Access:
        return part_of(self.app, Access)

    @property
    def store(self) -> Store:
        return part_of(self.app, Store)

    async def stopped(self, **request: Any) -> tuple[httpx.Response, float]:
        """Return the answer to a Stop, and after how many seconds of ours the safe value was on the wire."""
        on_wire_s: list[float] = []
        watch = Stopwatch()

        def keep(entry: Event | tuple[float, float, float, float]) -> None:
            if isinstance(entry, Event) and entry.happening is Happening.COMMANDED and entry.pressure_pa == SAFE_PA:
                on_wire_s.append(watch.own_s)

        self.plant.records[TAG].sink = keep
        watch = Stopwatch()
        answer = await self.client.post(**{"url": f"/tests/{self.test['id']}/stop", **request})
        assert on_wire_s, answer.text
        return answer, on_wire_s[0]

    def audit(self) -> list[tuple[str, str]]:
        (path,) = (self.config.parent / "plant-data" / "audit").iterdir()
        assert verify(path).verdict is Verdict.WHOLE
        return [(entry.event, entry.who) for entry in entries_of(path)]


@asynccontextmanager
async def moving(folder: Path, database: str = "") -> AsyncIterator[Moving]:
    """Serve a valve on a wire with sign-in and start a test of it as anna, whose tablet watches it."""
    async with wired_plant(folder) as (config, plant):
        more = f'database = "{database}"\n' if database else ""
        text = config.read_text(encoding="utf-8").replace("port = 0\n", f'port = 0\naccess = "sign-in"\n{more}', 1)
        config.write_text(text, encoding="utf-8")
        secret = await asyncio.to_thread(_make_accounts, config)
        app = app_of(load_plant(config), analyst=FakeAnalyst())
        async with running_application(app) as client:
            me = body_of(await client.post("/session", json={"name": "anna", "password": PASSWORD}))
            headers = {"X-CSRF-Token": me["csrf_token"]}
            engineer = {"Authorization": f"Bearer {secret}"}
            test = body_of(await client.post("/tests/run", json=LONG, headers=engineer))
            assert (await client.get(f"/ui/tests/{test['id']}")).status_code == 200
            await until(lambda: asked_pa(plant) > 29_000.0)
            yield Moving(app, plant, config, client, secret, test, headers["X-CSRF-Token"])


def _make_accounts(config: Path) -> str:
    with accounts(config) as (access, _):
        access.add_user("anna", Role.VIEWER, PASSWORD, by="test")
        one_day = timedelta(days=1)
        _, secret = access.create_token("script", Role.ENGINEER, by="test", lasts=one_day, valves=None)
    return secret


async def test_a_stop_reaches_the_bus_while_postgresql_is_a_black_hole_and_no_thread_is_free(quick_path: Path) -> None:
    with postgresql_database() as url:
        place = httpx.URL(url.replace("postgresql+psycopg", "http"))
        async with black_hole((place.host, place.port or 5432)) as hole:
            through = url.replace(f":{place.port or 5432}", f":{hole.port}")
            async with moving(quick_path, through) as one:
                await one.access.note_known()  # as it is done every few seconds
                hole.black.set()
                reads = [asyncio.create_task(one.client.get("/valves")) for _ in range(6)]
                await asyncio.sleep(0.2)
                with no_thread_free():
                    answer, on_wire_s = await one.stopped(headers={"X-CSRF-Token": one.csrf})
                    assert on_wire_s < ON_THE_WIRE_S
                    body = body_of(answer)
                    assert body["safe_confirmed"] is True
                hole.again.set()
                await asyncio.gather(*reads, return_exceptions=True)
            assert asked_pa(one.plant) == pytest.approx(SAFE_PA, abs=10.0)
            assert ("test.stopped", "anna") in one.audit()


@pytest.mark.parametrize("how", ["session", "token", "by tag"])
async def test_a_store_whose_every_call_blocks_holds_no_stop_up(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    async with moving(quick_path) as one:
        answers = threading.Event()
        engine = one.store.engine
        connect, begin = engine.connect, engine.begin

        def blocked(call: Any) -> Any:
            return lambda *args, **more: (answers.wait(), call(*args, **more))[1]

        monkeypatch.setattr(engine, "connect", blocked(connect))
        monkeypatch.setattr(engine, "begin", blocked(begin))
        try:
            request: dict[str, Any] = {"headers": {"X-CSRF-Token": one.csrf}}
            if how != "session":
                one.client.cookies.clear()
                request = {"headers": {"Authorization": f"Bearer {one.token}"}}
            if how == "by tag":
                request["url"] = f"/valves/{TAG}/stop"
            answer, on_wire_s = await one.stopped(**request)
            assert body_of(answer)["safe_confirmed"] is True
            assert on_wire_s < ON_THE_WIRE_S
        finally:
            answers.set()
    assert ("test.stopped", "anna" if how == "session" else "script") in one.audit()


async def test_the_command_stops_with_a_token_that_this_service_has_not_seen_and_a_dead_database(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with moving(quick_path) as one:
        with accounts(one.config) as (access, _):
            _, secret = access.create_token("console", Role.VIEWER, by="test", lasts=timedelta(days=1), valves=None)
        await one.access.note_known()  # as it is done every few seconds
        answers = threading.Event()
        monkeypatch.setattr(one.store.engine, "connect", lambda *_, **__: answers.wait())
        monkeypatch.setattr(one.store.engine, "begin", lambda *_, **__: answers.wait())
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "service.cli", "stop", TAG, "--url", str(one.client.base_url)),
                env={"BREAKAWAY_TOKEN": secret, "PATH": ""},
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
            )
            out, err = await asyncio.wait_for(process.communicate(), 60.0)
            assert (process.returncode, err) == (0, b""), err
            assert b"is stopped" in out
            assert b"Signal 20 kPa, read back." in out
        finally:
            monkeypatch.undo()
            answers.set()
    assert ("test.stopped", "console") in one.audit()


async def test_an_idle_session_is_locked_and_keeps_the_stop_of_the_test_that_ran(quick_path: Path) -> None:
    async with moving(quick_path) as one:
        csrf = {"X-CSRF-Token": one.csrf}
        with time_machine.travel(datetime.now(UTC) + timedelta(minutes=16), tick=True):
            assert_problem(await one.client.get("/tests"), 401, "over")
            assert_problem(await one.client.post(f"/tests/{one.test['id']}/stop"), 403, "X-CSRF-Token")
            foreign = {**csrf, "Origin": "http://evil.example"}
            assert_problem(await one.client.post(f"/tests/{one.test['id']}/stop", headers=foreign), 403, "another site")
            assert not one.runs.at_rest(one.test["id"])
            answer, _ = await one.stopped(headers=csrf)
            assert body_of(answer)["error"] == "stopped by anna"
            await until(lambda: not one.runs.any_under_way())
            assert_problem(await one.client.post(f"/tests/{one.test['id']}/stop", headers=csrf), 401)


def test_a_grant_holds_for_the_tests_that_ran_while_its_holder_was_known_and_for_no_later_one() -> None:
    now_s = [1000.0]
    grants = StopGrants(lambda: now_s[0])
    grants.note("digest", Principal("anna", Role.VIEWER, RequesterKind.PERSON, csrf_token="secret"))
    now_s[0] = 9000.0
    held = grants.holder("digest", since_s=900.0)
    assert held == Principal("anna", Role.VIEWER, RequesterKind.PERSON)
    assert grants.holder("digest", since_s=1000.0 + JUST_BEFORE_S) == held  # the page was opened just before
    assert grants.holder("digest", since_s=1001.0 + JUST_BEFORE_S) is None
    assert grants.holder("other", since_s=0.0) is None
    grants.end_of("anna", RequesterKind.MACHINE)
    assert grants.holder("digest", since_s=900.0) == held
    grants.end_of("anna", RequesterKind.PERSON)
    assert grants.holder("digest", since_s=900.0) is None


async def test_nobody_stops_without_a_credential_that_was_known(quick_path: Path) -> None:
    async with moving(quick_path) as one:
        address = f"/tests/{one.test['id']}/stop"
        one.client.cookies.clear()
        assert_problem(await one.client.post(address), 401, "nobody is signed in")
        for headers in ({"Authorization": "Bearer breakaway_x"}, {"Cookie": "breakaway=x", "X-CSRF-Token": "x"}):
            assert_problem(await one.client.post(address, headers=headers), 401)
        assert asked_pa(one.plant) > 29_000.0


async def test_who_is_not_known_is_told_so_where_the_database_does_not_answer(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with moving(quick_path) as one:
        answers = threading.Event()
        connect = one.store.engine.connect
        monkeypatch.setattr(one.store.engine, "connect", lambda: (answers.wait(), connect())[1])
        try:
            one.client.cookies.clear()
            began_s = time.monotonic()
            answer = await one.client.post(f"/tests/{one.test['id']}/stop", headers={"Cookie": "breakaway=x"})
            assert_problem(answer, 503, "STOP IS NOT SENT", "the means at the valve itself")
            assert time.monotonic() - began_s < 8.0
        finally:
            answers.set()


@pytest.mark.parametrize("how", ["signed out", "disabled", "revoked"])
async def test_who_is_told_to_go_stops_nothing_any_more(quick_path: Path, how: str) -> None:
    async with moving(quick_path) as one:
        headers = {"X-CSRF-Token": one.csrf}
        access = one.access
        cookies = dict(one.client.cookies)
        if how == "signed out":
            assert (await one.client.delete("/session", headers=headers)).status_code == 204
            one.client.cookies.update(cookies)
        elif how == "disabled":
            access.change_user("anna", by="test", disabled=True)
        else:
            access.revoke_token(access.tokens.all()[0].id, by="test")
            one.client.cookies.clear()
            headers = {"Authorization": f"Bearer {one.token}"}
        assert_problem(await one.client.post(f"/tests/{one.test['id']}/stop", headers=headers), 401)


async def test_to_watch_a_test_keeps_the_session_open(quick_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authentication, "WATCHING_NOTED_S", 0.02)
    async with signed_in(quick_path, "operator", rig_s=60.0) as served:
        me = body_of(await served.sign_in("operator"))
        own = {"X-CSRF-Token": me["csrf_token"]}
        test = body_of(await served.client.post("/tests/run", json={"valve": TAG}, headers=own))
        stream = {"Accept": "text/event-stream"}
        began = datetime.now(UTC)
        async with served.client.stream("GET", f"{test['href']}/events", headers=stream):
            for minutes in (10, 20, 30):
                with time_machine.travel(began + timedelta(minutes=minutes), tick=True):
                    await asyncio.sleep(0.3)
        watchers = [task for task in asyncio.all_tasks() if task.get_name() == authentication.WATCHER]
        if watchers:  # a busy machine hears late that nobody watches any more
            assert not (await asyncio.wait(watchers, timeout=30.0))[1]
        await asyncio.sleep(0.1)  # a look that it had begun in a thread ends
        with time_machine.travel(began + timedelta(minutes=44), tick=True):
            background = {"X-Background": "1"}
            assert (await served.client.get("/session", headers=background)).status_code == 200
        with time_machine.travel(began + timedelta(minutes=46), tick=True):
            assert_problem(await served.client.get("/session"), 401)
        async with served.client.stream("GET", f"{test['href']}/events", headers=stream) as unwatched:
            assert unwatched.status_code == 200  # by the true clock
        body_of(await served.client.post(f"{test['href']}/stop", headers=own))
