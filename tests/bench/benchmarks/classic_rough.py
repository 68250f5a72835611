"""The two classic methods on valves as real ones are: what is given, whether intervals hold, and how wide they are."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from estimators.base import Estimate, Status, student_95
from estimators.registry import estimator
from tests.bench.parallel import each
from tests.support.rough_valves import GRADES, SEQUENCES, VALVES, RoughCase, case

METHODS: Final = ("regression", "garcia")
SYMBOLS: Final = ("k", "F_c", "F_s", "F_0", "m", "F_v")
SEEDS: Final = 6
FIRST_SEED: Final = 100  # the seeds below it are for development
CONDITIONS: Final = tuple((grade, period_s) for period_s in (1.0e-3, 20.0e-3) for grade in GRADES)
BADLY_OFF: Final = 2.0  # half widths


@dataclass(frozen=True, slots=True)
class Judged:
    """One parameter of one estimate: error and half width in percent, of the signal's force range for F_0.

    ``by_repeats`` is the half width over that which breakaways alone allow, t(n - 1) scatter / sqrt(n), of F_s.
    """

    method: str
    symbol: str
    is_ok: bool
    given: bool
    error: float = math.nan
    half_width: float = math.nan
    by_repeats: float = math.nan

    @property
    def holds(self) -> bool:
        """Whether the interval holds the truth."""
        return abs(self.error) <= self.half_width


def judged(asked: tuple[str, str, str, float, int]) -> list[Judged]:
    """Return what both methods say of one case beside its truth."""
    valve, sequence, grade, period_s, seed = asked
    one = case(valve, sequence, grade, period_s, seed)
    estimates = [estimator(method).estimate(one.recording, one.nameplate) for method in METHODS]
    return [_judged(one, estimate, symbol) for estimate in estimates for symbol in SYMBOLS]


def _judged(one: RoughCase, estimate: Estimate, symbol: str) -> Judged:
    entry = estimate.parameters[symbol]
    is_ok = estimate.status is Status.OK
    if entry.value is None or entry.ci95 is None:
        return Judged(estimate.method, symbol, is_ok, given=False)
    truth = one.truth.parameters.by_symbol()[symbol]
    scale = 0.01 * (_range_n(one) if symbol == "F_0" else truth)
    half = 0.5 * (entry.ci95[1] - entry.ci95[0])
    # an interval may lie to one side of its value
    middle = 0.5 * (entry.ci95[1] + entry.ci95[0])
    ratio = math.nan
    count = one.truth.breakaways_s.size
    if symbol == "F_s" and count > 1 and one.truth.static_spread_n > 0.0:
        ratio = half / (student_95(count - 1.0) * one.truth.static_spread_n / math.sqrt(count))
    return Judged(estimate.method, symbol, is_ok, True, (middle - truth) / scale, half / scale, ratio)


def _range_n(one: RoughCase) -> float:
    area_m2, signal = one.nameplate.actuator.diaphragm_area_m2, one.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    return area_m2 * (signal.range_pa[1] - signal.range_pa[0])


def run(count: int | None) -> list[Table]:
    """Return one table a sampling period: by grade, sequence, method and parameter; ``count`` seeds of each valve."""
    seeds = range(FIRST_SEED, FIRST_SEED + (count or SEEDS))
    groups = [(period_s, grade, sequence) for grade, period_s in CONDITIONS for sequence in SEQUENCES]
    cases = [
        (valve, sequence, grade, period_s, seed)
        for period_s, grade, sequence in groups
        for valve in VALVES
        for seed in seeds
    ]
    found: dict[tuple[float, str, str], list[Judged]] = defaultdict(list)
    for asked, answers in zip(cases, each(judged, cases, "classic_rough"), strict=True):
        found[asked[3], asked[2], asked[1]] += answers
    periods = sorted({period_s for period_s, _, _ in groups})
    return [_table(found, period_s, len(seeds)) for period_s in periods]


def _table(found: dict[tuple[float, str, str], list[Judged]], period_s: float, seeds: int) -> Table:
    table = Table(
        title=f"Classic methods on rough valves, {1e3 * period_s:g} ms: {len(VALVES)} valves, {seeds} seeds each",
        caption=(
            "given % / intervals that hold % / median error % / median half width %, of the signal's force range for "
            "F_0. F_s also by t(n-1) scatter/sqrt(n). Last: ok and off by more than twice the half width."
        ),
        title_justify="left",
    )
    for heading in ("grade", "sequence", "method", *SYMBOLS, "ok", "ok, far off"):
        table.add_column(heading, justify="left" if heading in {"grade", "sequence", "method"} else "right")
    for grade in GRADES:
        for sequence in SEQUENCES:
            for method in METHODS:
                own = [one for one in found[period_s, grade, sequence] if one.method == method]
                k_only = [one for one in own if one.symbol == "k"]
                off = [one for one in own if one.is_ok and one.given and abs(one.error) > BADLY_OFF * one.half_width]
                given = sum(one.given for one in own if one.is_ok)
                table.add_row(
                    grade,
                    sequence,
                    method,
                    *(_cell([one for one in own if one.symbol == symbol]) for symbol in SYMBOLS),
                    f"{100.0 * sum(one.is_ok for one in k_only) / len(k_only):.0f} %",
                    f"{len(off)} of {given}",
                    end_section=sequence == SEQUENCES[-1] and method == METHODS[-1],
                )
    return table


def _cell(own: list[Judged]) -> str:
    given = [one for one in own if one.given]
    if not given:
        return "-"
    parts = [
        f"{100.0 * len(given) / len(own):.0f}",
        f"{100.0 * sum(one.holds for one in given) / len(given):.0f}",
        f"{np.median([abs(one.error) for one in given]):.2g}",
        f"{np.median([one.half_width for one in given]):.2g}",
    ]
    ratios = [one.by_repeats for one in given if math.isfinite(one.by_repeats)]
    return "/".join(parts) + (f" (x {np.median(ratios):.2g})" if ratios else "")
