"""The fault bench's own rule: a case counts once its fault has come."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.faults import bench
from tests.bench.faults.bench import Case, run_case
from tests.bench.faults.judge import Verdict
from tests.bench.faults.wire_faults import FaultAt, ServiceFault

CASE = Case("tcp", "polled", FaultAt(ServiceFault.TERM, 10))


@pytest.mark.parametrize(
    ("results", "runs"),
    [
        ([("refused", 0, 0), ("refused", 9, 0), ("stopped", 60, 0)], 3),  # no bus in time, twice
        ([("refused", 11, 0)], 1),  # refused because of the fault
        ([("refused", 0, 1)], 1),  # whatever is unsafe counts at once
        ([("completed", 5, 0)], 1),
        ([("refused", 0, 0)] * 9, 5),
    ],
)
async def test_a_test_that_was_refused_before_its_fault_came_is_run_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, results: list[tuple[str, int, int]], runs: int
) -> None:
    places: list[Path] = []

    async def once(_case: Case, folder: Path) -> tuple[Verdict, int]:
        outcome, transactions, unsafe = results[len(places)]
        places.append(folder)
        return Verdict(outcome, unsafe=unsafe), transactions

    monkeypatch.setattr(bench, "_run_once", once)
    verdict, transactions = await run_case(CASE, tmp_path)
    assert (verdict.outcome, transactions) == results[runs - 1][:2]
    assert len(set(places)) == len(places) == runs
