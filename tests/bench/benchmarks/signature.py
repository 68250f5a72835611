"""How often the intervals of the signature hold the truth, how wide they are, and its bias, on the published valves.

The breakaway that counts is the end of the creep up to DV: before that nothing observable happens.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Final

import numpy as np
from rich.table import Table

from estimators.signature.measure import measure_signature
from tests.bench.parallel import each
from valve.motion import simulate_motion
from valve.parameter_sets import parameter_set
from valve.recording import Recording
from valve.stem import Mode
from valve.waveform import triangle

_USUAL_COUNT: Final = 12  # tests a case; the figures of docs/signature.md are of 30
_VALVES: Final = ("vendor", "nominal", "rough", "graphite")
# sample period s, position noise m, pressure noise Pa
_SAMPLINGS: Final = (
    (1.0e-3, 20.0e-6, 0.0),
    (1.0e-3, 100.0e-6, 0.0),
    (1.0e-3, 20.0e-6, 50.0),
    (10.0e-3, 20.0e-6, 0.0),
    (50.0e-3, 100.0e-6, 0.0),
)
_FIGURES: Final = {
    "friction_mean_n": "friction",
    "spring_rate_n_per_m": "spring rate",
    "bench set": "bench set, top",
    "dead_band_percent": "dead band",
    "stick_band_percent": "S",
    "slip_jump_percent": "J",
}
_PERIOD_S: Final = 20.0
_CYCLES: Final = 3

Case = tuple[str, float, float, float, int]
Judged = dict[str, tuple[float, float, bool]]  # by figure: error and half width, % of the truth, and whether it held


def run(count: int | None = None) -> Table:
    """Table of half widths, coverage and bias by case, and of coverage and bias over all."""
    tests = _USUAL_COUNT if count is None else count
    cases = [(name, *sampling, seed) for name in _VALVES for sampling in _SAMPLINGS for seed in range(tests)]
    found: dict[tuple[str, float, float, float], list[Judged]] = defaultdict(list)
    for case, judged in zip(cases, each(judge, cases, "signature"), strict=True):
        found[case[:4]].append(judged)
    table = Table(
        title=f"Signature, {_CYCLES} triangles of {_PERIOD_S:g} s, {tests} tests a case: half of the 95 % interval in "
        "% of the figure, (% of intervals that hold the truth), mean error in standard errors",
        caption="null: more than half of the tests gave none; J of the vendor's valve is its viscous friction, below 0",
    )
    for heading in ("valve, period, noise", *_FIGURES.values()):
        table.add_column(heading, justify="left" if heading.startswith("valve") else "right")
    for (name, period_s, noise_m, noise_pa), tested in found.items():
        label = f"{name}, {1e3 * period_s:g} ms, {1e6 * noise_m:g} um{f', {noise_pa:g} Pa' if noise_pa else ''}"
        table.add_row(label, *(_cell([one[figure] for one in tested if figure in one], tests) for figure in _FIGURES))
    table.add_section()
    every = [one for tested in found.values() for one in tested]
    table.add_row("all", *(_pooled([one[figure] for one in every if figure in one]) for figure in _FIGURES))
    return table


def judge(case: Case) -> Judged:
    """Simulate one test with a random sampling phase and judge each figure that the signature gives."""
    name, period_s, noise_m, noise_pa, seed = case
    chosen, random = parameter_set(name), np.random.default_rng(seed)
    signal, area_m2 = chosen.nameplate.signal, chosen.nameplate.actuator.diaphragm_area_m2
    assert signal is not None
    assert area_m2 is not None
    wave = triangle(_PERIOD_S, _CYCLES, *signal.range_pa)
    count = int(wave.duration_s / period_s) - 1
    time_s = np.arange(count, dtype=np.float64) * period_s + random.uniform(0.0, period_s)
    motion = simulate_motion(chosen.parameters, wave.time_s, area_m2 * wave.pressure_pa, time_s)
    position_m = motion.position_m + noise_m * random.standard_normal(time_s.size)
    pressure_pa = wave.at(time_s) + noise_pa * random.standard_normal(time_s.size)
    found = measure_signature(Recording(time_s, position_m, pressure_pa=pressure_pa), chosen.nameplate)
    estimates = {**found.figures, "bench set": found.bench_set[1]}
    judged: Judged = {}
    for figure, true in truth(name).items():
        one = estimates[figure]
        if one.value is not None and one.ci95 is not None:
            low, high = one.ci95
            share = 100.0 / abs(true)
            judged[figure] = (share * (one.value - true), share * 0.5 * (high - low), low <= true <= high)
    return judged


def truth(name: str) -> dict[str, float]:
    """The figures of the exact motion."""
    chosen = parameter_set(name)
    signal, actuator, valve = chosen.nameplate.signal, chosen.nameplate.actuator, chosen.parameters
    assert signal is not None
    assert actuator.diaphragm_area_m2 is not None
    wave = triangle(_PERIOD_S, _CYCLES, *signal.range_pa)
    span_n = actuator.diaphragm_area_m2 * (signal.range_pa[1] - signal.range_pa[0])
    rate = 2.0 * span_n / _PERIOD_S
    force_n = actuator.diaphragm_area_m2 * wave.pressure_pa
    events = simulate_motion(valve, wave.time_s, force_n, [0.0, wave.duration_s]).events
    crept = np.flatnonzero(events.mode[:-1] == Mode.BAND)
    # what breaks a stem away crosses the band at the ramp's pace; what only comes to rest is quicker
    away_s = np.array([events.time_s[row + 1] for row in crept])
    creep_n = rate * float(np.median([events.time_s[row + 1] - events.time_s[row] for row in crept]))
    turns_s = wave.time_s[1:-1]
    ranges_n = [rate * float(away_s[away_s > turn_s + 1.0e-3][0] - turn_s) for turn_s in turns_s]
    moving_n = valve.coulomb_friction_n + valve.viscous_friction_n_s_per_m * rate / valve.spring_rate_n_per_m
    breakaway_n, share = valve.static_friction_n + creep_n, 100.0 / span_n
    full_n = valve.preload_n + valve.spring_rate_n_per_m * actuator.travel_m
    return {
        "friction_mean_n": moving_n,
        "spring_rate_n_per_m": valve.spring_rate_n_per_m,
        "bench set": full_n / actuator.diaphragm_area_m2,
        "dead_band_percent": share * float(np.mean(ranges_n)),
        "stick_band_percent": share * (breakaway_n + moving_n),
        "slip_jump_percent": share * (breakaway_n - moving_n),
    }


def _cell(judged: list[tuple[float, float, bool]], tests: int) -> str:
    if 2 * len(judged) < tests:
        return "null"
    half = float(np.median([one[1] for one in judged]))
    held, bias = _held_and_bias(judged)
    return f"{half:.2g} ({100.0 * held:.0f}) {bias:+.1f}"


def _pooled(judged: list[tuple[float, float, bool]]) -> str:
    if not judged:
        return "null"
    held, bias = _held_and_bias(judged)
    return f"({100.0 * held:.1f}) {bias:+.2f}"


def _held_and_bias(judged: list[tuple[float, float, bool]]) -> tuple[float, float]:
    """Share of intervals that hold, and the mean error in standard errors (1/1.96 of half widths)."""
    scaled = [1.96 * error / half for error, half, _ in judged if half > 0.0]
    return float(np.mean([one[2] for one in judged])), float(np.mean(scaled))
