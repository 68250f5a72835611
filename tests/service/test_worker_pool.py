from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from service.model.refusals import ThrottledError
from service.workers.polling import Polling
from service.workers.worker_pool import MOST_UPLOADED_ROWS, MOST_UPLOADS, WorkerPool
from tests.service.test_analysis_process import PLATE, WORKER, alive, until
from valve.errors import InternalError


async def test_jobs_that_come_together_are_done_side_by_side_and_others_by_the_first_worker() -> None:
    pool = WorkerPool(2, command=WORKER)
    pool.start()
    alone = [(await pool.analyze(name, PLATE))["pid"] for name in ("a.csv", "b.csv")]
    assert alone == [pool.worker_pids[0]] * 2
    together = await asyncio.gather(*(pool.analyze(name, PLATE) for name in ("a.csv", "b.csv", "c.csv")))
    assert [answer["of"] for answer in together] == ["a.csv", "b.csv", "c.csv"]
    assert {answer["pid"] for answer in together} == set(pool.worker_pids)
    await pool.close()


async def test_the_workers_start_one_after_the_other_before_they_are_needed(tmp_path: Path) -> None:
    """Each says in a file when it starts and, a moment later, that it is ready."""
    said = tmp_path / "said"
    script = f"""
import sys, time
def say(word):
    with open({str(said)!r}, "a") as file: print(word, file=file)
say("starts"); time.sleep(0.2); say("ready")
print('{{"ready": true}}', flush=True)
sys.stdin.read()
"""
    pool = WorkerPool(2, command=(sys.executable, "-c", script), warm_after_s=0.1)
    pool.start()
    assert pool.worker_pids == [None, None]  # what the caller goes on with is first
    await until(lambda: said.exists() and said.read_text(encoding="utf-8").count("ready") == 2)
    assert said.read_text(encoding="utf-8").split() == ["starts", "ready"] * 2
    await pool.close()


async def test_a_hanging_job_leaves_the_other_worker_to_others_and_ends_with_the_pool() -> None:
    pool = WorkerPool(2, command=WORKER)
    pool.start()
    hanging = asyncio.create_task(pool.analyze("hang", PLATE))
    await asyncio.sleep(0)  # it takes its worker
    async with asyncio.timeout(60.0):
        answer = await pool.analyze("good", PLATE)
    assert answer["pid"] == pool.worker_pids[1]
    pids = [pid for pid in pool.worker_pids if pid is not None]
    await pool.close()
    assert not any(alive(pid) for pid in pids)
    await asyncio.gather(hanging, return_exceptions=True)
    assert hanging.exception() is not None


@pytest.mark.parametrize(("cores", "workers", "at_once"), [(1, 1, 1), (2, 2, 1), (4, 4, 3), (8, 4, 4)])
async def test_while_a_valve_is_polled_the_analyses_leave_it_a_core(cores: int, workers: int, at_once: int) -> None:
    polling = Polling()
    pool = WorkerPool(workers, command=WORKER, polling=polling, cores=cores)
    with polling.motion():
        jobs = [asyncio.create_task(pool.analyze("hang", PLATE)) for _ in range(workers + 1)]
        await _settled()
        assert sum(pool._jobs) == at_once
        assert max(pool._jobs) == 1
    await _settled()
    assert pool._jobs == [1] * workers
    await pool.close()
    assert all(isinstance(end, InternalError) for end in await asyncio.gather(*jobs, return_exceptions=True))


async def test_while_a_valve_is_polled_no_further_worker_is_started() -> None:
    polling = Polling()
    pool = WorkerPool(2, command=WORKER, polling=polling, cores=2)
    pool.start()
    with polling.motion():
        await pool.analyze("good", PLATE)  # by the first, which is warm then
        await _settled()
        assert pool.worker_pids.count(None) == 1
    await until(lambda: pool.worker_pids.count(None) == 0)
    await pool.close()


async def test_a_job_that_waited_for_the_polling_begins_when_the_one_before_has_ended() -> None:
    polling = Polling()
    pool = WorkerPool(2, command=WORKER, polling=polling, cores=2)
    with polling.motion():
        answers = await asyncio.gather(*(pool.analyze(name, PLATE) for name in ("a.csv", "b.csv", "c.csv")))
    assert [answer["of"] for answer in answers] == ["a.csv", "b.csv", "c.csv"]
    assert {answer["pid"] for answer in answers} == {pool.worker_pids[0]}
    await pool.close()


async def test_two_motions_that_overlap_are_one_time_of_polling() -> None:
    polling = Polling()
    with polling.motion():
        with polling.motion():
            assert polling.goes_on
        assert polling.goes_on
    assert not polling.goes_on


async def _settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_uploads_are_analysed_one_at_a_time_beside_the_workers_of_real_tests() -> None:
    pool = WorkerPool(2, command=WORKER, cores=2)
    pool.start()
    uploads = await asyncio.gather(*(pool.analyze(name, PLATE, upload=True) for name in ("a.csv", "b.csv")))
    assert len({answer["pid"] for answer in uploads}) == 1
    own = (await pool.analyze("c.csv", PLATE))["pid"]
    assert own != uploads[0]["pid"]
    assert [(answer["most_rows"], answer["niceness"]) for answer in uploads] == [(MOST_UPLOADED_ROWS, 19)] * 2
    await pool.close()
    assert not alive(uploads[0]["pid"])


async def test_an_upload_begins_behind_every_test_that_waits_and_keeps_none_of_them_waiting() -> None:
    pool = WorkerPool(1, command=WORKER, cores=1)
    test, later = (asyncio.create_task(pool.analyze("pause", PLATE)) for _ in range(2))
    await _settled()
    order: list[asyncio.Task[Any]] = []
    upload = asyncio.create_task(pool.analyze("upload.csv", PLATE, upload=True))
    for task in (upload, later, test):
        task.add_done_callback(order.append)
    await asyncio.gather(test, later, upload)
    assert order == [test, later, upload]
    hanging = asyncio.create_task(pool.analyze("hang", PLATE, upload=True))
    await until(pool._upload_turn.locked)
    async with asyncio.timeout(60.0):
        assert (await pool.analyze("good", PLATE))["of"] == "good"
    await pool.close()
    assert isinstance((await asyncio.gather(hanging, return_exceptions=True))[0], InternalError)


async def test_no_more_uploads_wait_than_somebody_would_wait_for() -> None:
    pool = WorkerPool(1, command=WORKER, cores=1)
    uploads = [asyncio.create_task(pool.analyze("hang", PLATE, upload=True)) for _ in range(MOST_UPLOADS)]
    await _settled()
    with pytest.raises(ThrottledError, match="the most is 8: try again later"):
        await pool.analyze("one more", PLATE, upload=True)
    await pool.close()
    ends = await asyncio.gather(*uploads, return_exceptions=True)
    assert all(isinstance(end, InternalError) for end in ends)


async def test_what_is_behind_begins_when_no_test_waits_by_a_worker_of_its_own_and_keeps_none_waiting() -> None:
    pool = WorkerPool(2, command=WORKER, cores=2)
    tests = [asyncio.create_task(pool.analyze("pause", PLATE)) for _ in range(3)]
    await _settled()
    order: list[asyncio.Task[Any]] = []
    behind = [asyncio.create_task(pool.analyze("behind.csv", PLATE, behind=True)) for _ in range(2)]
    for task in (*tests, *behind):
        task.add_done_callback(order.append)
    answers = await asyncio.gather(*tests, *behind)
    assert set(order[:2]) <= set(tests)
    assert {answer["pid"] for answer in answers[3:]}.isdisjoint(answer["pid"] for answer in answers[:3])
    assert {answer["niceness"] for answer in answers[3:]} == {19}
    hanging = asyncio.create_task(pool.analyze("hang", PLATE, behind=True))
    await _settled()
    async with asyncio.timeout(60.0):
        assert (await pool.analyze("good", PLATE))["of"] == "good"
    await pool.close()
    await asyncio.gather(hanging, return_exceptions=True)


async def test_a_worker_behind_ends_when_nobody_has_needed_it_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.workers.worker_pool._REST_AFTER_S", 0.05)
    pool = WorkerPool(2, command=WORKER, cores=2)
    pid = (await pool.analyze("a.csv", PLATE, behind=True))["pid"]
    await until(lambda: not alive(pid))
    assert (await pool.analyze("b.csv", PLATE, behind=True))["pid"] != pid
    await pool.close()
