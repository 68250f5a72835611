"""The grader, asked about answers that are known to be right, silent or wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bench.blind import runs
from tests.bench.blind.__main__ import main, planned
from tests.bench.blind.cases import HELD_OUT
from tests.bench.blind.figures import binomial_interval, counted, gains, named_instead, smallest_named
from tests.bench.blind.grading import (
    LARGEST_SET,
    Answer,
    Grade,
    answer_from_json,
    grade,
    is_false_name,
    share_of_oracle,
)
from tests.bench.blind.kinds import KINDS
from tests.bench.blind.runs import Result, Run, kept_results, result_from_line, results_of, run_one
from tests.bench.blind.strengths import Expected
from tests.bench.blind.tables import tables

ONE, TWO = ("vibration",), ("vibration", "position_lag")
WIDE = ("vibration", "presliding", "flow_force", "position_lag", "friction_drift")


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch, unmoved: None) -> None:
    """With cases in which nothing moves: the answers here do not look at them."""
    monkeypatch.setattr(runs, "PROCESSES", 1)


def asked(diagnoser: str, count: int = 2) -> list[Result]:
    return [run_one(Run(kind, seed, diagnoser)) for kind in KINDS for seed in range(count)]


@pytest.mark.parametrize(
    ("answer", "hidden", "expected", "grade_"),
    [
        (Answer("named", ONE, ()), ONE, Expected.NAMED, Grade.ALONE),
        (Answer("named", TWO, ()), ONE, Expected.NAMED, Grade.WITH_OTHERS),
        (Answer("named", TWO[::-1], ()), TWO, Expected.NAMED, Grade.ALONE),
        (Answer("named", ONE, ()), TWO, Expected.NAMED, Grade.PARTLY),
        (Answer("named", ("presliding",), ()), ONE, Expected.NAMED, Grade.WRONG),
        (Answer("named", ("presliding", "vibration"), ()), TWO, Expected.NAMED, Grade.WRONG),
        (Answer("ambiguous", ("presliding",), ONE), ONE, Expected.NAMED, Grade.IN_SET),
        (Answer("ambiguous", ONE, ("presliding",)), ONE, Expected.NAMED, Grade.IN_SET),
        (Answer("ambiguous", ("presliding", "position_lag"), ONE), ONE, Expected.NAMED, Grade.WITH_OTHERS),
        (Answer("ambiguous", ("presliding", "position_lag"), ONE), TWO, Expected.NAMED, Grade.IN_SET),
        (Answer("ambiguous", ("presliding",), ("flow_force",)), ONE, Expected.NAMED, Grade.WRONG),
        (Answer("ambiguous", ("presliding",), WIDE), ONE, Expected.NAMED, Grade.WIDE_SET),
        (Answer("none", (), ()), ONE, Expected.NAMED, Grade.NONE),
        (Answer("unexplained", (), ()), ONE, Expected.NAMED, Grade.UNEXPLAINED),
        (Answer("named", ONE, ()), (), Expected.NONE, Grade.WRONG),
        (Answer("ambiguous", ONE, ("presliding",)), (), Expected.UNEXPLAINED, Grade.WRONG),
        (Answer("named", ONE, ()), ONE, Expected.SET, Grade.WRONG),
        (Answer("named", ONE, ()), ONE, Expected.HIDDEN, Grade.ALONE),
        (Answer("not_assessed", (), ()), ONE, Expected.NAMED, Grade.NOT_ASSESSED),
        (Answer("named", (), ()), ONE, Expected.NAMED, Grade.FAILED),
    ],
)
def test_an_answer_has_the_grade_that_it_deserves(
    answer: Answer, hidden: tuple[str, ...], expected: Expected, grade_: Grade
) -> None:
    assert grade(answer, hidden, expected) is grade_


def test_one_that_knows_is_always_right_and_gains_all() -> None:
    results = asked("oracle")
    counts = counted(results)
    assert counts.right == counts.cases
    assert counts.false_names == 0
    found = gains(results)
    assert found.worse == 0
    assert found.shares == pytest.approx([1.0] * len(found.shares))
    assert len(found.shares) >= 10


def test_one_that_never_sees_anything_is_right_where_there_is_nothing_to_see() -> None:
    results = asked("always_none")
    assert {one.grade for one in results} == {Grade.NONE}
    to_be_seen = [one for one in results if one.expected is Expected.NAMED]
    assert counted(to_be_seen).right == 0
    assert counted(results).right == len(results) - len(to_be_seen)
    assert {one.kind for one in to_be_seen} == set(KINDS) - {"healthy", "odd", "hidden", "no_bench_set"}


def test_one_that_is_always_wrong_is_never_right() -> None:
    results = asked("always_wrong")
    counts = counted(results)
    assert counts.right == 0
    assert counts.false_names == counts.cases
    assert sum(named_instead(results).values()) == counts.cases


def test_one_that_lists_everything_gets_nothing_for_it() -> None:
    results = [one for one in asked("always_all") if one.hidden]
    assert {one.grade for one in results} == {Grade.WIDE_SET}
    assert counted(results).right == 0


def test_an_exception_and_a_broken_answer_are_failures() -> None:
    result = run_one(Run("triangle", 1, "raising"))
    assert result.grade is Grade.FAILED
    assert "no answer" in result.message
    with pytest.raises(KeyError):
        answer_from_json({"verdict": "named"})


def test_a_set_of_the_largest_size_still_counts() -> None:
    rivals = tuple(cause for cause in WIDE if cause != "presliding")[: LARGEST_SET - 1]
    assert grade(Answer("ambiguous", ("presliding",), rivals), ONE, Expected.NAMED) is Grade.IN_SET


def test_only_what_is_not_there_is_a_false_name() -> None:
    assert {one for one in Grade if is_false_name(one)} == {Grade.WRONG, Grade.WITH_OTHERS}


def test_the_smallest_strength_is_the_one_from_which_on_all_are_named() -> None:
    strengths = [8.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    named = [True, False, True, False, True, True, True, True]
    found = smallest_named(strengths, named)
    assert (found.strength, found.above, found.named_above) == (4.0, 5, 5)
    assert smallest_named(strengths[:4], [True] * 4).strength is None, "too few to say"
    assert smallest_named(strengths, [False] * 8).strength is None
    many = list(np.linspace(1.0, 10.0, 100))
    missed_one = smallest_named(many, [value > 4.0 and value != many[60] for value in many])
    assert missed_one.strength is not None
    assert 4.0 < missed_one.strength <= many[61]


def test_the_interval_of_none_in_three_hundred_ends_at_one_percent() -> None:
    low, high = binomial_interval(0, 300)
    assert low == 0.0
    assert high == pytest.approx(1.0 - 0.025 ** (1.0 / 300.0))
    assert binomial_interval(0, 0) == (0.0, 1.0)


def test_the_gain_is_a_share_of_what_the_true_model_gains() -> None:
    assert share_of_oracle(100.0e-6, 20.0e-6, 20.0e-6) == pytest.approx(1.0)
    assert share_of_oracle(100.0e-6, 60.0e-6, 20.0e-6) == pytest.approx(0.5)
    assert share_of_oracle(22.0e-6, 20.0e-6, 20.0e-6) is None


def test_a_result_comes_back_from_its_line() -> None:
    result = run_one(Run("pair", 5, "oracle"))
    assert result_from_line(result.to_line()) == result
    assert result.gain_on == HELD_OUT


def test_a_run_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "results.jsonl"
    some = [Run("triangle", seed, "oracle") for seed in range(3)]
    first = results_of(some, file)
    file.write_text(file.read_text()[:-20])  # the last line was being written
    done: list[Run] = []

    def counting(run: Run) -> Result:
        done.append(run)
        return run_one(run)

    monkeypatch.setattr(runs, "run_one", counting)
    more = results_of([*some, Run("healthy", 9, "oracle")], file)
    assert [run.seed for run in done] == [2, 9]
    assert more[:3] == first
    assert len(kept_results(file)) == 4


def test_the_words_of_the_command_make_the_runs() -> None:
    runs_ = planned(["odd", "3", "healthy", "2"], 100, "product")
    assert sorted((run.kind, run.seed) for run in runs_) == [
        ("healthy", 100),
        ("healthy", 101),
        ("odd", 100),
        ("odd", 101),
        ("odd", 102),
    ]
    tenth = planned(["190"], 0, "product")
    assert {run.kind for run in tenth} == set(KINDS)
    assert {run.kind for run in tenth[:20]} > {"triangle", "healthy", "diagnostic"}, "a part is a sample of all"
    assert len(planned([], 0, "product")) == sum(kind.cases for kind in KINDS.values())
    with pytest.raises(ValueError, match="triangles"):
        planned(["triangles"], 0, "product")


def test_the_command_prints_its_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "results.jsonl"
    words = ["triangle", "2", "odd", "1", "healthy", "1", "--ask", "always_wrong", "--results", str(file)]
    assert main([*words, "--markdown"]) == 0
    printed = capsys.readouterr().out
    for heading in ("blind cases", "What was hidden, and what was named", "Healthy valves", "Times, s", "Not right: 4"):
        assert heading in printed
    assert main(["--shown", "--results", str(file)]) == 0
    assert main(["nonsense"]) == 2
    assert tables([])[:1] == []
