"""What comes off a device during a test, and what is left when the test has ended."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from drivers.stands_at import StandsAt
from valve.errors import ValveError
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sample:
    """One look at a valve: Pa and m, NaN where there is no valid value.

    ``sent_s`` and ``received_s`` are on the monotonic clock of this machine and enclose the instant of the sample.
    """

    sent_s: float
    received_s: float
    position_m: float
    pressure_pa: float
    output_pa: float
    status: int = 0
    supply_pa: float = math.nan

    @property
    def time_s(self) -> float:
        """Middle of the interval in which the sample was taken, s, monotonic clock."""
        return 0.5 * (self.sent_s + self.received_s)


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlock:
    """Samples as they come in, each channel of shape (n,); time counts from the start of the waveform.

    ``recorded`` says whether they belong to the recording: a captured test is also watched by polling, and those
    samples are for the eye alone. ``sent_s`` and ``received_s`` are there for polled samples, ``write_sent_s`` and
    ``written_s`` (between which the command was written) for those that were commanded from here, ``late_s`` (how long
    after its slot began) where there is a grid of slots.
    """

    time_s: FloatArray
    position_m: FloatArray
    pressure_pa: FloatArray
    command_pa: FloatArray
    sent_s: FloatArray | None
    received_s: FloatArray | None
    recorded: bool
    write_sent_s: FloatArray | None = None
    written_s: FloatArray | None = None
    late_s: FloatArray | None = None


class Ended(StrEnum):
    """How a test ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class SafeOutcome:
    """What became of a valve that was sent to its safe value.

    ``confirmed`` is True only where the device was seen to show the safe value; otherwise ``reason`` says why not.
    ``output_pa`` is the output that it showed last, Pa, NaN where it showed none. It says nothing of the stem.
    """

    confirmed: bool
    output_pa: float = math.nan
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Recovered:
    """How a valve was found, or left: ``safe`` says whether its device shows the safe value, and if not why not.

    ``sent`` is whether a command for it was written.
    """

    safe: SafeOutcome
    sent: bool = False


@dataclass(frozen=True, slots=True)
class PlayOutcome:
    """What is left of a test: the recording (None where no sample was taken) and the state of the valve.

    ``safe_confirmed`` is True only where the safe value was read back from the device, otherwise ``why_unsafe`` says
    why not; ``writes`` counts the write requests that were sent; ``commanded`` is False only where nothing was sent
    that can move the valve. ``stands`` is where the last sample showed the valve, as its stem may move on.
    ``ended_early_s`` is how long the waveform was played, s, where the test completed before its end because enough is
    known; None otherwise.
    """

    recording: Recording | None
    ended: Ended
    safe_confirmed: bool
    error: ValveError | None = None
    notes: tuple[str, ...] = field(default_factory=tuple)
    writes: int = 0
    commanded: bool = True
    stands: StandsAt | None = None
    why_unsafe: str = ""
    ended_early_s: float | None = None
