"""What an answer to a blind case is worth: the causes that it names beside those that are hidden."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

from tests.bench.blind.strengths import Expected

# A set says something only while it is small: with more causes than this the fitter is as wise as before.
LARGEST_SET: Final = 4


class Grade(StrEnum):
    """How an answer does."""

    ALONE = "alone"  # all that is hidden is named, nothing else
    IN_SET = "in a set"  # all that is hidden is named or listed, nothing else is named for sure
    PARTLY = "partly"  # a part of what is hidden is named, nothing else
    WITH_OTHERS = "with others"  # all that is hidden is named, and what is not there besides
    WIDE_SET = "in a wide set"  # a set of more than LARGEST_SET
    NONE = "none"
    UNEXPLAINED = "unexplained"
    WRONG = "wrong"  # something is named that is not there, or a guess is called a name
    NOT_ASSESSED = "not assessed"
    FAILED = "failed"  # no answer: an exception, or too long


# What an honest answer to each expectation is; naming what cannot be told from its rival is a guess.
_RIGHT: Final[dict[Expected, frozenset[Grade]]] = {
    Expected.NAMED: frozenset((Grade.ALONE, Grade.IN_SET)),
    Expected.SET: frozenset((Grade.IN_SET, Grade.NONE)),
    Expected.HIDDEN: frozenset((Grade.ALONE, Grade.IN_SET, Grade.PARTLY, Grade.NONE)),
    Expected.NONE: frozenset((Grade.NONE,)),
    Expected.UNEXPLAINED: frozenset((Grade.UNEXPLAINED, Grade.NONE)),
}
_FALSE: Final = frozenset((Grade.WRONG, Grade.WITH_OTHERS))


@dataclass(frozen=True, slots=True)
class Answer:
    """What was said of a case: the contract's ``discrepancy`` object, as far as grading needs it."""

    verdict: str
    causes: tuple[str, ...]
    rivals: tuple[str, ...]
    before_m: float | None = None
    after_m: float | None = None
    gain_on: str = ""
    message: str = ""

    @property
    def named(self) -> tuple[str, ...]:
        """Causes that are named, for sure or probably."""
        if self.verdict in {"named", "likely"}:
            return self.causes
        return self.causes[1:] if self.verdict == "ambiguous" else ()

    @property
    def listed(self) -> tuple[str, ...]:
        """The set of an ambiguous answer: its first cause and what that is not told apart from."""
        return (*self.causes[:1], *self.rivals) if self.verdict == "ambiguous" else ()


def answer_from_json(discrepancy: Mapping[str, Any]) -> Answer:
    """The answer in a ``discrepancy`` object. Raises KeyError where it breaks the contract."""
    gain = discrepancy.get("gain") or {}
    return Answer(
        str(discrepancy["verdict"]),
        tuple(str(entry["cause"]) for entry in discrepancy["causes"]),
        tuple(str(name) for name in discrepancy["not_told_apart_from"]),
        gain.get("rmse_before_m"),
        gain.get("rmse_after_m"),
        str(gain.get("held_out") or ""),
        str(discrepancy.get("message") or ""),
    )


def grade(answer: Answer, hidden: tuple[str, ...], expected: Expected) -> Grade:
    """How this answer does where ``hidden`` is in the recording."""
    if answer.verdict in {"none", "unexplained"}:
        return Grade(answer.verdict)
    if answer.verdict == "not_assessed":
        return Grade.NOT_ASSESSED
    if answer.verdict not in {"named", "likely", "ambiguous"} or not answer.causes:
        return Grade.FAILED
    truth, named, listed = set(hidden), set(answer.named), set(answer.listed)
    if listed and not listed & truth:
        return Grade.WRONG
    if named - truth:
        return Grade.WITH_OTHERS if truth and truth <= named | listed else Grade.WRONG
    if not truth <= named | listed:
        return Grade.PARTLY
    if listed:
        return Grade.IN_SET if len(listed) <= LARGEST_SET else Grade.WIDE_SET
    return Grade.WRONG if expected is Expected.SET else Grade.ALONE


def is_right(found: Grade, expected: Expected) -> bool:
    """Whether this is an honest answer to what was asked."""
    return found in _RIGHT[expected]


def is_false_name(found: Grade) -> bool:
    """Whether something was named for sure that is not there: it sends a fitter to the wrong part."""
    return found in _FALSE


def share_of_oracle(before_m: float, after_m: float, oracle_m: float) -> float | None:
    """Gain on the held-out recording as a share of the true model's, of root mean square errors.

    (before - after) / (before - oracle); None where the baseline is within a fifth of the oracle: nothing to gain.
    """
    if before_m < 1.2 * oracle_m:
        return None
    return (before_m - after_m) / (before_m - oracle_m)
