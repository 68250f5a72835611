"""The two classic methods: error by form, noise and sampling period, and time at 60,000 samples."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from rich.table import Table

from estimators.base import Estimate, Estimator, Form
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.motion.recorded_motion import read_motion
from tests.bench.benchmarks.timing import least_cpu_s, shown
from tests.support.published_recordings import VALVES, Recorded, recorded
from valve.parameter_sets import parameter_set
from valve.waveform import triangle

ESTIMATORS: Final[dict[str, Callable[..., Estimator]]] = {"regression": RegressionEstimator, "garcia": GarciaEstimator}
CONDITIONS: Final = (
    (1.0e-3, 0.0),
    (1.0e-3, 1.0e-6),
    (1.0e-3, 5.0e-6),
    (1.0e-3, 20.0e-6),
    (10.0e-3, 20.0e-6),
    (50.0e-3, 20.0e-6),
)
# The robust form needs no capture at 1 ms.
ROBUST_CONDITIONS: Final = tuple(
    (period_s, noise_m)
    for period_s in (1.0e-3, 5.0e-3, 10.0e-3, 20.0e-3, 50.0e-3)
    for noise_m in (0.0, 5.0e-6, 20.0e-6, 100.0e-6)
)
SYMBOLS: Final = ("m", "k", "F_v", "F_c", "F_s")
SEEDS: Final = 5


def run() -> list[Table]:
    """Return the tables of errors, one a valve, and the table of times."""
    return [*(_errors(name) for name in VALVES), _times()]


def _errors(name: str) -> Table:
    """Root mean square error in percent of what is given over seeds and sampling phases; how often it is given."""
    table = Table(
        title=f"Classic methods, {name} valve, 3 x 20 s triangle: rms error in % of what is given, {SEEDS} seeds",
        caption="In brackets: in how many of the seeds it is given, where not in all. A dash: not identifiable.",
        title_justify="left",
    )
    for heading in ("method", "form", "period", "noise"):
        table.add_column(heading)
    for symbol in SYMBOLS:
        table.add_column(symbol, justify="right")
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    for method, make in ESTIMATORS.items():
        for form in Form:
            conditions = ROBUST_CONDITIONS if form is Form.ROBUST else CONDITIONS
            for period_s, noise_m in conditions:
                errors: dict[str, list[float]] = {symbol: [] for symbol in SYMBOLS}
                for seed in range(SEEDS):
                    wave = triangle(20.0 + 0.07 * seed, 3, *signal.range_pa)
                    jitter = 0.1 if period_s > 5.0e-3 else 0.0
                    test = recorded(name, period_s=period_s, noise_m=noise_m, seed=seed, waveform=wave, jitter=jitter)
                    estimate = make(form=form).estimate(test.recording, test.nameplate)
                    for symbol in SYMBOLS:
                        value = estimate.value(symbol)
                        if value is not None:
                            errors[symbol].append(100.0 * (value / test.truth.by_symbol()[symbol] - 1.0))
                last = (period_s, noise_m) == conditions[-1]
                table.add_row(
                    method,
                    str(form),
                    f"{1e3 * period_s:g} ms",
                    f"{1e6 * noise_m:g} um",
                    *(_shown(errors[symbol]) for symbol in SYMBOLS),
                    end_section=last,
                )
    return table


def _shown(errors: list[float]) -> str:
    if not errors:
        return "-"
    rms = float(np.sqrt(np.mean(np.square(errors))))
    size = f"{rms:.0e}" if rms < 1.0e-4 else f"{rms:.2g}"
    return size if len(errors) == SEEDS else f"{size} ({len(errors)})"


def _times() -> Table:
    table = Table(title="Classic methods: processor time at 60,001 samples, robust form, 5 um", title_justify="left")
    headings = ("valve", "both together", "regression", "garcia", "reading alone", "both, corrected")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "valve" else "right")
    for name in VALVES:
        test = recorded(name, noise_m=5.0e-6)
        recording, nameplate = test.recording, test.nameplate
        calls: list[Callable[[], object]] = [
            partial(_together, test, Form.ROBUST),
            partial(RegressionEstimator().estimate, recording, nameplate),
            partial(GarciaEstimator().estimate, recording, nameplate),
            partial(read_motion, recording, nameplate),
            partial(_together, test, Form.CORRECTED),
        ]
        table.add_row(name, *(shown(least_cpu_s(call)) for call in calls))
    return table


def _together(test: Recorded, form: Form) -> list[Estimate]:
    """Both methods on a recording that is read once."""
    motion = read_motion(test.recording, test.nameplate)
    methods = (RegressionEstimator(form=form), GarciaEstimator(form=form))
    return [method.estimate_motion(motion) for method in methods]
