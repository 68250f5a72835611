"""Figures from many results: how often, how surely, from which strength on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.stats import binomtest

from tests.bench.blind.cases import HELD_OUT
from tests.bench.blind.grading import Grade, is_false_name, is_right, share_of_oracle
from tests.bench.blind.runs import Result
from tests.bench.blind.strengths import MEDIUM

NAMED_SHARE = 0.95
# Fewer cases at or above a strength say nothing about 95 %.
FEWEST_ABOVE = 5
_WORSE = 1.01  # times the baseline's error on held-out data, within which it is no worse


def binomial_interval(count: int, cases: int) -> tuple[float, float]:
    """95 % interval of a share (Clopper & Pearson); 0 to 1 without a case."""
    if cases == 0:
        return 0.0, 1.0
    interval = binomtest(count, cases).proportion_ci(0.95, method="exact")
    return float(interval.low), float(interval.high)


@dataclass(frozen=True, slots=True)
class Threshold:
    """The strength from which on a cause is named, and on how much that rests."""

    strength: float | None  # None: not reached with FEWEST_ABOVE cases
    above: int  # cases at or above it
    named_above: int


def smallest_named(strengths: Sequence[float], named: Sequence[bool]) -> Threshold:
    """The strength from which on NAMED_SHARE of the cases are named, by isotonic regression over strengths."""
    order = np.argsort(np.asarray(strengths, dtype=np.float64), kind="stable")
    found = np.asarray(named, dtype=np.float64)[order]
    if found.size == 0:
        return Threshold(None, 0, 0)
    fitted = np.asarray(isotonic_regression(found).x)
    reached = np.flatnonzero(fitted >= NAMED_SHARE)
    if reached.size == 0 or found.size - reached[0] < FEWEST_ABOVE:
        return Threshold(None, 0, 0)
    first = int(reached[0])
    return Threshold(float(np.sort(strengths)[first]), int(found.size) - first, int(found[first:].sum()))


@dataclass(frozen=True, slots=True)
class Counts:
    """How the cases of a group did."""

    cases: int
    grades: Counter[Grade]
    right: int
    false_names: int

    def share(self, count: int) -> str:
        """A count with its share."""
        return f"{count} ({100.0 * count / self.cases:.1f} %)" if self.cases else "-"


def counted(results: Sequence[Result]) -> Counts:
    """How these cases did."""
    return Counts(
        len(results),
        Counter(one.grade for one in results),
        sum(is_right(one.grade, one.expected) for one in results),
        sum(is_false_name(one.grade) for one in results),
    )


def named_instead(results: Sequence[Result]) -> Counter[str]:
    """Causes that were named, or led a set, without being there."""
    named = Counter[str]()
    for one in results:
        named.update(cause for cause in one.causes if cause not in one.hidden and cause not in _listed_with_truth(one))
    return named


def _listed_with_truth(one: Result) -> tuple[str, ...]:
    """The leader of a set that holds the truth is no wrong name."""
    return one.causes[:1] if one.verdict == "ambiguous" and set(one.rivals) & set(one.hidden) else ()


def of_cause(results: Sequence[Result], cause: str, *, large: bool | None = None) -> list[Result]:
    """Those in which this cause alone is hidden; of medium or of large strength."""
    own = [one for one in results if one.hidden == (cause,)]
    return own if large is None else [one for one in own if (one.factors[0] > MEDIUM) == large]


@dataclass(frozen=True, slots=True)
class Gains:
    """Gain on held-out recordings of cases that were rightly named: shares of the oracle's; and how often worse."""

    shares: tuple[float, ...]
    measured: int  # answers of any grade with a gain on the held-out recording
    worse: int


def gains(results: Sequence[Result]) -> Gains:
    """Gains on the held-out recording."""
    shares, measured, worse = [], 0, 0
    for one in results:
        if one.before_m is None or one.after_m is None or one.gain_on != HELD_OUT:
            continue
        if one.verdict not in {"named", "ambiguous"}:
            continue
        measured += 1
        worse += one.after_m > _WORSE * one.before_m
        share = share_of_oracle(one.before_m, one.after_m, one.oracle_rmse_m)
        if share is not None and one.grade in {Grade.ALONE, Grade.IN_SET}:
            shares.append(share)
    return Gains(tuple(shares), measured, worse)
