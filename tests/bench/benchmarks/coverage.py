"""Whether the 95 % intervals hold the truth in 95 % of the tests: four valves with scatter, noises, rates, phases."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from dataclasses import dataclass
from typing import Final

import numpy as np
from rich.table import Table

from estimators.registry import ESTIMATORS
from tests.bench.benchmarks.bound import ONE_INSTANT
from tests.bench.benchmarks.efficiency import taken_at_once
from tests.bench.parallel import each
from tests.support.published_recordings import VALVES, Recorded, followed
from valve.parameter_sets import parameter_set
from valve.parameters import PARAMETER_SYMBOLS, parameters_from_symbols
from valve.recording import Recording
from valve.waveform import Waveform, multi_rate_triangle, triangle

TESTS: Final = 1000
NOISES_M: Final = (0.3e-6, 1.0e-6, 5.0e-6, 20.0e-6, 100.0e-6)
PERIODS_S: Final = (1.0e-3, 5.0e-3, 10.0e-3, 20.0e-3, 50.0e-3)
SCATTER: Final = 0.30
ASKED: Final = (0.93, 0.97)
# Fewer than all: BENCH_METHODS=regression,garcia make bench ARGS=coverage
METHODS: Final = tuple(name for name in os.environ.get("BENCH_METHODS", "").split(",") if name) or tuple(ESTIMATORS)


@dataclass(frozen=True, slots=True)
class Interval:
    """What one method said of one parameter in one test, beside the truth; ``half_width`` in % of ``scale``."""

    seed: int
    method: str
    symbol: str
    given: bool
    inside: bool = False
    half_width: float = math.nan
    z: float = math.nan
    raised: str = ""


def scattered_test(seed: int) -> tuple[Recorded, str, float, float]:
    """Return the test of this seed, its valve's name, the noise, m, and the period, s."""
    rng = np.random.default_rng([95, seed])
    name = VALVES[seed % len(VALVES)]
    chosen = parameter_set(name)
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    values = {s: v * rng.uniform(1.0 - SCATTER, 1.0 + SCATTER) for s, v in chosen.parameters.by_symbol().items()}
    published = chosen.parameters
    more = published.static_friction_n / published.coulomb_friction_n - 1.0
    values["F_s"] = values["F_c"] * (1.0 + more * rng.uniform(1.0 - SCATTER, 1.0 + SCATTER))
    # what the rough valve at +30 % of both would leave of its travel is nothing
    most = 0.95 * area_m2 * (signal.range_pa[1] - signal.range_pa[0]) / (values["F_c"] + values["F_s"])
    values["F_c"], values["F_s"] = values["F_c"] * min(1.0, most), values["F_s"] * min(1.0, most)
    truth = parameters_from_symbols(values)
    noise_m = float(NOISES_M[rng.integers(len(NOISES_M))])
    period_s = float(PERIODS_S[rng.integers(len(PERIODS_S))])
    wave = _waveform(signal.range_pa, rng)
    time_s = np.arange(math.floor(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    if period_s > 1.0e-3:
        time_s[1:] += np.clip(rng.normal(0.0, 0.1, time_s.size - 1), -0.4, 0.4) * period_s
    position_m = followed(truth, wave, area_m2, time_s, None) + noise_m * rng.standard_normal(time_s.size)
    # the two channels as far from one instant as the recording says that they may be
    late_s = ONE_INSTANT * period_s * float(np.random.default_rng([96, seed]).standard_normal())
    pressure_pa = wave.at(time_s - late_s)
    recording = Recording(time_s, position_m, pressure_pa=pressure_pa, provenance=taken_at_once(period_s))
    return Recorded(recording, chosen.nameplate, truth), name, noise_m, period_s


def _waveform(range_pa: tuple[float, float], rng: np.random.Generator) -> Waveform:
    """Two in three times the paper's triangle, else several rates; a hold puts the corners between the samples."""
    slow_s, fast_s = 20.0 * rng.uniform(0.9, 1.1), 2.0 * rng.uniform(0.9, 1.1)
    single = rng.random() < 2.0 / 3.0
    wave = triangle(slow_s, 3, *range_pa) if single else multi_rate_triangle([slow_s, *[fast_s] * 20], *range_pa)
    hold_s = rng.uniform(0.1, 0.2)
    time_s = np.concatenate([[0.0], hold_s + wave.time_s])
    return Waveform(wave.name, time_s, np.concatenate([wave.pressure_pa[:1], wave.pressure_pa]))


def intervals(seed: int) -> list[Interval]:
    """Return what every method says of every parameter in the test of this seed."""
    test, *_ = scattered_test(seed)
    truth = test.truth.by_symbol()
    found = []
    for method in METHODS:
        try:
            estimate = ESTIMATORS[method]().estimate(test.recording, test.nameplate)
        except Exception as error:  # noqa: BLE001 - counted and shown, so that the other tests are not lost
            said = f"{method} raised {type(error).__name__} in seed {seed}"
            found += [Interval(seed, method, symbol, given=False, raised=said) for symbol in PARAMETER_SYMBOLS]
            continue
        for symbol, one in estimate.parameters.items():
            if one.value is None or one.ci95 is None or one.std_error is None:
                found.append(Interval(seed, estimate.method, symbol, given=False))
                continue
            low, high = one.ci95
            scale = truth["F_s"] if symbol == "F_0" else truth[symbol]
            inside, width = low <= truth[symbol] <= high, 50.0 * (high - low) / scale
            z = (one.value - truth[symbol]) / one.std_error if one.std_error > 0.0 else math.inf
            found.append(Interval(seed, estimate.method, symbol, True, inside, width, z))
    return found


def run(count: int | None = None) -> Table:
    """Return the table of coverage by method and parameter."""
    tests = TESTS if count is None else count
    by_place: dict[tuple[str, str], list[Interval]] = defaultdict(list)
    for found in each(intervals, range(tests), "coverage"):
        for one in found:
            by_place[one.method, one.symbol].append(one)
    return table(by_place, tests)


def table(by_place: dict[tuple[str, str], list[Interval]], tests: int) -> Table:
    """Return coverage, its own uncertainty, the median width and how often it was given."""
    raised = sorted({one.raised for found in by_place.values() for one in found if one.raised})
    shown = Table(
        title=f"Coverage of the 95 % intervals: {tests} tests, four valves +-{100 * SCATTER:.0f} %, "
        f"{1e6 * NOISES_M[0]:g} to {1e6 * NOISES_M[-1]:g} um, {1e3 * PERIODS_S[0]:g} to {1e3 * PERIODS_S[-1]:g} ms",
        caption=f"Asked: {100 * ASKED[0]:.0f} to {100 * ASKED[1]:.0f} %. A star: surely outside. Widths in % of the "
        "value, of F_0 in % of F_s. Seeds 0 onwards. " + "; ".join(raised),
        title_justify="left",
    )
    for heading in ("method", "parameter", "given", "coverage", "(95 % sure)", "half width", "rms z", "largest |z|"):
        shown.add_column(heading, justify="left" if heading in ("method", "parameter") else "right")
    for method in METHODS:
        for symbol in PARAMETER_SYMBOLS:
            shown.add_row(method, symbol, *_row(by_place[method, symbol]), end_section=symbol == "F_0")
    return shown


def _row(found: list[Interval]) -> list[str]:
    given = [one for one in found if one.given]
    share = f"{100.0 * len(given) / max(1, len(found)):.0f} %"
    if not given:
        return [share, *["-"] * 5]
    inside = sum(one.inside for one in given)
    low, high = binomial_interval(inside, len(given))
    outside = "*" if high < ASKED[0] or low > ASKED[1] else ""
    worst = max(given, key=lambda one: abs(one.z))
    return [
        share,
        f"{100.0 * inside / len(given):.1f} %{outside}",
        f"{100.0 * low:.0f}-{100.0 * high:.0f}",
        f"{np.median([one.half_width for one in given]):.2g} %",
        f"{np.sqrt(np.mean([one.z**2 for one in given])):.2f}",
        f"{abs(worst.z):.1f} (seed {worst.seed})",
    ]


def binomial_interval(hits: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    z2 = 1.959964**2
    share = hits / trials
    middle = (share + z2 / (2.0 * trials)) / (1.0 + z2 / trials)
    half = math.sqrt(z2 * (share * (1.0 - share) + z2 / (4.0 * trials)) / trials) / (1.0 + z2 / trials)
    return middle - half, middle + half
