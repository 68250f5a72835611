"""Samples on their way to a recording."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from drivers.bus import Exchange
from drivers.capture_buffer import Window
from drivers.outcome import Sample, SampleBlock
from valve.recording import Acquisition, Provenance, Recording

_LATE_PERCENTILE: Final = 95.0  # the timing uncertainty is half of an exchange that only one in twenty exceeds


def gap(begun_s: float, given_up_s: float) -> Sample:
    """Return a slot in which no sample could be had."""
    return Sample(begun_s, given_up_s, math.nan, math.nan, math.nan)


class PolledRows:
    """Rows of a polled test: each with the intervals in which it was commanded and taken; a failed look is a gap."""

    def __init__(self, start_s: float) -> None:
        self.start_s = start_s
        self._rows: list[tuple[float, ...]] = []
        self._given = 0

    def add(self, sample: Sample, command_pa: float, write: Exchange | None, late_s: float) -> None:
        """Add a sample, the command in force (NaN while nobody knows) and the write that put it there, if any.

        ``late_s`` is how long after its slot it began.
        """
        lasted_s = (math.nan, math.nan) if write is None else (write.sent_s, write.received_s)
        times_s = [at_s - self.start_s for at_s in (sample.time_s, *lasted_s, sample.sent_s, sample.received_s)]
        self._rows.append((times_s[0], sample.position_m, sample.pressure_pa, command_pa, *times_s[1:], late_s))

    def fresh(self) -> SampleBlock | None:
        """Rows since the last call; None where there is none."""
        rows, self._given = self._rows[self._given :], len(self._rows)
        if not rows:
            return None
        columns = np.array(rows, dtype=np.float64).T
        time_s, position_m, pressure_pa, command_pa, write_sent_s, written_s, sent_s, received_s, late_s = columns
        return SampleBlock(
            time_s,
            position_m,
            pressure_pa,
            command_pa,
            sent_s,
            received_s,
            recorded=True,
            write_sent_s=write_sent_s,
            written_s=written_s,
            late_s=late_s,
        )

    def recording(self, provenance: Provenance) -> Recording | None:
        """Return the recording; None where there is no row."""
        if not self._rows:
            return None
        columns = np.array(self._rows, dtype=np.float64).T
        time_s, position_m, pressure_pa, command_pa, write_sent_s, written_s, sent_s, received_s, _ = columns
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
            write_sent_s=write_sent_s,
            written_s=written_s,
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
