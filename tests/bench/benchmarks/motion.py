"""How fast the exact motion is, beside the integration by fixed steps, and how exact that is."""

from __future__ import annotations

from dataclasses import astuple
from typing import Final

import numpy as np
from rich.table import Table

from tests.bench.benchmarks.timing import median_s, shown
from tests.support.fixed_step import integrate
from valve.motion import StemIntegrator, StemState, simulate_batch, simulate_motion, simulate_waveform
from valve.parameter_sets import PARAMETER_SETS, ParameterSet
from valve.waveform import triangle

DURATION_S: Final = 60.0
SAMPLE_PERIOD_S: Final = 1.0e-3
FIXED_STEP_S: Final = 1.0e-6
VALVES: Final = 1000


def _force(chosen: ParameterSet) -> tuple[np.ndarray, np.ndarray, float]:
    """Corners of three triangles of 20 s over the valve's signal range: s and N; and the area, m2."""
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    waveform = triangle(20.0, 3, *signal.range_pa)
    return waveform.time_s.copy(), area_m2 * waveform.pressure_pa, area_m2


def _one_valve(name: str, chosen: ParameterSet) -> tuple[str, ...]:
    parameters = chosen.parameters
    corner_s, corner_n, area_m2 = _force(chosen)
    signal = chosen.nameplate.signal
    assert signal is not None
    waveform = triangle(20.0, 3, *signal.range_pa)
    stem, start = StemIntegrator(parameters), StemState()
    exact = simulate_waveform(parameters, waveform, area_m2, SAMPLE_PERIOD_S)
    held = simulate_motion(parameters, exact.time_s, exact.force_n, exact.time_s)
    moving = simulate_motion(parameters, corner_s, corner_n, [5.0]).final_state

    all_s = median_s(lambda: simulate_waveform(parameters, waveform, area_m2, SAMPLE_PERIOD_S))
    events_s = median_s(lambda: stem.events(start, corner_s, corner_n), repeats=501)
    held_s = median_s(lambda: simulate_motion(parameters, exact.time_s, exact.force_n, exact.time_s))
    force_n = float(np.interp(5.0, corner_s, corner_n))
    advance_s = median_s(lambda: stem.ramp(moving, 1.0e-3, force_n, force_n + 0.5), repeats=2001)

    count, stride = round(DURATION_S / FIXED_STEP_S), round(SAMPLE_PERIOD_S / FIXED_STEP_S)
    numbers = (*astuple(parameters), -np.inf, np.inf, corner_s, corner_n)
    stepped_m = integrate(*numbers, FIXED_STEP_S, count, stride)
    fixed_s = median_s(lambda: integrate(*numbers, FIXED_STEP_S, count, stride), repeats=3)
    return (
        name,
        shown(all_s),
        shown(events_s),
        shown(held_s),
        f"{np.abs(held.position_m - exact.position_m).max():.0e} m",
        shown(advance_s),
        shown(fixed_s),
        f"{np.abs(stepped_m - exact.position_m).max():.0e} m",
        f"{fixed_s / all_s:.0f}",
    )


def single_valves() -> Table:
    """One valve at a time, 60 s of triangles at 1 ms."""
    table = Table(title="Exact motion of one valve: 3 triangles of 20 s, output every 1 ms, one core, medians")
    for heading in (
        "valve",
        "all outputs",
        "events alone",
        "input held 1 ms",
        "its difference",
        "1 ms on the wire",
        "fixed step 1e-6 s",
        "its error",
        "times slower",
    ):
        table.add_column(heading, justify="left" if heading == "valve" else "right")
    asked = ("2 ms (0.3 ms)", "microseconds", "", "1e-14 m", "20 us", "", "", "500")
    table.add_row("asked for (stretch)", *asked, end_section=True)
    for name, chosen in PARAMETER_SETS.items():
        table.add_row(*_one_valve(name, chosen))
    return table


def batch() -> Table:
    """A thousand valves of the paper's friction, each a little different, in one call."""
    rng = np.random.default_rng(1)
    chosen = PARAMETER_SETS["nominal"]
    corner_s, corner_n, _area_m2 = _force(chosen)
    valves = [
        type(chosen.parameters)(*(np.array(astuple(chosen.parameters)) * rng.uniform(0.95, 1.05, 7)).tolist())
        for _ in range(VALVES)
    ]
    time_s = np.arange(round(DURATION_S / SAMPLE_PERIOD_S) + 1) * SAMPLE_PERIOD_S
    forces_n = corner_n * rng.uniform(0.9, 1.1, (VALVES, 1))
    table = Table(title=f"{VALVES} valves, each with its own force: 60 s at 1 ms, one core")
    table.add_column("what")
    table.add_column("asked for", justify="right")
    table.add_column("reached", justify="right")
    batch_s = median_s(lambda: simulate_batch(valves, corner_s, forces_n, time_s), repeats=5, at_most_s=20.0)
    table.add_row("positions (480 MB)", "2 s", shown(batch_s))
    return table


def run() -> list[Table]:
    """Time the exact motion and the fixed steps."""
    return [single_valves(), batch()]
