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
from tests.bench.benchmarks.efficiency import Case, bounds_of, phased, scale_of
from tests.bench.parallel import each
from tests.support.published_recordings import VALVES

SEEDS: Final = 3
NOISES_M: Final = (0.0, 5.0e-6, 20.0e-6, 100.0e-6)
PERIODS_S: Final = (1.0e-3, 5.0e-3, 10.0e-3, 20.0e-3, 50.0e-3)
SYMBOLS: Final = ("m", "k", "F_v", "F_c", "F_s")
TOGETHER: Final = (("m", "F_v", "F_c"), ("k", "F_s"))
BOUND: Final = "bound"

METHODS: Final[dict[str, Callable[[], Estimator]]] = {
    **{f"method 1 {form}": partial(RegressionEstimator, form=form) for form in Form},
    **{f"method 2 {form}": partial(GarciaEstimator, form=form) for form in Form},
    **{name.replace("_", " "): make for name, make in ESTIMATORS.items() if name not in ("regression", "garcia")},
}
HEADINGS: Final = ("1 pub.", "1 corr.", "1 robust", "2 pub.", "2 corr.", "2 robust", "likelihood", BOUND)


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
    """Return two tables a valve: m, F_v and F_c, which noise hides, and k and F_s, which it does not."""
    seeds = SEEDS if count is None else count
    conditions = [
        Condition(valve, noise_m, period_s, seed)
        for valve in VALVES
        for noise_m in NOISES_M
        for period_s in PERIODS_S
        for seed in range(seeds)
    ]
    by_condition = dict(zip(conditions, each(errors, conditions, "methods"), strict=True))
    return [table_of(valve, symbols, by_condition, seeds) for valve in VALVES for symbols in TOGETHER]


def table_of(
    valve: str, symbols: tuple[str, ...], by_condition: dict[Condition, dict[tuple[str, str], float]], seeds: int
) -> Table:
    """Return one valve's root mean square errors of these symbols: a row a noise and period, a column a method."""
    table = Table(
        title=f"{valve} valve, 3 x 20 s triangle: rms error of {' / '.join(symbols)} in %, {seeds} seeds",
        caption="A star: not given in all of the seeds. A dash: in none. "
        "1: regression; 2: Garcia; pub.: as published. The bound: one standard error.",
        title_justify="left",
    )
    table.add_column("noise, period")
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for noise_m in NOISES_M:
        for period_s in PERIODS_S:
            found = [by_condition[Condition(valve, noise_m, period_s, seed)] for seed in range(seeds)]
            cells = [
                " / ".join(_cell([one[m, symbol] for one in found if (m, symbol) in one], seeds) for symbol in symbols)
                for m in (*METHODS, BOUND)
            ]
            cells = ["-" if set(cell) <= set("- /") else cell for cell in cells]
            label = f"{1e6 * noise_m:g} um, {1e3 * period_s:g} ms"
            table.add_row(label, *cells, end_section=period_s == PERIODS_S[-1])
    return table


def _cell(given: list[float], seeds: int) -> str:
    if not given:
        return "-"
    rms = float(np.sqrt(np.mean(np.square(given))))
    size = f"{rms:.0f}" if rms >= 10.0 else f"{rms:.2g}" if rms >= 1.0e-3 else f"{rms:.0e}".replace("e-0", "e-")
    return "0" if rms < 1.0e-9 else size if len(given) == seeds else f"{size}*"
