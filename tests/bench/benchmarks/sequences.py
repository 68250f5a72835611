"""What each sequence can tell at best: the Cramér-Rao bound by valve and sample period, and why the usual one is so."""

from __future__ import annotations

import itertools
import math
from typing import Final

import numpy as np
from rich.table import Table

from estimators.identifiability.bound import Knowledge
from estimators.planned_test import PlannedTest, planned_knowledge
from estimators.samples import FloatArray
from tests.support.published_recordings import VALVES
from valve import waveform
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops
from valve.waveform import Waveform, dwell, multi_rate_periods, multi_rate_triangle, sine, steps, triangle

NOISE_M: Final = 20.0e-6
PERIODS_S: Final = (1.0e-3, 10.0e-3, 20.0e-3, 50.0e-3)
SYMBOLS: Final = ("m", "k", "F_v", "F_c", "F_s", "DV")
TURN_S: Final = 0.6
# The choice is judged by what is hard; k is always known.
CHOSEN_BY: Final = ("m", "F_v", "F_c", "F_s", "DV")
CHOICE_PERIODS_S: Final = (1.0e-3, 20.0e-3, 50.0e-3)
CHOICE_LAGS_S: Final = (0.0, 0.1, 0.3)


def run() -> list[Table]:
    """Return the bounds of the sequences, one table a valve, and what other rates and holds would do."""
    return [*(_bounds(name) for name in VALVES), _choice()]


def many_rates(low_pa: float, high_pa: float, *, fastest_s: float = 2.0, turn_s: float = TURN_S) -> Waveform:
    """Return the usual sequence of a test, or the same with another fastest period or hold."""
    return multi_rate_triangle(multi_rate_periods(fastest_s, turn_s=turn_s), low_pa, high_pa, turn_s=turn_s)


def _sequences(low_pa: float, high_pa: float) -> dict[str, Waveform]:
    levels = [low_pa + share * (high_pa - low_pa) for share in (0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)]
    return {
        "triangle, 3 x 20 s": triangle(20.0, 3, low_pa, high_pa),
        "sine, 3 x 20 s": sine(20.0, 3, low_pa, high_pa),
        "dwell 1, 3, 10 s": dwell(20.0, low_pa, high_pa, [1.0, 3.0, 10.0]),
        "steps of 25 %, 5 s": steps(levels, 5.0),
        "20 s + 20 x 2 s": multi_rate_triangle([20.0, *[2.0] * 20], low_pa, high_pa),
        "multi_rate, from 4 s": many_rates(low_pa, high_pa, fastest_s=4.0),
        "multi_rate (usual)": many_rates(low_pa, high_pa),
    }


def _known(name: str, wave: Waveform, period_s: float, lag_s: float = 0.0) -> Knowledge:
    chosen = parameter_set(name)
    area_m2, travel_m = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.actuator.travel_m
    assert area_m2 is not None
    stops = TravelStops(-0.01 * travel_m, 1.01 * travel_m)
    return planned_knowledge(chosen.parameters, PlannedTest(wave, area_m2, period_s, NOISE_M, lag_s, stops=stops))


def _bounds(name: str) -> Table:
    table = Table(
        title=f"Bound of one test, {name} valve, position noise {1e6 * NOISE_M:g} um: standard error in %",
        caption="Pressure known but for a delay of half a sample period; DV beforehand to a factor e^1.5 (150 %).\n"
        "gain: error of m with the triangle over that with this sequence",
        title_justify="left",
    )
    for heading in ("sequence", "time", "period", *SYMBOLS, "gain"):
        table.add_column(heading, justify="left" if heading == "sequence" else "right")
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    reference: dict[float, float] = {}
    for label, wave in _sequences(*signal.range_pa).items():
        for period_s in PERIODS_S:
            known = _known(name, wave, period_s)
            percent = {symbol: 100.0 * known.relative(symbol) / 1.959964 for symbol in SYMBOLS}
            reference.setdefault(period_s, percent["m"])
            table.add_row(
                label,
                f"{wave.duration_s:.0f} s",
                f"{1e3 * period_s:g} ms",
                *(_shown(percent[symbol]) for symbol in SYMBOLS),
                f"{reference[period_s] / percent['m']:.2g}",
                end_section=period_s == PERIODS_S[-1],
            )
    return table


def _shown(percent: float) -> str:
    if not math.isfinite(percent) or percent > 999.0:
        return "> 999"
    return f"{percent:.0e}" if percent < 1.0e-4 else f"{percent:.2g}"


def _choice() -> Table:
    """Other fastest periods, holds and spreads, against the best of all in each case."""
    table = Table(
        title="The choice of multi_rate: error over that of the best row, geometric mean of m, F_v, F_c, F_s and DV",
        caption=f"Bold: in use. {len(VALVES)} valves x {len(CHOICE_PERIODS_S)} rates x {len(CHOICE_LAGS_S)} lags",
        title_justify="left",
    )
    for heading in (
        "fastest period",
        "hold at turns",
        "spread",
        "worst case",
        "mean",
        "lag 0",
        "lag 0.1 s",
        "lag 0.3 s",
    ):
        table.add_column(heading, justify="right")
    usual = waveform._PERIOD_SPREAD
    rows: dict[tuple[float, float, float], FloatArray] = {}
    choices = [*itertools.product((1.5, 2.0, 3.0, 4.0), (0.0, 0.6), (usual,)), (2.0, 0.3, usual), (2.0, 1.0, usual)]
    for fastest_s, turn_s, spread in [*choices, (2.0, 0.6, 0.0), (2.0, 0.6, 0.6), (2.0, 0.6, 1.0)]:
        rows[fastest_s, turn_s, spread] = _case_errors(fastest_s, turn_s, spread)
    best = np.min(list(rows.values()), axis=0)
    for (fastest_s, turn_s, spread), errors in rows.items():
        # shape (lags, sample periods, valves)
        lost = np.mean(errors - best, axis=-1)
        by_lag = (f"{math.exp(float(lag.mean())):.2f}" for lag in lost)
        chosen = (fastest_s, turn_s, spread) == (2.0, TURN_S, usual)
        table.add_row(
            f"{fastest_s:g} s",
            f"{turn_s:g} s",
            f"{spread:g}",
            f"{math.exp(float(lost.max())):.2f}",
            f"{math.exp(float(lost.mean())):.2f}",
            *by_lag,
            style="bold" if chosen else "",
        )
    return table


def _case_errors(fastest_s: float, turn_s: float, spread: float) -> FloatArray:
    """Logarithms of the relative errors, shape (lags, sample periods, valves, symbols)."""
    usual = waveform._PERIOD_SPREAD
    waveform._PERIOD_SPREAD = spread  # type: ignore[misc]  # what is tried out is a constant
    try:
        errors = np.empty((len(CHOICE_LAGS_S), len(CHOICE_PERIODS_S), len(VALVES), len(CHOSEN_BY)))
        for (i, lag_s), (j, period_s), (n, name) in itertools.product(
            enumerate(CHOICE_LAGS_S), enumerate(CHOICE_PERIODS_S), enumerate(VALVES)
        ):
            signal = parameter_set(name).nameplate.signal
            assert signal is not None
            known = _known(name, many_rates(*signal.range_pa, fastest_s=fastest_s, turn_s=turn_s), period_s, lag_s)
            errors[i, j, n] = [math.log(min(known.relative(symbol), 1.0e3)) for symbol in CHOSEN_BY]
    finally:
        waveform._PERIOD_SPREAD = usual  # type: ignore[misc]
    return errors
