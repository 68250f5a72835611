"""Baselines of an earlier engine: analysed again from their recordings, once, behind everything else, with an audit."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.motion.audit_log import AuditLog
from service.audit.verify import entries_of
from service.config.plant import Plant
from service.model.analysis import ENGINE
from service.model.run import Run, RunState
from service.runs.renewal import RENEWAL, Renewal
from service.runs.service import Runs
from service.runs.tasks import Background
from service.store.schema_health import FIGURES
from service.store.store import Store
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import motion_on
from valve.errors import RecordingError


class _Counting(FakeAnalyst):
    """Answers at once; ``failure`` is raised instead where there is one."""

    def __init__(self) -> None:
        super().__init__()
        self.failure: Exception | None = None

    async def analyze(self, *args: Any, **more: Any) -> dict[str, Any]:
        answer = await super().analyze(*args, **more)
        if self.failure is not None:
            raise self.failure
        return answer


class _Service:
    """Runs with one tested valve whose test is its baseline, analysed by an earlier engine."""

    def __init__(self, plant: Plant) -> None:
        self.plant, self.store, self.rig, self.analyst = plant, Store(plant.service.store), FakeRig(), _Counting()
        self.audit = AuditLog(self.store.folder / "audit", "gateway")
        self.runs = Runs(
            plant,
            self.store,
            motion_on(plant, self.rig, self.audit, folder=self.store.folder),
            self.analyst,
            software="breakaway 0",
            audit=self.audit,
        )
        self.renewal = Renewal(plant, self.store, self.runs, first_s=0.0, rest_s=0.01)

    async def tested(self, *, engine: int | None = None) -> Run:
        run = await self.runs.wait((await self.runs.start("FV-101", "triangle", {})).id, 20.0)
        assert run.analysis is not None
        assert run.analysis["engine"] == ENGINE
        self.store.figures.set_baseline(run, "anna")
        older = {key: value for key, value in run.analysis.items() if key != "engine"}
        older |= {} if engine is None else {"engine": engine}
        self.store.runs.change(run.id, {"analysis": older})
        self.analyst.asked.clear()
        return run

    @property
    def baselines(self) -> list[str]:
        return [test for _, test in self.store.figures.baselines_before(ENGINE)]


@pytest.fixture
def service(plant: Plant) -> Iterator[_Service]:
    one = _Service(plant)
    yield one
    one.store.close()


async def test_a_baseline_of_an_earlier_engine_is_analysed_again_once_and_stays_the_baseline(service: _Service) -> None:
    run = await service.tested()
    later = await service.runs.wait((await service.runs.start("FV-101", "triangle", {})).id, 20.0)
    service.analyst.asked.clear()
    assert service.baselines == [run.id]
    for _ in range(2):
        await service.renewal.renew()
    await Renewal(service.plant, service.store, service.runs, rest_s=0.01).renew()  # as after the next start
    assert len(service.analyst.asked) == 1
    assert service.baselines == []
    renewed = service.store.runs.get(run.id)
    assert renewed.state is RunState.COMPLETED
    assert renewed.analysis is not None
    assert renewed.analysis["engine"] == ENGINE
    assert renewed.analysis["repeated"]["by"] == RENEWAL.name
    baseline = service.store.figures.baseline("FV-101")
    assert baseline is not None
    assert (baseline.test.test_id, baseline.set_by) == (run.id, "anna")
    assert service.store.runs.last_completed("FV-101") == service.store.runs.get(later.id)
    entries = [one for one in entries_of(service.audit.path) if one.event == "analysis.repeated"]
    assert [(one.who, one.test) for one in entries] == [(RENEWAL.name, run.id)]
    await service.runs.shut_down()


async def test_a_baseline_of_this_engine_or_one_that_was_withdrawn_is_left_alone(service: _Service) -> None:
    withdrawn = await service.tested()
    newer = await service.runs.wait((await service.runs.start("FV-101", "triangle", {})).id, 20.0)
    service.store.figures.set_baseline(newer, "anna")
    service.analyst.asked.clear()
    await service.renewal.renew()
    assert service.analyst.asked == []
    with service.store.engine.connect() as connection:
        stored = connection.execute(FIGURES.select().where(FIGURES.c.test_id == withdrawn.id)).one()
    assert stored.engine is None
    await service.runs.shut_down()


async def test_it_waits_until_no_test_is_under_way(service: _Service) -> None:
    run = await service.tested()
    service.rig.duration_s = 1.0
    service.rig.moving.clear()
    busy = await service.runs.start("FV-102", "triangle", {})
    await service.rig.moving.wait()
    renewing = asyncio.create_task(service.renewal.renew())
    await service.runs.rest(busy.id)
    assert service.analyst.asked == [], "nothing is analysed while a valve moves"
    await service.runs.wait(busy.id, 20.0)
    await asyncio.wait_for(renewing, 20.0)
    assert service.baselines == []
    assert service.store.runs.get(run.id).state is RunState.COMPLETED
    await service.runs.shut_down()


async def test_one_that_fails_keeps_its_former_result_and_is_not_tried_for_ever(service: _Service) -> None:
    run = await service.tested()
    service.analyst.failure = RecordingError("a.parquet: it is not what it was")
    for _ in range(3):
        await service.renewal.renew()
    assert len(service.analyst.asked) == 1
    kept = service.store.runs.get(run.id)
    assert kept.state is RunState.COMPLETED
    assert kept.analysis is not None
    assert "the former result stands" in kept.error
    await service.runs.shut_down()


async def test_a_baseline_whose_recording_was_removed_stays(service: _Service) -> None:
    run = await service.tested()
    service.store.recording_path(run.id).unlink()
    await service.renewal.renew()
    assert service.analyst.asked == []
    assert service.store.runs.get(run.id).state is RunState.COMPLETED
    await service.runs.shut_down()


async def test_the_service_begins_by_itself_and_ends_it_at_once(service: _Service) -> None:
    await service.tested()
    service.renewal.start()
    async with asyncio.timeout(20.0):
        while service.baselines:  # noqa: ASYNC110  - it is looked at from outside
            await asyncio.sleep(0.02)
    await asyncio.wait_for(service.renewal.close(), 20.0)
    await service.runs.shut_down()


async def test_work_that_swallows_a_cancellation_is_ended_all_the_same() -> None:
    began = asyncio.Event()

    async def work() -> None:
        with contextlib.suppress(asyncio.CancelledError):  # as asyncio.wait_for of Python 3.11 may
            began.set()
            await asyncio.sleep(60.0)
        await asyncio.sleep(60.0)

    background = Background(work)
    background.start()
    await began.wait()
    await asyncio.wait_for(background.close(), 20.0)
