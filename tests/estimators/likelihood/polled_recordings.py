"""Polled tests whose writes and looks take effect anywhere within their exchanges, as on a wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.samples import FloatArray
from simulator.transducer import lagged
from valve.motion import simulate_motion
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS
from valve.parameters import ValveParameters
from valve.recording import Acquisition, Provenance, Recording
from valve.stem import StemState
from valve.waveform import triangle

_WAY_S = 0.15e-3  # of a request or an answer, as the least
_MEAN_WAIT_S = 0.05e-3  # on top of it
_SPIKES = 0.02  # of the ways take up to 4 ms more: the machine had something else to do
_SPIKE_S = 4.0e-3
_GAPS = 0.002  # of the looks take 80 ms
_GAP_S = 0.08


@dataclass(frozen=True, slots=True)
class WrittenTest:
    """A recording of 16-bit channels, and when its writes truly came into force, s."""

    recording: Recording
    acting_s: FloatArray
    truth: ValveParameters
    nameplate: Nameplate


def converted(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return what a 16-bit converter of this range makes of the values."""
    step = (high - low) / 65534.0
    return np.asarray(low + np.rint((values - low) / step) * step)


def written_test(
    valve: str,
    seed: int,
    *,
    period_s: float = 0.02,
    noise_m: float = 2.0e-6,
    ramp_s: float = 10.0,
    cycles: int = 2,
    lag_s: float = 0.0,
    pressure_noise_pa: float = 0.6,
) -> WrittenTest:
    """A triangle over the whole range, on an I/P without lag or with one."""
    random = np.random.default_rng(seed)
    chosen = PARAMETER_SETS[valve]
    actuator, signal = chosen.nameplate.actuator, chosen.nameplate.signal
    assert actuator.diaphragm_area_m2 is not None
    assert signal is not None
    low_pa, high_pa = signal.range_pa
    wave = triangle(2.0 * ramp_s, cycles, low_pa, high_pa)

    def way_s() -> float:
        spike_s = random.uniform(0.0, _SPIKE_S) if random.random() < _SPIKES else 0.0
        return _WAY_S + float(random.exponential(_MEAN_WAIT_S)) + spike_s

    rows, slot, now_s = [], 0, 0.0
    while slot < round(wave.duration_s / period_s):
        begun_s = max(now_s, slot * period_s) + float(random.exponential(0.1e-3))
        write_sent_s = begun_s + 0.05e-3
        acting_s = write_sent_s + way_s()
        written_s = acting_s + way_s()
        sent_s = written_s + 0.1e-3
        taken_s = sent_s + way_s() + (_GAP_S if random.random() < _GAPS else 0.0)
        now_s = taken_s + way_s()
        command_pa = float(converted(wave.at(np.array([begun_s])), low_pa, high_pa)[0])
        rows.append((command_pa, write_sent_s, acting_s, written_s, sent_s, taken_s, now_s))
        slot = max(slot + 1, int(now_s / period_s + 0.5))
    command, write_sent, acting, written, sent, taken, received = np.array(rows).T
    stair_s = np.concatenate(
        [[-1.0, acting[0]], np.column_stack([acting, np.append(acting[1:], taken[-1] + 1.0)]).ravel()]
    )
    stair_pa = np.concatenate([[low_pa, low_pa], np.repeat(command, 2)])
    acting_pa = stair_pa
    if lag_s > 0.0:
        stair_s, acting_pa = lagged(stair_s, stair_pa, low_pa, lag_s)
    motion = simulate_motion(
        chosen.parameters, stair_s, actuator.diaphragm_area_m2 * acting_pa, taken, initial=StemState(0.0, 0.0)
    )
    shown_pa = command if lag_s == 0.0 else np.interp(taken, stair_s, acting_pa)
    noisy_m = motion.position_m + noise_m * random.standard_normal(taken.size)
    exchange_s = received - sent
    recording = Recording(
        0.5 * (sent + received),
        converted(noisy_m, -0.05 * actuator.travel_m, 1.05 * actuator.travel_m),
        pressure_pa=converted(
            shown_pa + pressure_noise_pa * random.standard_normal(taken.size), low_pa + 0.4, high_pa + 0.4
        ),
        command_pa=command,
        sent_s=sent,
        received_s=received,
        write_sent_s=write_sent,
        written_s=written,
        provenance=Provenance(
            acquisition=Acquisition.POLLED,
            requested_period_s=period_s,
            timing_uncertainty_s=0.5 * float(np.percentile(exchange_s, 95.0)),
        ),
    )
    return WrittenTest(recording, acting, chosen.parameters, chosen.nameplate)
