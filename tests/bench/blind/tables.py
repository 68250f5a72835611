"""The results of blind cases as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from typing import Final

import numpy as np
from rich.table import Table

from tests.bench.blind.figures import binomial_interval, counted, gains, named_instead, of_cause, smallest_named
from tests.bench.blind.grading import LARGEST_SET, Grade, is_false_name, is_right
from tests.bench.blind.kinds import KINDS
from tests.bench.blind.oddities import ODDITIES
from tests.bench.blind.runs import Result
from tests.bench.blind.strengths import STRENGTHS, Expected

LISTED: Final = 60
# The figures that are asked for, by kind.
ASKED: Final[dict[str, str]] = {
    "triangle": "alone 92 %, right 98 %, false 1 %",
    "diagnostic": "alone 90 %",
    "pair": "alone 80 %, false 3 %",
    "command": "right 88 %, false 2 %",
    "polled": "right 88 %, false 2 %",
    "healthy": "false 0.5 %",
    "odd": "false 3 %",
}
_GRADES: Final = (
    Grade.ALONE,
    Grade.IN_SET,
    Grade.PARTLY,
    Grade.WITH_OTHERS,
    Grade.WIDE_SET,
    Grade.NONE,
    Grade.UNEXPLAINED,
    Grade.WRONG,
    Grade.NOT_ASSESSED,
    Grade.FAILED,
)


def tables(results: Sequence[Result]) -> list[Table]:
    """All tables; those without a case are left out."""
    made = [
        _summary(results),
        _matrix(results),
        _thresholds(results),
        _healthy(results),
        _odd(results),
        _gains(results),
        _valves(results),
        _times(results),
        _amiss(results),
    ]
    return [table for table in made if table.row_count]


def _table(title: str, caption: str, *headings: str, left: int = 1) -> Table:
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="left" if place < left else "right")
    return table


def _kinds(results: Sequence[Result]) -> list[tuple[str, list[Result]]]:
    groups = [(kind, [one for one in results if one.kind == kind]) for kind in KINDS]
    return [(kind, own) for kind, own in groups if own]


def _summary(results: Sequence[Result]) -> Table:
    seeds = f"seeds {min(one.seed for one in results)} to {max(one.seed for one in results)}" if results else ""
    table = _table(
        f"{len(results)} blind cases, {seeds}, sources {', '.join(sorted({one.sources for one in results}))}",
        f"Alone: all that is hidden is named, nothing else. In a set: named or listed, at most {LARGEST_SET} causes. "
        "Right: the honest answer, which for what the data cannot show is none or a set. False: something is named "
        "that is not there (wrong, or with others), with the 95 % interval of its share.",
        "kind", "cases", "right", "alone", "in a set", "partly", "with others", "wide set", "none", "unexplained",
        "wrong", "not assessed", "failed", "false", "its interval", "asked",
    )  # fmt: skip
    for kind, own in _kinds(results):
        counts = counted(own)
        low, high = binomial_interval(counts.false_names, counts.cases)
        table.add_row(
            kind,
            str(counts.cases),
            counts.share(counts.right),
            counts.share(counts.grades[Grade.ALONE]),
            *(str(counts.grades[one]) for one in _GRADES[1:]),
            counts.share(counts.false_names),
            f"{100.0 * low:.1f}-{100.0 * high:.1f} %",
            ASKED.get(kind, ""),
        )
    return table


def _matrix(results: Sequence[Result]) -> Table:
    table = _table(
        "What was hidden, and what was named",
        "One cause hidden. The last column: which causes were named without being there, and how often.",
        "kind", "hidden", "cases", "alone", "in a set", "with others", "wide set", "none", "unexplained", "wrong",
        "named instead or besides", left=2,
    )  # fmt: skip
    shown = (
        Grade.ALONE,
        Grade.IN_SET,
        Grade.WITH_OTHERS,
        Grade.WIDE_SET,
        Grade.NONE,
        Grade.UNEXPLAINED,
        Grade.WRONG,
    )
    for (kind, own), cause in product(_kinds(results), STRENGTHS):
        found = of_cause(own, cause)
        if not found:
            continue
        counts = counted(found)
        instead = ", ".join(f"{name} {times}" for name, times in named_instead(found).most_common())
        table.add_row(kind, cause, str(counts.cases), *(str(counts.grades[one]) for one in shown), instead)
    return table


def _thresholds(results: Sequence[Result]) -> Table:
    table = _table(
        "Smallest strength that is named 95 % of the time",
        "Alone or in a set; isotonic regression over the strengths drawn, at least 5 cases at or above it. Drawn: from "
        "the smallest to ten times it.",
        "kind", "cause", "smallest drawn", "unit", "medium named", "large named", "named 95 % from", "cases above",
        left=2,
    )  # fmt: skip
    for (kind, own), cause in product(_kinds(results), STRENGTHS):
        found = of_cause(own, cause)
        if not found or KINDS[kind].hidden != 1:
            continue
        named = [one.grade in {Grade.ALONE, Grade.IN_SET} for one in found]
        threshold = smallest_named([one.strengths[0] for one in found], named)
        halves = []
        for large in (False, True):
            part = of_cause(found, cause, large=large)
            hits = sum(one.grade in {Grade.ALONE, Grade.IN_SET} for one in part)
            halves.append(f"{hits} of {len(part)}")
        reached = "not reached" if threshold.strength is None else f"{threshold.strength:.3g}"
        above = f"{threshold.named_above} of {threshold.above}" if threshold.above else "-"
        line = STRENGTHS[cause]
        table.add_row(kind, cause, f"{line.smallest:g}", line.unit, *halves, reached, above)
    return table


def _healthy(results: Sequence[Result]) -> Table:
    table = _table(
        "Healthy valves",
        "Falsely named with the 95 % interval of its share; unexplained is a false alarm and no name.",
        "channels", "sequence", "cases", "none", "falsely named", "its interval", "unexplained", "not assessed",
        "named", left=2,
    )  # fmt: skip
    own = [one for one in results if one.expected is Expected.NONE]
    groups: list[tuple[str, str, list[Result]]] = []
    for channels, sequence in sorted({(one.acquired, "+".join(one.waveforms)) for one in own}):
        part = [one for one in own if (one.acquired, "+".join(one.waveforms)) == (channels, sequence)]
        groups.append((channels, sequence, part))
    for channels, sequence, part in [*groups, ("all", "", own)] if own else []:
        counts = counted(part)
        low, high = binomial_interval(counts.false_names, counts.cases)
        table.add_row(
            channels,
            sequence,
            str(counts.cases),
            str(counts.grades[Grade.NONE]),
            str(counts.false_names),
            f"{100.0 * low:.1f}-{100.0 * high:.1f} %",
            str(counts.grades[Grade.UNEXPLAINED]),
            str(counts.grades[Grade.NOT_ASSESSED]),
            ", ".join(f"{name} {times}" for name, times in named_instead(part).most_common()),
        )
    return table


def _odd(results: Sequence[Result]) -> Table:
    table = _table(
        "What is in no catalogue",
        "Change: root mean square of the clean recording minus the valve's without it, median over cases, in times the "
        "noise; below about 1 none is as right as unexplained.",
        "oddity", "cases", "unexplained", "none", "misnamed", "change", "as",
    )  # fmt: skip
    for oddity in ODDITIES:
        own = [one for one in results if one.oddity == oddity]
        if own:
            counts = counted(own)
            named = ", ".join(f"{name} {times}" for name, times in named_instead(own).most_common())
            grades = counts.grades
            table.add_row(
                oddity,
                str(counts.cases),
                str(grades[Grade.UNEXPLAINED]),
                str(grades[Grade.NONE]),
                str(counts.false_names),
                f"{np.median([one.changed_m / one.noise_m for one in own]):.3g}",
                named,
            )
    return table


def _gains(results: Sequence[Result]) -> Table:
    table = _table(
        "Gain on the held-out sine",
        "Share: (before - after)/(before - oracle) of root mean square errors, where the cause was rightly named and "
        "the baseline is beyond 1.2 x the oracle. The oracle is the true model: what it leaves is the noise. Worse: "
        "answers that name something and predict more than 1 % worse than the baseline.",
        "kind", "cases", "share, median", "5 % quantile", "below 95 %", "worse than the baseline",
    )  # fmt: skip
    for kind, own in _kinds(results):
        found = gains(own)
        if not found.measured:
            continue
        shares = np.asarray(found.shares)
        row = ("-", "-", "-")
        if shares.size:
            below = int(np.count_nonzero(shares < 0.95))
            row = (f"{np.median(shares):.3f}", f"{np.quantile(shares, 0.05):.3f}", str(below))
        table.add_row(kind, str(shares.size), *row, f"{found.worse} of {found.measured}")
    return table


def _valves(results: Sequence[Result]) -> Table:
    table = _table(
        "By valve and noise",
        "Right: the honest answer. False: something is named that is not there.",
        "kind", "valve", "noise, um", "cases", "right", "false", left=2,
    )  # fmt: skip
    for kind, own in _kinds(results):
        for valve, noise_m in sorted({(one.valve, one.noise_m) for one in own}):
            counts = counted([one for one in own if (one.valve, one.noise_m) == (valve, noise_m)])
            table.add_row(
                kind,
                valve,
                f"{1.0e6 * noise_m:.0f}",
                str(counts.cases),
                counts.share(counts.right),
                str(counts.false_names),
            )
    return table


def _times(results: Sequence[Result]) -> Table:
    table = _table(
        "Times, s",
        "On one core: the exact fit, the diagnosis, and both.",
        "kind", "samples, median", "fit, median", "diagnosis, median", "both, median", "both, worst",
    )  # fmt: skip
    for kind, own in _kinds(results):
        columns: tuple[Callable[[Result], float], ...] = (
            lambda one: one.samples,
            lambda one: one.estimates_s,
            lambda one: one.diagnosis_s,
            lambda one: one.took_s,
        )
        medians = [float(np.median([value(one) for one in own])) for value in columns]
        worst_s = max(one.took_s for one in own)
        table.add_row(kind, f"{medians[0]:.0f}", *(f"{value:.3g}" for value in (*medians[1:], worst_s)))
    return table


def _amiss(results: Sequence[Result]) -> Table:
    def rank(one: Result) -> int:
        return 0 if is_false_name(one.grade) else 1 if one.grade is Grade.FAILED else 2

    amiss = sorted((one for one in results if not is_right(one.grade, one.expected)), key=rank)
    table = _table(
        f"Not right: {len(amiss)}",
        f"False names first, at most {LISTED}; a case can be made again by its kind and seed.",
        "kind", "seed", "valve", "noise, um", "hidden (times the smallest)", "grade", "said", left=99,
    )  # fmt: skip
    for one in amiss[:LISTED]:
        pairs = zip(one.hidden, one.factors, strict=True)
        hidden = one.oddity or ", ".join(f"{cause} {factor:.1f}" for cause, factor in pairs)
        table.add_row(
            one.kind, str(one.seed), one.valve, f"{1.0e6 * one.noise_m:.0f}", hidden, str(one.grade), _said(one)
        )
    return table


def _said(one: Result) -> str:
    names: Iterable[str] = one.causes
    rivals = f" or {', '.join(one.rivals)}" if one.rivals else ""
    message = one.message if one.grade in {Grade.FAILED, Grade.NOT_ASSESSED, Grade.NONE} else ""
    return f"{one.verdict} {' + '.join(names)}{rivals} {message}".strip()
