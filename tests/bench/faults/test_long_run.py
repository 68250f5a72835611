"""The long run of faults: which cases it has, and that one which was ended goes on where it was."""

from __future__ import annotations

import asyncio
import os
import signal
from itertools import islice
from pathlib import Path

import pytest

from tests.bench.faults import __main__ as long_run
from tests.bench.faults.__main__ import asked_for
from tests.bench.faults.bench import Case
from tests.bench.faults.cases import FAULTS, TRANSACTIONS, WAYS, every_case
from tests.bench.faults.judge import Verdict
from tests.bench.faults.kept import KeptVerdicts, name_of
from tests.bench.faults.wire_faults import FaultAt, PlantFault, WireFault


def test_the_long_run_meets_every_fault_at_every_transaction_on_every_way_once_a_round() -> None:
    cases = list(every_case(2))
    assert len(cases) == 2 * len(FAULTS) * TRANSACTIONS * len(WAYS)
    # A gauge of its own is polled alone: it meets each transaction twice on each carrier.
    assert len({name_of(case) for case in cases}) == len(cases) - 2 * TRANSACTIONS * len(WAYS) // 2
    quarter = list(islice(cases, len(FAULTS) * TRANSACTIONS))
    met = {(case.fault.fault, case.fault.index) for case in quarter if case.fault is not None}
    assert len(met) == len(quarter)
    assert {(case.carrier, case.mode, case.fault.fault) for case in quarter if case.fault is not None} == {
        (*way, fault) for way in WAYS for fault in FAULTS if fault is not PlantFault.DEAD_GAUGE or "polled" in way
    }


def test_words_choose_faults_and_settings() -> None:
    asked = asked_for(["wire", "keep=a.jsonl", "for=150", "at_once=12"])
    assert {case.fault.fault for case in asked.cases if case.fault is not None} == set(WireFault)
    assert (asked.keep, asked.for_s, asked.at_once) == (Path("a.jsonl"), 150.0, 12)
    assert len(asked_for(["10000"]).cases) == 10_000
    with pytest.raises(ValueError, match="is no fault"):
        asked_for(["kil"])
    with pytest.raises(ValueError, match="is no setting"):
        asked_for(["all", "keeps=a"])


def test_what_was_judged_is_kept_though_the_run_was_killed_in_the_middle_of_a_line(tmp_path: Path) -> None:
    first, second, third = islice(every_case(), 3)
    path = tmp_path / "faults.jsonl"
    kept = KeptVerdicts(path)
    kept.add(first, Verdict("failed", unsafe=1, detail="a reason"))
    kept.add(second, Verdict("completed"))
    with path.open("a", encoding="utf-8") as file:
        file.write('{"case": "tcp')
    again = KeptVerdicts(path)
    assert again.of(first) == Verdict("failed", unsafe=1, detail="a reason")
    assert again.of(third) is None
    again.add(third, Verdict("stopped"))
    assert KeptVerdicts(path).of(third) == Verdict("stopped")


async def test_a_case_that_was_refused_before_its_fault_came_is_not_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two that are refused one met its fault; asked again, only the other one is run."""
    first, second = (
        Case("tcp", "polled", FaultAt(WireFault.ECHO, 3)),
        Case("tcp", "polled", FaultAt(WireFault.ECHO, 30)),
    )
    ran: list[Case] = []

    async def refused(case: Case, _folder: Path) -> tuple[Verdict, int]:
        ran.append(case)
        return Verdict("refused"), 4

    monkeypatch.setattr(long_run, "run_case", refused)
    for _ in range(2):
        assert await long_run._run(long_run._Asked([first, second], {}, tmp_path / "faults.jsonl")) == 0
    assert ran == [first, second, second]
    assert "1 were refused before their fault came" in capsys.readouterr().out


async def test_a_run_that_is_told_to_end_keeps_the_cases_that_run_and_begins_no_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begun: list[Case] = []

    async def ended_meanwhile(case: Case, folder: Path) -> tuple[Verdict, int]:
        begun.append(case)
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.sleep(0.0)
        return Verdict("completed"), TRANSACTIONS

    monkeypatch.setattr(long_run, "run_case", ended_meanwhile)
    path = tmp_path / "faults.jsonl"
    await long_run._run(asked_for(["50", f"keep={path}", "at_once=1"]))
    assert 1 <= len(begun) < 50
    assert all(KeptVerdicts(path).of(case) == Verdict("completed") for case in begun)
