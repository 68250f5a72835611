"""A valve in service: a flow loop under a PI controller with disturbances, recorded, with the truth about the valve."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from simulator.packed_stem import Truth
from simulator.plant import SoftwareValve
from simulator.samples import EndedRecord
from tests.support.rough_valves import rough_valve
from valve.nameplate import Nameplate
from valve.recording import Acquisition, FloatArray, Provenance, Recording

_SCAN_S: Final = 0.5  # of the controller
_PROCESS_S: Final = 15.0  # time constant of the flow
_GAIN: Final = 0.6
_RESET_S: Final = 15.0
_LOAD_S: Final = 240.0  # time constant of the disturbance
_SETPOINT_S: Final = 1800.0  # mean time between changes of the set point
_FLOW_NOISE: Final = 1.0e-3
_ENDS: Final = (0.03, 0.97)  # the controller's output stays within


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """What a historian has of a loop, the valve's nameplate and the truth about its friction."""

    recording: Recording
    nameplate: Nameplate
    truth: Truth


def loop(
    valve: str,
    hours: float,
    period_s: float,
    seed: int,
    *,
    grade: str = "usual",
    disturbance: float = 0.03,
    setpoint_step: float = 0.05,
    reset_s: float = _RESET_S,
    **changes: Any,
) -> Loop:
    """Return a loop of so many hours with rows every ``period_s``; the same arguments give the same loop.

    ``disturbance``: standard deviation of the load, share of the flow. ``setpoint_step``: the same of the set point's
    changes. ``valve``, ``grade`` and ``changes`` as in ``rough_valve``.
    """
    settings = rough_valve(valve, grade, seed, **changes)
    assert settings.nameplate.signal is not None
    assert settings.nameplate.actuator.bench_set_pa is not None
    low_pa, high_pa = settings.nameplate.actuator.bench_set_pa
    travel_m = settings.nameplate.actuator.travel_m
    random = np.random.default_rng([seed, 0x100])
    scans = round(3600.0 * hours / _SCAN_S)
    keep, drive = math.exp(-_SCAN_S / _LOAD_S), math.sqrt(1.0 - math.exp(-2.0 * _SCAN_S / _LOAD_S))
    load_noise, flow_noise = disturbance * random.standard_normal(scans), _FLOW_NOISE * random.standard_normal(scans)
    changes_at = random.random(scans) < _SCAN_S / _SETPOINT_S
    steps = setpoint_step * random.standard_normal(scans)

    device = SoftwareValve(replace(settings, start_pa=0.5 * (low_pa + high_pa)))
    device.look(1.0)
    ended: list[EndedRecord] = []
    device.on_record = lambda _tag, record: ended.append(record)
    start_s, rows, pieces = device.time_s, round(_SCAN_S / period_s) if period_s < _SCAN_S else 1, []
    every = max(1, round(period_s / _SCAN_S))
    flow = setpoint = output = 0.5
    load, integral = 0.0, 0.5
    nothing = np.empty(0)
    for scan in range(scans):
        load = keep * load + drive * load_noise[scan]
        if changes_at[scan]:
            setpoint = min(max(setpoint + steps[scan], 0.25), 0.75)
        error = setpoint - flow - flow_noise[scan]
        integral = min(max(integral + _GAIN * error * _SCAN_S / reset_s, _ENDS[0]), _ENDS[1])
        output = min(max(integral + _GAIN * error, _ENDS[0]), _ENDS[1])
        device.ask(low_pa + output * (high_pa - low_pa))
        until_s = start_s + _SCAN_S * (scan + 1)
        wanted_s: FloatArray = until_s - _SCAN_S + min(period_s, _SCAN_S) * np.arange(1, rows + 1, dtype=np.float64)
        wanted_s[-1] = until_s
        samples = device.advance(until_s, wanted_s if scan % every == 0 else nothing)
        if samples is not None:
            pieces.append((wanted_s, samples))
        flow += (device.stem.position_m / travel_m + load - flow) * (1.0 - math.exp(-_SCAN_S / _PROCESS_S))
    device.advance(device.time_s + 60.0)
    time_s = np.concatenate([wanted_s for wanted_s, _ in pieces]) - start_s

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(samples, name) for _, samples in pieces])

    pressure = settings.pressure
    assert pressure is not None
    recording = Recording(
        time_s,
        settings.position.readings(joined("sensed_m"), 0, joined("sensed_at_s")),
        pressure_pa=pressure.readings(joined("gauge_pa"), 0, joined("gauge_at_s")),
        command_pa=joined("asked_pa"),
        provenance=Provenance(Acquisition.SIMULATED, settings.tag, "loop", requested_period_s=period_s),
    )
    return Loop(recording, settings.nameplate, ended[-1].truth)


def reported_by_exception(made: Loop, *, position: float = 1.0e-3, pressure: float = 2.0e-3) -> Recording:
    """Return the rows that a historian keeps: those that differ from the last one kept by these shares of the spans.

    Every ten minutes one is kept in any case.
    """
    recording, signal = made.recording, made.nameplate.signal
    assert recording.pressure_pa is not None
    assert signal is not None
    position_m = position * made.nameplate.actuator.travel_m
    pressure_pa = pressure * (signal.range_pa[1] - signal.range_pa[0])
    kept = np.zeros(recording.samples, bool)
    rows = zip(recording.time_s.tolist(), recording.position_m.tolist(), recording.pressure_pa.tolist(), strict=True)
    last = (-math.inf, math.inf, math.inf)
    for number, (at_s, at_m, at_pa) in enumerate(rows):
        if at_s - last[0] >= 600.0 or abs(at_m - last[1]) > position_m or abs(at_pa - last[2]) > pressure_pa:
            kept[number], last = True, (at_s, at_m, at_pa)
    return recording.rows(kept)
