"""The analysis process: its answers, its errors, its crashes, and that nothing is left behind."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from service.workers.allowance import processor_time_s
from service.workers.analysis_process import AnalysisProcess
from tests.support.nominal_recordings import triangle_test
from valve.errors import InternalError, RecordingError
from valve.messages import Message
from valve.nameplate import Actuator, Nameplate
from valve.recording_files import write_parquet

NAMES = ["time_s", "position_m", "pressure_pa"]
PLATE = Nameplate("FV-101", Actuator(0.1016, 0.06452))

# Speaks as the real worker does; the name of the recording says what it shall do.
SCRIPT = """
import json, os, sys, time
def say(**message): print(json.dumps(message), flush=True)
say(ready=True)
for line in sys.stdin:
    job = json.loads(line)
    what = job["recordings"][0]
    say(progress=0.5, phase="half")
    if what == "crash": os._exit(3)
    if what.startswith("late"): say(estimated={"of": what, "discrepancy": {"verdict": "not_assessed", "message": ""}})
    if what == "late crash": os._exit(3)
    if what == "late hang": time.sleep(600)
    if what == "hang": time.sleep(600)
    if what == "pause": time.sleep(0.3)
    if what == "torn": sys.stdout.write('{"anal'); sys.stdout.flush(); os._exit(0)
    if what == "bad": say(error="RecordingError", message="bad.csv: wrong")
    elif what == "fault": say(error="MotionError", message="lost")
    else: say(analysis={"of": what, "tag": job["nameplate"]["tag"], "pid": os.getpid(), "all": job["recordings"],
                       "most_rows": job["most_rows"], "niceness": os.getpriority(os.PRIO_PROCESS, 0)})
"""
WORKER = (sys.executable, "-c", SCRIPT)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not true():  # noqa: ASYNC110  # another process sets no event
            await asyncio.sleep(0.01)


async def test_a_worker_is_below_the_service_before_it_has_loaded_anything() -> None:
    slow = (sys.executable, "-c", "import time; time.sleep(600)")
    async with AnalysisProcess(command=slow) as process:
        assert process.worker_pid is not None
        own = os.getpriority(os.PRIO_PROCESS, 0)
        assert os.getpriority(os.PRIO_PROCESS, process.worker_pid) > own


async def test_one_worker_answers_one_job_after_the_other() -> None:
    told: list[tuple[float, str]] = []
    async with AnalysisProcess(command=WORKER) as process:
        first, second = await asyncio.gather(
            process.analyze("a.csv", PLATE, lambda share, phase: told.append((share, phase))),
            process.analyze(Path("b.csv"), PLATE),
        )
    assert (first["of"], second["of"], first["tag"]) == ("a.csv", "b.csv", "FV-101")
    assert first["pid"] == second["pid"]
    assert first["all"] == ["a.csv"]
    assert told == [(0.0, "getting the analysis ready"), (0.5, "half")]


async def test_a_worker_that_is_telling_how_far_it_is_can_be_ended_at_any_moment() -> None:
    # its words and its end come while the job and the one who ends it both wait for them
    tells = """
import sys
print('{"ready": true}', flush=True)
sys.stdin.readline()
while True:
    print('{"progress": 0.5, "phase": "half"}', flush=True)
"""
    for pause_s in np.linspace(0.0, 2.0e-3, 12):
        process = AnalysisProcess(command=(sys.executable, "-c", tells))
        heard = asyncio.Event()

        def hear(share: float, _phase: str, heard: asyncio.Event = heard) -> None:
            if share > 0.0:
                heard.set()

        job = asyncio.create_task(process.analyze("a.csv", PLATE, hear))
        await heard.wait()
        await asyncio.sleep(float(pause_s))
        async with asyncio.timeout(20.0):
            await process.close()
        assert isinstance((await asyncio.gather(job, return_exceptions=True))[0], InternalError)


async def test_an_error_of_the_worker_arrives_as_the_same_class_and_the_worker_stays() -> None:
    async with AnalysisProcess(command=WORKER) as process:
        pid = process.worker_pid
        with pytest.raises(RecordingError, match=r"^bad\.csv: wrong$"):
            await process.analyze("bad", PLATE)
        with pytest.raises(InternalError, match="lost"):
            await process.analyze("fault", PLATE)
        assert (await process.analyze("good", PLATE))["pid"] == pid


@pytest.mark.parametrize("what", ["crash", "torn"])
async def test_a_worker_that_crashes_fails_its_job_and_is_replaced(what: str) -> None:
    async with AnalysisProcess(command=WORKER) as process:
        first = process.worker_pid
        with pytest.raises(InternalError, match="ended with code"):
            await process.analyze(what, PLATE)
        answer = await process.analyze("good", PLATE)
        assert answer["pid"] not in (None, first)


async def test_a_worker_that_is_killed_between_two_jobs_is_replaced_unnoticed() -> None:
    async with AnalysisProcess(command=WORKER) as process:
        first = (await process.analyze("good", PLATE))["pid"]
        os.kill(first, signal.SIGKILL)
        await until(lambda: not alive(first))
        assert (await process.analyze("good", PLATE))["pid"] != first


async def test_a_job_that_takes_too_long_is_ended_and_its_worker_replaced() -> None:
    async with AnalysisProcess(command=WORKER, time_limit_s=0.3) as process:
        first = process.worker_pid
        assert first is not None
        with pytest.raises(InternalError, match=r"took more than 0\.3 s"):
            await process.analyze("hang", PLATE)
        assert not alive(first)
        assert (await process.analyze("good", PLATE))["pid"] != first


@pytest.mark.parametrize(
    ("what", "reason"), [("late crash", "diagnosis_process_ended"), ("late hang", "diagnosis_too_long")]
)
async def test_a_diagnosis_that_never_ends_leaves_the_estimates(what: str, reason: str) -> None:
    async with AnalysisProcess(command=WORKER, diagnosis_limit_s=0.3) as process:
        first = process.worker_pid
        assert first is not None
        answer = await process.analyze(what, PLATE)
        assert answer["of"] == what
        assert answer["discrepancy"]["verdict"] == "not_assessed"
        message = answer["discrepancy"]["message"]
        assert isinstance(message, Message)
        assert message.code == "diagnosis_ended_early"
        assert message.values["reason"].code == reason  # type: ignore[union-attr]
        assert not alive(first)
        assert (await process.analyze("late good", PLATE))["pid"] != first


async def test_a_cancelled_job_ends_its_worker_so_that_no_late_answer_is_mistaken() -> None:
    async with AnalysisProcess(command=WORKER) as process:
        running = asyncio.Event()
        job = asyncio.create_task(process.analyze("hang", PLATE, lambda _share, _phase: running.set()))
        async with asyncio.timeout(60.0):
            await running.wait()
        job.cancel()
        with pytest.raises(asyncio.CancelledError):
            await job
        assert (await process.analyze("good", PLATE))["of"] == "good"


async def test_closing_in_the_middle_of_a_job_leaves_no_process_and_fails_the_job() -> None:
    process = AnalysisProcess(command=WORKER)
    await process.start()
    pid = process.worker_pid
    assert pid is not None
    shares: list[float] = []
    job = asyncio.create_task(process.analyze("hang", PLATE, lambda share, _phase: shares.append(share)))
    waiting = asyncio.create_task(process.analyze("good", PLATE))
    await until(lambda: 0.5 in shares)
    await process.close()
    assert not alive(pid)
    with pytest.raises(InternalError, match="ended with code"):
        await job
    with pytest.raises(InternalError, match="it was closed"):
        await waiting
    await process.close()
    assert process.worker_pid is None


async def test_a_worker_that_cannot_start_is_an_internal_error() -> None:
    async with AnalysisProcess(command=(sys.executable, "-c", "raise SystemExit(7)")) as process:
        with pytest.raises(InternalError, match="ended with code 7"):
            await process.analyze("good", PLATE)


async def test_a_worker_that_dies_at_the_moment_of_the_next_job_is_replaced_unnoticed() -> None:
    async with AnalysisProcess(command=WORKER) as process:
        first = (await process.analyze("good", PLATE))["pid"]
        os.kill(first, signal.SIGKILL)  # and no waiting: the process has not heard of it
        assert (await process.analyze("good", PLATE))["pid"] != first


OWNER = """
import asyncio
import sys
from pathlib import Path
from service.workers.analysis_process import AnalysisProcess
from tests.service.test_analysis_process import PLATE
async def main():
    async with AnalysisProcess() as process:
        print(process.worker_pid, file=sys.stderr, flush=True)
        await process.warm()
        print("ready", file=sys.stderr, flush=True)
        await process.analyze(Path({recording!r}), PLATE)
asyncio.run(main())
"""


async def test_a_worker_amid_its_work_dies_with_the_service_that_is_killed(tmp_path: Path) -> None:
    write_parquet(triangle_test(0.0005, noise_m=5.0e-6), tmp_path / "a.parquet")
    script = OWNER.format(recording=str(tmp_path / "a.parquet"))
    owner = await asyncio.create_subprocess_exec(sys.executable, "-c", script, stderr=asyncio.subprocess.PIPE)
    try:
        await _dies_with(owner)
    finally:
        if owner.returncode is None:
            owner.kill()
        await owner.wait()


async def _dies_with(owner: asyncio.subprocess.Process) -> None:
    assert owner.stderr is not None
    async with asyncio.timeout(120.0):
        worker = int(await owner.stderr.readline())
        assert await owner.stderr.readline() == b"ready\n"
    used_s = processor_time_s(worker)
    assert used_s is not None
    await until(lambda: (processor_time_s(worker) or 0.0) > used_s + 0.3)  # it computes, and reads no pipe
    for number in (signal.SIGHUP, signal.SIGQUIT, signal.SIGINT):  # as a terminal sends them to the whole group
        os.kill(worker, number)
    await asyncio.sleep(0.3)
    assert alive(worker)
    owner.kill()
    await owner.wait()
    async with asyncio.timeout(5.0):
        while alive(worker):  # noqa: ASYNC110  - another process sets no event
            await asyncio.sleep(0.02)


async def test_an_upload_that_unpacks_to_more_than_it_may_is_refused_before_or_while_it_does(tmp_path: Path) -> None:
    zeros = np.zeros(2_000_000)
    with pq.ParquetWriter(tmp_path / "a.parquet", pa.schema([(n, pa.float64()) for n in NAMES])) as writer:
        for number in range(3):
            time_s = pa.array(np.arange(number * zeros.size, (number + 1) * zeros.size, dtype=float))
            writer.write_table(pa.table([time_s, pa.array(zeros), pa.array(zeros)], names=NAMES))
    async with AnalysisProcess(most_rows=1_000_000, niceness=19) as process:
        with pytest.raises(RecordingError, match="has 6000000 rows, the most is 1000000"):
            await process.analyze(tmp_path / "a.parquet", PLATE)
    async with AnalysisProcess(most_rows=100_000_000, most_memory_bytes=100_000_000) as process:
        with pytest.raises(RecordingError, match=r"more than 0\.1 GB of memory: send fewer samples"):
            await process.analyze(tmp_path / "a.parquet", PLATE)


async def test_a_file_of_ones_own_is_understood_by_the_worker_that_uploads_have(tmp_path: Path) -> None:
    recording = triangle_test(0.01, 2.0e-6)
    assert recording.pressure_pa is not None
    columns = zip(1e3 * recording.time_s, recording.pressure_pa / 1e5, 1e3 * recording.position_m, strict=True)
    rows = "\n".join(";".join(f"{cell:.9g}".replace(".", ",") for cell in row) for row in columns)
    (tmp_path / "own").write_text(f"Zeit [ms];Druck [bar];R\u00fcckmeldung [mm]\n{rows}\n", encoding="latin-1")
    async with AnalysisProcess(most_rows=2_000_000, most_memory_bytes=2_000_000_000) as process:
        with pytest.raises(RecordingError, match="no text in UTF-8"):
            await process.analyze(tmp_path / "own", PLATE)
        analysis = await process.analyze(tmp_path / "own", PLATE, mapping={})
    assert [one["column"] for one in analysis["recording"]["understood"][0]["columns"]] == [
        "time_s", "pressure_pa", "position_m",
    ]  # fmt: skip
    assert analysis["recording"]["samples"] == recording.samples
