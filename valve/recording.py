"""A recording: the channels of one test, with their gaps and where they come from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import RecordingError
from valve.messages import Message, say
from valve.nameplate import Nameplate

FloatArray = npt.NDArray[np.float64]

# The channels of a recording beside time, as they are called in files.
_BOTH_SIGNS: Final = 0.05  # of the larger side: a gauge's zero and its noise are smaller
CHANNELS: Final = ("command_pa", "pressure_pa", "force_n", "position_m")
# Polled data only, on the recording's clock: when the write of a row's command went out and was confirmed (NaN where
# the row wrote none), and when the sample's request went out and its answer was there.
INTERVAL_CHANNELS: Final = ("write_sent_s", "written_s", "sent_s", "received_s")


def clock_set_back(source: str, row: int, before_s: float, after_s: float) -> Message:
    """Return what is said where time goes back once, at a row counted from 1."""
    return say(
        "clock_set_back",
        "{source}: the clock goes back once, by {back:.6g} s at row {row}, from {before:.7g} to {after:.7g} s: it was "
        "set back there, as at the end of summer time, or two parts are in the wrong order: cut the file there and "
        "give the parts by themselves, or export in UTC",
        source=source,
        back=before_s - after_s,
        row=row,
        before=before_s,
        after=after_s,
    )


class Acquisition(StrEnum):
    """How the samples were taken."""

    POLLED = "polled"  # one request and one answer a sample, timed by us
    CAPTURED = "captured"  # by the device's own clock, uploaded afterwards
    SIMULATED = "simulated"  # computed in this process
    FILE = "file"  # from a file that does not say


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a recording comes from; every field is written to and read from its file."""

    acquisition: Acquisition = Acquisition.FILE
    tag: str = ""
    sequence: str = ""
    started_at: str = ""  # ISO 8601 with offset
    software: str = ""
    device: str = ""
    requested_period_s: float | None = None
    timing_uncertainty_s: float | None = None
    notes: str = ""


@dataclass(frozen=True, slots=True)
class SamplingQuality:
    """How evenly the samples were taken."""

    achieved_rate_hz: float
    median_period_s: float
    jitter_rms_s: float  # of the periods about their median
    largest_period_s: float
    missed_slots: int  # samples that were asked for and are not there
    median_exchange_s: float | None  # from request to answer; None where it was not recorded


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Channels of one test, all of shape (n,): s, Pa, N and m; NaN is a gap and is never filled in.

    ``position_m`` and one of command, pressure and force are required. Time must be finite and must increase;
    it need not be evenly spaced. Raises RecordingError where these do not hold.
    """

    time_s: FloatArray
    position_m: FloatArray
    pressure_pa: FloatArray | None = None
    command_pa: FloatArray | None = None
    force_n: FloatArray | None = None
    sent_s: FloatArray | None = None
    received_s: FloatArray | None = None
    write_sent_s: FloatArray | None = None
    written_s: FloatArray | None = None
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        time_s = np.asarray(self.time_s, dtype=np.float64)
        if time_s.ndim != 1 or time_s.size == 0:
            raise RecordingError(say("no_sample", "recording: it has no sample, give one with at least 2"))
        for name in ("time_s", *CHANNELS, *INTERVAL_CHANNELS):
            channel = getattr(self, name)
            if channel is None:
                continue
            column = np.array(channel, dtype=np.float64)
            if column.shape != time_s.shape:
                raise RecordingError(
                    say(
                        "column_unequal",
                        "recording: {name} has {count} values and time_s has {times}, they must be as many",
                        name=name,
                        count=int(column.size),
                        times=int(time_s.size),
                    )
                )
            if np.isinf(column).any():
                raise RecordingError(
                    say(
                        "infinite_at_row",
                        "recording: {name} is infinite at row {row}",
                        name=name,
                        row=int(np.isinf(column).argmax()) + 1,
                    )
                )
            column.setflags(write=False)
            object.__setattr__(self, name, column)
        if not np.isfinite(time_s).all():
            raise RecordingError(
                say(
                    "time_missing_at_row",
                    "recording: time_s is missing at row {row}",
                    row=int(np.isnan(time_s).argmax()) + 1,
                )
            )
        falling = np.flatnonzero(np.diff(time_s) <= 0.0)
        if falling.size:
            row = int(falling[0]) + 1
            raise RecordingError(
                say(
                    "time_falls_at_row",
                    "recording: time_s goes from {before:g} to {after:g} s at row {number}, it must increase: put the "
                    "rows in order and remove doubled ones",
                    before=float(time_s[row - 1]),
                    after=float(time_s[row]),
                    number=row + 1,
                )
            )
        if all(getattr(self, name) is None for name in CHANNELS[:3]):
            raise RecordingError(
                say(
                    "position_without_input",
                    "recording: it has a position and no command, pressure or force: add one of these",
                )
            )

    @property
    def samples(self) -> int:
        """Number of rows, gaps included."""
        return int(self.time_s.size)

    @property
    def duration_s(self) -> float:
        """From the first row to the last, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def sample_period_s(self) -> float:
        """Median time between rows, s; NaN with fewer than two rows."""
        return float(np.median(np.diff(self.time_s))) if self.samples > 1 else float("nan")

    @property
    def is_evenly_sampled(self) -> bool:
        """Whether every period is the median one to within 1 part in 1000."""
        periods_s = np.diff(self.time_s)
        return periods_s.size > 0 and bool(np.ptp(periods_s) <= 1.0e-3 * np.median(periods_s))

    @property
    def complete(self) -> npt.NDArray[np.bool_]:
        """Shape (n,): True where no recorded channel has a gap."""
        present = np.isfinite(self.position_m)
        for name in CHANNELS[:3]:
            channel = getattr(self, name)
            if channel is not None:
                present = present & np.isfinite(channel)
        return np.asarray(present)

    @property
    def gaps(self) -> int:
        """Number of runs of consecutive rows in which a recorded channel is missing."""
        missing = ~self.complete
        return int(np.count_nonzero(missing[1:] & ~missing[:-1]) + (1 if missing[0] else 0))

    @property
    def takes_both_signs(self) -> bool:
        """Whether the pressure falls as clearly below zero as above it: the difference of two chambers' pressures."""
        if self.pressure_pa is None or not np.isfinite(self.pressure_pa).any():
            return False
        low_pa, high_pa = np.nanpercentile(self.pressure_pa, (1.0, 99.0))
        return bool(low_pa < -_BOTH_SIGNS * high_pa < 0.0 and high_pa > -_BOTH_SIGNS * low_pa)

    def actuator_force_n(self, nameplate: Nameplate) -> FloatArray:
        """Force of the actuator, N, shape (n,): measured, or S_a P (Eq. 1), or S_a times the command.

        Raises RecordingError where the diaphragm area is needed and unknown.
        """
        if self.force_n is not None:
            return self.force_n
        pressure_pa = self.pressure_pa if self.pressure_pa is not None else self.command_pa
        area_m2 = nameplate.actuator.diaphragm_area_m2
        if area_m2 is None or pressure_pa is None:
            raise RecordingError(
                say(
                    "no_area_for_force",
                    "{tag}: the recording has a pressure and the nameplate no actuator.diaphragm_area_m2, the force is "
                    "their product: add the area",
                    tag=nameplate.tag,
                )
            )
        return np.asarray(pressure_pa * area_m2)

    def sampling_quality(self) -> SamplingQuality:
        """Achieved rate, jitter and missed slots; slots are counted against the requested period where it is known.

        Raises RecordingError with fewer than two rows.
        """
        if self.samples < 2:
            raise RecordingError(
                say(
                    "one_sample_no_rate",
                    "recording: {count} sample, the sampling rate needs at least 2",
                    count=self.samples,
                )
            )
        periods_s = np.diff(self.time_s)
        median_s = float(np.median(periods_s))
        slot_s = self.provenance.requested_period_s or median_s
        due = round(self.duration_s / slot_s) + 1
        taken = int(np.count_nonzero(self.complete))
        exchange_s: float | None = None
        if self.sent_s is not None and self.received_s is not None:
            exchange_s = float(np.nanmedian(self.received_s - self.sent_s))
        return SamplingQuality(
            achieved_rate_hz=taken / self.duration_s,
            median_period_s=median_s,
            jitter_rms_s=float(np.sqrt(np.mean((periods_s - median_s) ** 2))),
            largest_period_s=float(periods_s.max()),
            missed_slots=max(0, due - taken),
            median_exchange_s=exchange_s,
        )

    def rows(self, keep: npt.NDArray[np.bool_] | slice) -> Recording:
        """Return the recording with only the rows that ``keep``, shape (n,), selects."""

        def chosen(channel: FloatArray | None) -> FloatArray | None:
            return None if channel is None else channel[keep]

        return replace(
            self,
            time_s=self.time_s[keep],
            position_m=self.position_m[keep],
            pressure_pa=chosen(self.pressure_pa),
            command_pa=chosen(self.command_pa),
            force_n=chosen(self.force_n),
            sent_s=chosen(self.sent_s),
            received_s=chosen(self.received_s),
            write_sent_s=chosen(self.write_sent_s),
            written_s=chosen(self.written_s),
        )
