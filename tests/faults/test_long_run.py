"""The long run of faults: which cases it has, and that one which was ended goes on where it was."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from tests.faults.__main__ import asked_for
from tests.faults.cases import FAULTS, TRANSACTIONS, WAYS, every_case
from tests.faults.judge import Verdict
from tests.faults.kept import KeptVerdicts, name_of
from tests.faults.wire_faults import WireFault


def test_the_long_run_meets_every_fault_at_every_transaction_on_every_way_once_a_round() -> None:
    cases = list(every_case(2))
    assert len({name_of(case) for case in cases}) == len(cases) == 2 * len(FAULTS) * TRANSACTIONS * len(WAYS)
    quarter = list(islice(cases, len(FAULTS) * TRANSACTIONS))
    met = {(case.fault.fault, case.fault.index) for case in quarter if case.fault is not None}
    assert len(met) == len(quarter)
    assert {(case.carrier, case.mode, case.fault.fault) for case in quarter if case.fault is not None} == {
        (*way, fault) for way in WAYS for fault in FAULTS
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
