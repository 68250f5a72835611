"""Blind cases run on all cores, each result kept as one line of JSON as soon as it is there: a run can go on later."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from types import FrameType
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from tests.bench.blind.cases import BlindCase, blind_case
from tests.bench.blind.diagnosers import DIAGNOSERS
from tests.bench.blind.grading import Answer, Grade, answer_from_json, grade
from tests.bench.blind.strengths import Expected
from tests.bench.parallel import PROCESSES

ROOT: Final = Path(__file__).parents[3]
RESULTS: Final = ROOT / "build" / "blind"
LONGEST_S: Final = 300
# What an answer depends on: the code that gives it, and that which hides something and grades.
_SOURCES: Final = ("discrepancy", "estimators", "valve", "tests/bench/blind", "tests/support/extended_reference.py")


@dataclass(frozen=True, slots=True)
class Run:
    """One case to run."""

    kind: str
    seed: int
    diagnoser: str = "product"


@dataclass(frozen=True, slots=True)
class Result:
    """One case, what was hidden in it and what was said of it; one line of a results file."""

    kind: str
    seed: int
    valve: str
    acquired: str
    waveforms: tuple[str, ...]
    samples: int
    duration_s: float
    noise_m: float
    expected: Expected
    oddity: str
    hidden: tuple[str, ...]
    strengths: tuple[float, ...]
    factors: tuple[float, ...]
    changed_m: float
    oracle_rmse_m: float
    grade: Grade
    verdict: str
    causes: tuple[str, ...]
    rivals: tuple[str, ...]
    before_m: float | None
    after_m: float | None
    gain_on: str
    estimates_s: float
    diagnosis_s: float
    message: str
    sources: str  # what ``version`` was

    @property
    def took_s(self) -> float:
        """The whole analysis, s: all methods and the diagnosis."""
        return self.estimates_s + self.diagnosis_s

    def to_line(self) -> str:
        """The result as one line of JSON."""
        return json.dumps(asdict(self))


def result_from_line(line: str) -> Result:
    """The result in one line. Raises ValueError, KeyError or TypeError where it is none."""
    values: dict[str, Any] = json.loads(line)
    for entry in fields(Result):
        if isinstance(values[entry.name], list):
            values[entry.name] = tuple(values[entry.name])
    values["expected"], values["grade"] = Expected(values["expected"]), Grade(values["grade"])
    return Result(**values)


def run_one(run: Run) -> Result:
    """Make the case, ask, and grade; an answer that is an exception or takes too long has failed."""
    case = blind_case(run.seed, run.kind)
    begun_s = time.process_time()
    took_s = (0.0, 0.0)
    try:
        signal.signal(signal.SIGPROF, _too_long)
        signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
        asked = DIAGNOSERS[run.diagnoser](case)
        answer = answer_from_json(asked.discrepancy)
        found = grade(answer, tuple(one.cause for one in case.hidden), case.expected)
        took_s = (asked.estimates_s, asked.diagnosis_s)
    except Exception as error:  # noqa: BLE001 - what must not happen is counted, and the others go on
        said = f"{type(error).__name__}: {error}".partition("\n")[0]
        answer, found = Answer("failed", (), (), message=said), Grade.FAILED
        took_s = (0.0, time.process_time() - begun_s)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return _result(case, answer, found, took_s)


def _too_long(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {LONGEST_S} s of processor time")


def _result(case: BlindCase, answer: Answer, found: Grade, took_s: tuple[float, float]) -> Result:
    return Result(
        kind=case.kind,
        seed=case.seed,
        valve=case.valve,
        acquired=str(case.acquired),
        waveforms=case.waveforms,
        samples=sum(one.samples for one in case.recordings),
        duration_s=sum(one.duration_s for one in case.recordings),
        noise_m=case.noise_m,
        expected=case.expected,
        oddity=case.oddity,
        hidden=tuple(one.cause for one in case.hidden),
        strengths=tuple(one.strength for one in case.hidden),
        factors=tuple(one.factor for one in case.hidden),
        changed_m=case.changed_m,
        oracle_rmse_m=case.oracle_rmse_m,
        grade=found,
        verdict=answer.verdict,
        causes=answer.causes,
        rivals=answer.rivals,
        before_m=answer.before_m,
        after_m=answer.after_m,
        gain_on=answer.gain_on,
        estimates_s=took_s[0],
        diagnosis_s=took_s[1],
        message=answer.message,
        sources=version(),
    )


@cache
def version() -> str:
    """Twelve digits that change with every source that an answer or its grade depends on."""
    digest = hashlib.sha256()
    for name in _SOURCES:
        place = ROOT / name
        files = [place] if place.is_file() else sorted(place.rglob("*.py"))
        for file in files:
            if not file.name.startswith("test_"):
                digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()[:12]


def results_file(diagnoser: str, folder: Path = RESULTS) -> Path:
    """Where the results of today's sources are kept."""
    return folder / f"{diagnoser}-{version()}.jsonl"


def kept_results(file: Path) -> dict[tuple[str, int], Result]:
    """Results in a file by kind and seed; a line that was cut off when a run was stopped does not count."""
    kept: dict[tuple[str, int], Result] = {}
    if not file.exists():
        return kept
    for line in file.read_text().splitlines():
        try:
            result = result_from_line(line)
        except (ValueError, KeyError, TypeError):
            continue
        kept[result.kind, result.seed] = result
    return kept


def results_of(runs: Iterable[Run], file: Path) -> list[Result]:
    """Results of these runs in their order: those in the file, and the others as they are made and added to it."""
    wanted = list(runs)
    kept = kept_results(file)
    waiting = [run for run in wanted if (run.kind, run.seed) not in kept]
    file.parent.mkdir(parents=True, exist_ok=True)
    torn = file.exists() and not file.read_bytes().endswith(b"\n") and file.stat().st_size > 0
    with file.open("a") as lines:
        if torn:
            lines.write("\n")
        for result in _made(waiting):
            lines.write(result.to_line() + "\n")
            lines.flush()
            kept[result.kind, result.seed] = result
    return [kept[run.kind, run.seed] for run in wanted]


def _made(waiting: list[Run]) -> Iterator[Result]:
    """Results as they come, with a bar."""
    if not waiting:
        return
    # one thread of linear algebra a process: more only get in each other's way
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    columns = (TextColumn("blind cases"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        if PROCESSES == 1 or len(waiting) == 1:
            for run in bar.track(waiting):
                yield run_one(run)
            return
        with ProcessPoolExecutor(min(PROCESSES, len(waiting)), mp_context=get_context("spawn")) as pool:
            made = as_completed([pool.submit(run_one, run) for run in waiting])
            for future in bar.track(made, total=len(waiting)):
                yield future.result()
