"""A test of a simulated valve without a wire: a waveform played, its recording and the truth about it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulator.packed_stem import Truth
from simulator.plant import SoftwareValve
from simulator.samples import EndedRecord
from simulator.simulated_valve import SimulatedValve
from valve.errors import WaveformError
from valve.messages import say
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform


def recorded(
    settings: SimulatedValve, waveform: Waveform, period_s: float, *, settling_s: float = 1.0, jitter_s: float = 0.0
) -> tuple[Recording, Truth]:
    """Play a waveform on a valve that has rested for long; return what is recorded each ``period_s``, and the truth.

    The valve begins at the waveform's first pressure and is recorded from ``settling_s`` after the start of its clock,
    when the waveform begins, to the waveform's end. Channels: command, pressure where there is a gauge, position.
    With ``jitter_s`` each row is taken up to so much later, at a time that it says. Raises WaveformError for a period
    that is not above 0 or a jitter that is not below it, and what simulating the valve raises.
    """
    if not (math.isfinite(period_s) and period_s > 0.0):
        raise WaveformError(
            say(
                "replay_period_not_positive",
                "sample period is {period:g s}, it must be above 0: correct it",
                period=period_s,
            )
        )
    if not 0.0 <= jitter_s < period_s:
        raise WaveformError(
            say(
                "jitter_outside",
                "jitter is {jitter:g s}, it must be 0 or above and below the period: correct it",
                jitter=jitter_s,
            )
        )
    valve = SoftwareValve(replace(settings, start_pa=float(waveform.pressure_pa[0])))
    valve.look(settling_s)
    valve.play(waveform.time_s, waveform.pressure_pa)
    rows = math.floor(waveform.duration_s / period_s * (1.0 + 1.0e-12)) + 1
    time_s = np.arange(rows, dtype=np.float64) * period_s
    if jitter_s > 0.0:
        time_s += jitter_s * np.random.default_rng([settings.packing_seed, settings.occasion]).random(rows)
        time_s = time_s[time_s <= waveform.duration_s]
    ended: list[EndedRecord] = []
    valve.on_record = lambda _tag, record: ended.append(record)
    samples = valve.advance(valve.time_s + waveform.duration_s, valve.time_s + time_s)
    assert samples is not None  # there is a row at least
    pressure_pa = None
    if settings.pressure is not None:
        pressure_pa = settings.pressure.readings(samples.gauge_pa, 0, samples.gauge_at_s)
    recording = Recording(
        time_s,
        settings.position.readings(samples.sensed_m, 0, samples.sensed_at_s),
        pressure_pa=pressure_pa,
        command_pa=samples.asked_pa,
        provenance=Provenance(Acquisition.SIMULATED, settings.tag, waveform.name, requested_period_s=period_s),
    )
    return recording, ended[0].truth
