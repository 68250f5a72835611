"""Samples on their way to a recording."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from drivers.capture_buffer import Window
from drivers.outcome import Sample, SampleBlock
from valve.recording import Acquisition, Provenance, Recording

_LATE_PERCENTILE: Final = 95.0  # the timing uncertainty is half of an exchange that only one in twenty exceeds


class PolledRows:
    """Rows of a polled test: each with the interval in which it was taken; a look that failed is a row of gaps."""

    def __init__(self, start_s: float) -> None:
        self._start_s = start_s
        self._rows: list[tuple[float, float, float, float, float, float]] = []
        self._given = 0

    def add(self, sample: Sample, command_pa: float) -> None:
        """Add a sample and the command that was in force."""
        self._append(sample.sent_s, sample.received_s, sample.position_m, sample.pressure_pa, command_pa)

    def add_gap(self, begun_s: float, given_up_s: float) -> None:
        """Add a slot in which no sample could be had."""
        self._append(begun_s, given_up_s, math.nan, math.nan, math.nan)

    def _append(self, sent_s: float, received_s: float, *values: float) -> None:
        sent_s, received_s = sent_s - self._start_s, received_s - self._start_s
        position_m, pressure_pa, command_pa = values
        self._rows.append((0.5 * (sent_s + received_s), position_m, pressure_pa, command_pa, sent_s, received_s))

    def fresh(self) -> SampleBlock | None:
        """Rows since the last call; None where there is none."""
        rows, self._given = self._rows[self._given :], len(self._rows)
        if not rows:
            return None
        time_s, position_m, pressure_pa, command_pa, sent_s, received_s = np.array(rows, dtype=np.float64).T
        return SampleBlock(time_s, position_m, pressure_pa, command_pa, sent_s, received_s, recorded=True)

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return the recording; None where there is no row."""
        if not self._rows:
            return None
        time_s, position_m, pressure_pa, command_pa, sent_s, received_s = np.array(self._rows, dtype=np.float64).T
        taken = np.isfinite(position_m)
        exchanges_s = (received_s - sent_s)[taken if taken.any() else slice(None)]
        uncertainty_s = 0.5 * float(np.percentile(exchanges_s, _LATE_PERCENTILE))
        return Recording(
            time_s,
            position_m,
            pressure_pa=pressure_pa if np.isfinite(pressure_pa).any() else None,
            command_pa=command_pa,
            sent_s=sent_s,
            received_s=received_s,
            provenance=replace(provenance, acquisition=Acquisition.POLLED, timing_uncertainty_s=uncertainty_s),
        )


class CapturedRows:
    """Rows of a captured test: sample i was taken i periods after the start, by the device's own clock."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._windows: list[Window] = []

    def add(self, window: Window) -> SampleBlock:
        """Add a window; returns it as samples."""
        self._windows.append(window)
        time_s = np.arange(window.first, window.first + window.position_m.size, dtype=np.float64) * self._period_s
        return SampleBlock(time_s, window.position_m, window.pressure_pa, window.command_pa, None, None, recorded=True)

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return the recording; None where nothing was fetched."""
        if not self._windows:
            return None
        position_m = np.concatenate([window.position_m for window in self._windows])
        pressure_pa = np.concatenate([window.pressure_pa for window in self._windows])
        return Recording(
            np.arange(position_m.size, dtype=np.float64) * self._period_s,
            position_m,
            pressure_pa=pressure_pa if np.isfinite(pressure_pa).any() else None,
            command_pa=np.concatenate([window.command_pa for window in self._windows]),
            provenance=replace(provenance, acquisition=Acquisition.CAPTURED),
        )
