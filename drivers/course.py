"""What is to be played and sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass

from valve.waveform import Waveform


@dataclass(frozen=True, slots=True)
class Course:
    """A waveform and the time between its samples, s."""

    waveform: Waveform
    period_s: float

    @property
    def samples(self) -> int:
        """Number of samples from the waveform's start to its end, both included."""
        return math.floor(self.waveform.duration_s / self.period_s + 1.0e-6) + 1
