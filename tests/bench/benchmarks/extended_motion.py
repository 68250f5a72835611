"""How fast the extended motion is, slot by slot, and how far it is from a plain integration by fixed steps."""

from __future__ import annotations

from typing import Final

import numpy as np
from rich.table import Table

from tests.bench.benchmarks.timing import median_s, shown
from tests.support.extended_reference import integrate
from valve.effects import EFFECTS, ValveScale, with_effects
from valve.extended_motion import ExtendedStem, input_corners, simulate_extended
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.motion import StemState, simulate_motion
from valve.parameter_sets import PARAMETER_SETS, ParameterSet
from valve.waveform import triangle

VALVES: Final = ("vendor", "nominal", "graphite")
STRENGTH: Final = 2.0
REFERENCE_STEP_S: Final = 2.0e-6
COURSE_S: Final = np.array([0.0, 0.8, 1.3, 1.5, 2.0])
COURSE: Final = np.array([0.0, 1.0, 0.35, 0.35, 0.9])
SEVERAL: Final = ("local_friction", "friction_drift", "friction_asymmetry", "spring_hardening", "position_lag")


def _sizes(chosen: ParameterSet) -> tuple[float, float, ValveScale]:
    """Lowest and highest actuator force, N, and the valve's scale."""
    area_m2, signal = chosen.nameplate.actuator.diaphragm_area_m2, chosen.nameplate.signal
    assert area_m2 is not None
    assert signal is not None
    low_n, high_n = (area_m2 * pressure_pa for pressure_pa in signal.range_pa)
    return low_n, high_n, ValveScale.of(chosen.parameters, chosen.nameplate.actuator.travel_m, high_n)


def _with(chosen: ParameterSet, causes: tuple[str, ...]) -> ExtendedValve:
    scale = _sizes(chosen)[2]
    return with_effects(
        ExtendedValve(chosen.parameters), [EFFECTS[cause].of_strength(STRENGTH, scale) for cause in causes]
    )


def _timed(chosen: ParameterSet, valve: ExtendedValve, period_s: float) -> str:
    """Time of 60 s of triangles with input and output at ``period_s``."""
    low_n, high_n, _scale = _sizes(chosen)
    waveform = triangle(20.0, 3, low_n, high_n)
    time_s = np.arange(round(60.0 / period_s) + 1, dtype=np.float64) * period_s
    if period_s > 0.01:
        time_s[1:-1] += np.random.default_rng(1).uniform(-0.2, 0.2, time_s.size - 2) * period_s
    corners = input_corners(valve.input, time_s, waveform.at(time_s), 60.0)
    stem, start = ExtendedStem(valve), ExtendedState(StemState(max(valve.stops.low_m, 0.0)))
    return shown(median_s(lambda: stem.motion(start, *corners, time_s), repeats=15))


def _exact(chosen: ParameterSet) -> str:
    """Time of the same by the exact motion, which knows no effect."""
    low_n, high_n, _scale = _sizes(chosen)
    time_s = np.arange(60_001, dtype=np.float64) * 1.0e-3
    force_n = triangle(20.0, 3, low_n, high_n).at(time_s)
    return shown(median_s(lambda: simulate_motion(chosen.parameters, time_s, force_n, time_s), repeats=15))


def _error_um(chosen: ParameterSet, valve: ExtendedValve) -> str:
    """Largest and rms difference to the reference over 2 s, um."""
    force_n = _sizes(chosen)[1] * COURSE
    time_s = np.arange(2001) * 1.0e-3
    _position_m, expected_m = integrate(valve, COURSE_S, force_n, 2.0, 1.0e-3, REFERENCE_STEP_S)
    start = ExtendedState(StemState(max(valve.stops.low_m, 0.0)))
    found_m = simulate_extended(valve, COURSE_S, force_n, time_s, initial=start).sensed_m
    error_um = 1.0e6 * (found_m - expected_m)
    return f"{np.abs(error_um).max():.2f} / {np.sqrt(np.mean(error_um**2)):.2f}"


def speed() -> Table:
    """60 s at 1 ms, and polled at 50 ms with jittered times, one effect after the other."""
    table = Table(
        title=f"Extended motion: 60 s, 3 triangles of 20 s, effects at {STRENGTH:g} x typical, one core, medians"
    )
    table.add_column("hidden")
    for name in VALVES:
        table.add_column(f"{name} 1 ms", justify="right")
        table.add_column("50 ms", justify="right")
    table.add_row("asked for", *(["1-5 ms", ""] * len(VALVES)), end_section=True)
    exact = [cell for name in VALVES for cell in (_exact(PARAMETER_SETS[name]), "")]
    table.add_row("the exact motion", *exact)
    for label, causes in (("nothing", ()), *((cause, (cause,)) for cause in EFFECTS), ("five at once", SEVERAL)):
        row = []
        for name in VALVES:
            valve = _with(PARAMETER_SETS[name], causes)
            row += [_timed(PARAMETER_SETS[name], valve, 1.0e-3), _timed(PARAMETER_SETS[name], valve, 0.05)]
        table.add_row(label, *row)
    return table


def accuracy() -> Table:
    """Every effect against fixed steps."""
    table = Table(title="Extended motion against fixed steps of 2 us, 2 s with two breakaways: largest / rms, um")
    table.add_column("hidden")
    for name in VALVES:
        table.add_column(name, justify="right")
    for label, causes in (("nothing", ()), *((cause, (cause,)) for cause in EFFECTS), ("five at once", SEVERAL)):
        table.add_row(label, *(_error_um(PARAMETER_SETS[name], _with(PARAMETER_SETS[name], causes)) for name in VALVES))
    return table


def run() -> list[Table]:
    """Time the extended motion and compare it with fixed steps."""
    return [speed(), accuracy()]
