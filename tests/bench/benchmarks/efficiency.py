"""How near maximum likelihood comes to the Cramér-Rao bound: root mean square errors over seeds, beside it."""

from __future__ import annotations

import math
import statistics
import time
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.table import Table

from estimators.registry import ESTIMATORS
from tests.bench.benchmarks.bound import IDENTIFIABLE, ONE_INSTANT, bound, delay_slope
from tests.bench.benchmarks.timing import shown
from tests.bench.parallel import each
from tests.support.published_recordings import SYMBOLS, VALVES, Recorded, paper_triangle, recorded
from valve.parameter_sets import parameter_set
from valve.recording import Acquisition, Provenance
from valve.waveform import Waveform, multi_rate_triangle

SEEDS: Final = 200
NOISE_M: Final = 20.0e-6
METHOD: Final = "maximum_likelihood"
MOST_OF_BOUND: Final = 1.2
TIMED: Final = 5
ASKED_S: Final = {1.0e-3: 2.0, 10.0e-3: 0.3}  # seconds of one core, by period
# asked of the multi-rate sequence, rms in %
ASKED_MULTI_RATE: Final = {"m": 1.0, "F_v": 0.1, "DV": 10.0}


@dataclass(frozen=True, slots=True)
class Case:
    """One test of one valve."""

    valve: str
    sequence: str
    noise_m: float
    seed: int


@dataclass(frozen=True, slots=True)
class Answer:
    """What was given, by symbol, with its share of the scale, and the bound's standard errors in the same measure."""

    case: Case
    status: str
    errors: dict[str, float]  # of what was given
    bounds: dict[str, float]


def waveform(valve: str, sequence: str) -> Waveform:
    """Return the paper's triangle, or 20 s and 20 x 2 s."""
    signal = parameter_set(valve).nameplate.signal
    assert signal is not None
    return (
        paper_triangle(valve) if sequence == "triangle" else multi_rate_triangle([20.0, *[2.0] * 20], *signal.range_pa)
    )


def phased(case: Case, period_s: float = 1.0e-3, jitter: float = 0.0) -> Recorded:
    """Return the test of a case: the seed draws the noise and where in a period the corners fall."""
    wave = waveform(case.valve, case.sequence)
    phase_s = period_s * float(np.random.default_rng([4, case.seed]).random())
    held = Waveform(
        wave.name,
        np.concatenate([[0.0], phase_s + 0.05 + wave.time_s]),
        np.concatenate([wave.pressure_pa[:1], wave.pressure_pa]),
    )
    test = recorded(case.valve, period_s=period_s, noise_m=case.noise_m, seed=case.seed, waveform=held, jitter=jitter)
    return replace(test, recording=replace(test.recording, provenance=taken_at_once(period_s)))


def taken_at_once(period_s: float) -> Provenance:
    """Both channels in one instant: captured by the device at 1 ms, slower read in one short exchange."""
    if period_s <= 1.0e-3:
        return Provenance(Acquisition.CAPTURED, requested_period_s=period_s)
    return Provenance(Acquisition.POLLED, requested_period_s=period_s, timing_uncertainty_s=ONE_INSTANT * period_s)


def bounds_of(test: Recorded, noise_m: float) -> dict[str, float]:
    """Return the bound's standard error of every parameter of a test whose pressure is known, SI."""
    time_s, truth = test.recording.time_s, test.truth
    corners = time_s, test.recording.actuator_force_n(test.nameplate)
    delay = delay_slope(truth, corners, time_s), ONE_INSTANT * test.recording.sample_period_s
    return bound(truth, corners, time_s, noise_m, nuisances=[delay])


def scale_of(symbol: str, test: Recorded) -> float:
    """What an error is a share of: the value; for F_0, that may be zero, the static friction where it is larger."""
    values = test.truth.by_symbol()
    return max(abs(values["F_0"]), values["F_s"]) if symbol == "F_0" else values[symbol]


def answer(case: Case) -> Answer:
    """Estimate one case."""
    test = phased(case)
    estimate = ESTIMATORS[METHOD]().estimate(test.recording, test.nameplate)
    truth, errors = test.truth.by_symbol(), {}
    for symbol in SYMBOLS:
        value = estimate.value(symbol)
        if value is not None:
            errors[symbol] = (value - truth[symbol]) / scale_of(symbol, test)
    limits = bounds_of(test, case.noise_m) if case.noise_m > 0.0 else {}
    shares = {symbol: limits[symbol] / scale_of(symbol, test) for symbol in SYMBOLS} if limits else {}
    return Answer(case, str(estimate.status), errors, shares)


def run(count: int | None = None) -> list[Table]:
    """Return the tables of the triangle, of the multi-rate sequence, of tests without noise, and of times."""
    seeds = SEEDS if count is None else count
    if METHOD not in ESTIMATORS:
        return []
    few = max(1, seeds // 5)
    cases = [Case(valve, "triangle", NOISE_M, seed) for valve in VALVES for seed in range(seeds)]
    cases += [Case(valve, "multi_rate", NOISE_M, seed) for valve in VALVES for seed in range(few)]
    cases += [Case(valve, sequence, 0.0, 0) for valve in VALVES for sequence in ("triangle", "multi_rate")]
    found = each(answer, cases, "efficiency")
    clean = [one for one in found if one.case.noise_m == 0.0]
    noisy = [one for one in found if one.case.noise_m > 0.0]
    titles = {
        "triangle": f"the paper's triangle, 1 ms, 20 um, {seeds} seeds: asked at most {MOST_OF_BOUND:g} x bound",
        "multi_rate": f"20 s + 20 x 2 s, 1 ms, 20 um, {few} seeds: asked of nominal and rough at most "
        + ", ".join(f"{symbol} {limit:g} %" for symbol, limit in ASKED_MULTI_RATE.items()),
    }
    return [
        *(_noisy(title, [o for o in noisy if o.case.sequence == key]) for key, title in titles.items()),
        _clean(clean),
        _times(),
    ]


def _times() -> Table:
    """Return the processor time of one estimate at both lengths, alone on its core: medians of five seeds."""
    lengths = {period_s: f"{round(60.0 / period_s, -3):,.0f} ({1e3 * period_s:g} ms)" for period_s in ASKED_S}
    asked = ", ".join(f"{limit_s:g} s at {lengths[period_s]}" for period_s, limit_s in ASKED_S.items())
    table = Table(
        title="Maximum likelihood: processor time by samples",
        caption=f"The paper's triangle, 20 um, {TIMED} seeds: median, longest. A star: median above {asked}.",
        title_justify="left",
    )
    table.add_column("valve")
    for heading in lengths.values():
        table.add_column(heading, justify="right")
    estimator = ESTIMATORS[METHOD]()
    for valve in VALVES:
        cells = []
        for period_s, limit_s in ASKED_S.items():
            took_s = []
            for seed in range(TIMED):
                test = phased(Case(valve, "triangle", NOISE_M, seed), period_s)
                begun_s = time.process_time()
                estimator.estimate(test.recording, test.nameplate)
                took_s.append(time.process_time() - begun_s)
            median_s = statistics.median(took_s)
            cells.append(f"{shown(median_s)}, {shown(max(took_s))}{'*' if median_s > limit_s else ''}")
        table.add_row(valve, *cells)
    return table


def _noisy(title: str, found: list[Answer]) -> Table:
    table = Table(
        title=f"Maximum likelihood, {title}",
        caption="rms error in % / the bound in % = ratio; in brackets how often it is given, where not always. "
        "A star: above what is asked. A dash: the bound's 95 % half width is above 30 % and it is never given.",
        title_justify="left",
    )
    table.add_column("valve")
    for symbol in SYMBOLS:
        table.add_column(symbol, justify="right")
    table.add_column("not ok", justify="right")
    table.add_column("failed", justify="right")
    for valve in VALVES:
        own = [one for one in found if one.case.valve == valve]
        failed, poor = (sum(one.status == status for one in own) for status in ("failed", "poor"))
        table.add_row(valve, *(_cell(own, symbol) for symbol in SYMBOLS), str(poor), str(failed))
    return table


def _cell(own: list[Answer], symbol: str) -> str:
    limit = float(np.sqrt(np.mean([one.bounds[symbol] ** 2 for one in own])))
    given = [one.errors[symbol] for one in own if symbol in one.errors]
    identifiable = 1.959964 * limit < IDENTIFIABLE
    if not given:
        return f"- / {100.0 * limit:.2g}{'*' if identifiable else ''}"
    rms = float(np.sqrt(np.mean(np.square(given))))
    share = "" if len(given) == len(own) else f" ({len(given)})"
    case = own[0].case
    asked = (
        ASKED_MULTI_RATE.get(symbol) if case.sequence == "multi_rate" and case.valve in ("nominal", "rough") else None
    )
    # the ratio of a few seeds scatters by 1 / sqrt(2 n)
    slack = 1.0 + 2.0 / math.sqrt(2.0 * len(given))
    missed = (identifiable and rms > MOST_OF_BOUND * limit * (slack if len(given) < 100 else 1.0)) or (
        asked is not None and 100.0 * rms > asked
    )
    return f"{100.0 * rms:.2g} / {100.0 * limit:.2g} = {rms / limit:.2f}{share}{'*' if missed else ''}"


def _clean(found: list[Answer]) -> Table:
    table = Table(
        title="Maximum likelihood without noise, 1 ms: error in % (asked: all but DV below 1e-4 %)",
        caption="A star: above what is asked, or not given. DV carries no star.",
        title_justify="left",
    )
    table.add_column("valve")
    table.add_column("sequence")
    for symbol in SYMBOLS:
        table.add_column(symbol, justify="right")
    table.add_column("status")
    for one in found:
        cells = []
        for symbol in SYMBOLS:
            error = one.errors.get(symbol)
            missed = symbol != "DV" and (error is None or abs(error) > 1.0e-6)
            cells.append(("-" if error is None else f"{100.0 * abs(error):.0e}") + ("*" if missed else ""))
        table.add_row(one.case.valve, one.case.sequence, *cells, one.status)
    return table
