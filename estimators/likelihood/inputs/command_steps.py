"""The command of a polled test: a staircase, each tread of which begins with a write."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.inputs.row_timing import write_doubts_s
from estimators.likelihood.inputs.write_instants import lateness_s
from estimators.samples import FloatArray
from valve.nameplate import Nameplate, Signal
from valve.recording import Acquisition, Recording

# NE 43: 3.8 to 20.5 mA is a signal that a 4 to 20 mA input still follows; beyond it does not.
_BELOW_RANGE: Final = 0.2 / 16.0
_ABOVE_RANGE: Final = 0.5 / 16.0
_FEWEST_STEPS: Final = 12


def within_signal(asked_n: FloatArray, nameplate: Nameplate) -> FloatArray:
    """Return a command, as a force, N, shape (n,), cut off where an I/P saturates: at 3.8 and 20.5 of 4 to 20 mA."""
    signal: Signal | None = nameplate.signal
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if signal is None or area_m2 is None:
        return asked_n
    low_pa, high_pa = signal.range_pa
    span_pa = high_pa - low_pa
    return np.clip(asked_n, area_m2 * (low_pa - _BELOW_RANGE * span_pa), area_m2 * (high_pa + _ABOVE_RANGE * span_pa))


@dataclass(frozen=True, slots=True, eq=False)
class WrittenSteps:
    """When the command stepped, s, the level that it stepped to, N, and one standard deviation of when, all (k,)."""

    step_s: FloatArray
    level_n: FloatArray
    doubt_s: FloatArray


def written_steps(recording: Recording, asked_n: FloatArray) -> WrittenSteps | None:
    """Return the steps of the command, or None.

    A polled row is written first and read then (drivers/mover.py): in the middle of its write's exchange, where the
    recording tells that; else before the row's request was sent, by about half of ``write_lead_s``, and by as much more
    as the request was late. A slot that failed leaves the command as it was. None where the rows are not the writes:
    the recording was not polled, or has too few steps.
    """
    if recording.provenance.acquisition is not Acquisition.POLLED:
        return None
    sent_s = recording.time_s if recording.sent_s is None else recording.sent_s
    rows = np.flatnonzero(np.isfinite(asked_n) & np.isfinite(sent_s))
    if rows.size == 0:
        return None
    level_n, half_s = asked_n[rows], 0.5 * write_lead_s(recording)
    late_s = np.clip(lateness_s(sent_s[rows], level_n), -half_s, recording.sample_period_s)
    first = np.concatenate([[True], np.diff(level_n) != 0.0])
    if int(first.sum()) < _FEWEST_STEPS:
        return None
    at_s = sent_s[rows] - late_s - half_s
    if recording.write_sent_s is not None and recording.written_s is not None:
        middle_s = 0.5 * (recording.write_sent_s + recording.written_s)[rows]
        at_s = np.where(np.isfinite(middle_s), middle_s, at_s)
    doubt_s = write_doubts_s(recording, rows[first])
    return WrittenSteps(np.maximum.accumulate(at_s[first]), level_n[first], doubt_s)


def write_lead_s(recording: Recording) -> float:
    """Within which time a row's write was carried out, s: half of the rows took no longer.

    Between its request and its confirmation where the recording tells them. Else a row's write begins with its slot of
    the grid; without the grid it takes what a look takes, and a thousandth of a period at least.
    """
    if recording.write_sent_s is not None and recording.written_s is not None:
        lasted_s = (recording.written_s - recording.write_sent_s)[np.isfinite(recording.written_s)]
        if lasted_s.size:
            return float(np.median(lasted_s))
    period_s, slot_s = recording.sample_period_s, recording.provenance.requested_period_s
    exchange_s = recording.sampling_quality().median_exchange_s or 0.0
    least_s = max(exchange_s, 1.0e-3 * period_s)
    if recording.sent_s is None or slot_s is None:
        return least_s
    sent_s = recording.sent_s[np.isfinite(recording.sent_s)]
    return float(np.clip(np.median(np.mod(sent_s, slot_s)), least_s, max(period_s, least_s)))


def stair_corners(step_s: FloatArray, level_n: FloatArray, last_s: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the staircase, shape (2k,): two at each step but the first, and the end of the last tread."""
    ends_s = np.concatenate([step_s[1:], [max(last_s, float(step_s[-1]))]])
    return np.column_stack([step_s, ends_s]).ravel(), np.repeat(level_n, 2)
