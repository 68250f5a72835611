"""What is to be played and sampled."""

from __future__ import annotations

import math
from bisect import bisect_right

from valve.waveform import Waveform


class Course:
    """A waveform and the time between its samples, s."""

    def __init__(self, waveform: Waveform, period_s: float) -> None:
        self.waveform = waveform
        self.period_s = period_s
        #: Number of samples from the waveform's start to its end, both included.
        self.samples = math.floor(waveform.duration_s / period_s + 1.0e-6) + 1
        self._time_s: list[float] = waveform.time_s.tolist()
        self._pressure_pa: list[float] = waveform.pressure_pa.tolist()

    def pressure_pa(self, time_s: float) -> float:
        """Pressure to ask for ``time_s`` after the start, Pa: ``Waveform.at`` of one time, without arrays.

        It is asked once a sample of every valve, where the arrays' overhead took a tenth of all the work.
        """
        times_s, pressures_pa = self._time_s, self._pressure_pa
        after = bisect_right(times_s, time_s)
        if after == 0:
            return pressures_pa[0]
        if after == len(times_s):
            return pressures_pa[-1]
        start_pa, end_pa = pressures_pa[after - 1], pressures_pa[after]
        share = (time_s - times_s[after - 1]) / (times_s[after] - times_s[after - 1])
        # rounding must not carry the command past a limit that the corners keep
        return min(max((1.0 - share) * start_pa + share * end_pa, min(start_pa, end_pa)), max(start_pa, end_pa))
