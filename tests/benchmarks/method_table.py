"""As published, corrected, robust, maximum likelihood and the bound, side by side: four valves, noises and rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from rich.table import Table

from estimators.base import Estimator, Form
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.registry import ESTIMATORS
from tests.benchmarks.efficiency import Case, bounds_of, phased, scale_of
from tests.benchmarks.parallel import each
from tests.estimators.recordings import VALVES

SEEDS: Final = 3
NOISES_M: Final = (0.0, 5.0e-6, 20.0e-6, 100.0e-6)
PERIODS_S: Final = (1.0e-3, 5.0e-3, 10.0e-3, 20.0e-3, 50.0e-3)
SYMBOLS: Final = ("m", "k", "F_v", "F_c", "F_s")
BOUND: Final = "bound"

METHODS: Final[dict[str, Callable[[], Estimator]]] = {
    **{f"method 1 {form}": partial(RegressionEstimator, form=form) for form in Form},
    **{f"method 2 {form}": partial(GarciaEstimator, form=form) for form in Form},
    **{name.replace("_", " "): make for name, make in ESTIMATORS.items() if name not in ("regression", "garcia")},
}


@dataclass(frozen=True, slots=True)
class Condition:
    """One cell's tests: a valve, its noise, m, and its sampling period, s."""

    valve: str
    noise_m: float
    period_s: float
    seed: int


def errors(condition: Condition) -> dict[tuple[str, str], float]:
    """Return the error in % of every method and parameter that is given, and of the bound."""
    jitter = 0.1 if condition.period_s > 1.0e-3 else 0.0
    case = Case(condition.valve, "triangle", condition.noise_m, condition.seed)
    test = phased(case, condition.period_s, jitter)
    found = {}
    for method, make in METHODS.items():
        estimate = make().estimate(test.recording, test.nameplate)
        for symbol in SYMBOLS:
            value = estimate.value(symbol)
            if value is not None:
                found[method, symbol] = 100.0 * (value / test.truth.by_symbol()[symbol] - 1.0)
    limits = bounds_of(test, condition.noise_m) if condition.noise_m > 0.0 else dict.fromkeys(SYMBOLS, 0.0)
    for symbol in SYMBOLS:
        found[BOUND, symbol] = 100.0 * limits[symbol] / scale_of(symbol, test)
    return found


def run(count: int | None = None) -> list[Table]:
    """Return one table a valve."""
    seeds = SEEDS if count is None else count
    conditions = [
        Condition(valve, noise_m, period_s, seed)
        for valve in VALVES
        for noise_m in NOISES_M
        for period_s in PERIODS_S
        for seed in range(seeds)
    ]
    by_condition = dict(zip(conditions, each(errors, conditions, "methods"), strict=True))
    return [_table(valve, by_condition, seeds) for valve in VALVES]


def _table(valve: str, by_condition: dict[Condition, dict[tuple[str, str], float]], seeds: int) -> Table:
    table = Table(
        title=f"{valve} valve, 3 x 20 s triangle: rms error in %, {seeds} seeds",
        caption="In brackets: in how many of the seeds it is given, where not in all. A dash: not given. "
        "Method 1: regression; method 2: Garcia. The bound: one standard error.",
        title_justify="left",
    )
    for heading in ("noise", "period", ""):
        table.add_column(heading)
    for heading in (*METHODS, BOUND):
        table.add_column(heading, justify="right")
    for noise_m in NOISES_M:
        for period_s in PERIODS_S:
            found = [by_condition[Condition(valve, noise_m, period_s, seed)] for seed in range(seeds)]
            for symbol in SYMBOLS:
                first = symbol == SYMBOLS[0]
                labels = (f"{1e6 * noise_m:g} um", f"{1e3 * period_s:g} ms") if first else ("", "")
                cells = [_cell([one[m, symbol] for one in found if (m, symbol) in one], seeds) for m in METHODS]
                limit = _cell([one[BOUND, symbol] for one in found], seeds)
                table.add_row(*labels, symbol, *cells, limit, end_section=symbol == SYMBOLS[-1])
    return table


def _cell(given: list[float], seeds: int) -> str:
    if not given:
        return "-"
    rms = float(np.sqrt(np.mean(np.square(given))))
    size = f"{rms:.0e}" if 0.0 < rms < 1.0e-4 or rms >= 1.0e4 else f"{rms:.2g}" if rms < 100.0 else f"{rms:.0f}"
    return size if len(given) == seeds else f"{size} ({len(given)})"
