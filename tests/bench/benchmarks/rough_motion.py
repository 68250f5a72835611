"""How fast rough valves are simulated by fixed steps, and how far an ideal one is from the exact motion."""

from __future__ import annotations

import math
import time
from typing import Final

import numpy as np
from rich.table import Table

from simulator.packed_stem import STEP_S, PackedStem
from simulator.plant import SoftwareValve
from tests.support.rough_valves import SEQUENCES, VALVES, case, rough_valve, sequence
from valve.extended_valve import ExtendedValve
from valve.motion import StemState, simulate_motion
from valve.packing import NO_ROUGHNESS, Packing

POLLED_S: Final = 20.0
POLL_S: Final = 0.02


def _error_m(valve: str, sequence_name: str) -> float:
    """Largest difference of an ideal packing's stem from the exact motion, each ms, m."""
    parameters, nameplate = VALVES[valve]
    area_m2, wave = nameplate.actuator.diaphragm_area_m2, sequence(sequence_name, nameplate)
    assert area_m2 is not None
    times_s = np.arange(math.floor(wave.duration_s * 1.0e3) + 1, dtype=np.float64) * 1.0e-3
    force_n = area_m2 * wave.pressure_pa
    start_m = float(force_n[0] - parameters.preload_n) / parameters.spring_rate_n_per_m
    exact = simulate_motion(parameters, wave.time_s, force_n, times_s, initial=StemState(start_m))
    stem = PackedStem(ExtendedValve(parameters), Packing(), NO_ROUGHNESS, start_m)
    return float(np.abs(stem.motion(wave.time_s, force_n, times_s).position_m - exact.position_m).max())


def _record_s(valve: str, sequence_name: str) -> float:
    """Processor time of one recording at 1 ms, usual packing and instruments, s."""
    before_s = time.process_time()
    case(valve, sequence_name, "usual")
    return time.process_time() - before_s


def _polled_share(valve: str) -> float:
    """Share of a core that a usual valve takes which is commanded and read every POLL_S."""
    settings = rough_valve(valve, "usual", 0)
    wave, software = sequence("triangle", settings.nameplate), SoftwareValve(settings)
    before_s = time.process_time()
    for at_s in np.arange(POLL_S, POLLED_S, POLL_S).tolist():
        software.look(at_s)
        software.ask(float(wave.at(at_s)))
        software.read_position_m()
        software.read_pressure_pa()
    return (time.process_time() - before_s) / POLLED_S


def run() -> Table:
    """Return the table."""
    table = Table(title=f"Rough valves, fixed steps of {1.0e6 * STEP_S:.0f} us: 60 s at 1 ms, packing usual")
    for heading in (
        "valve",
        "sequence",
        "processor time, s",
        "polled every 20 ms, share of a core",
        "ideal: error, um",
    ):
        table.add_column(heading, justify="left" if heading in {"valve", "sequence"} else "right")
    _record_s("nominal", "triangle")  # compiled, or loaded
    for valve in VALVES:
        share = _polled_share(valve)
        for sequence_name in SEQUENCES:
            error_um = 1.0e6 * _error_m(valve, sequence_name)
            seconds = _record_s(valve, sequence_name)
            table.add_row(valve, sequence_name, f"{seconds:.2f}", f"{share:.3f}", f"{error_um:.3f}")
    return table
