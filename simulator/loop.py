"""An I/P or positioner whose output depends on the way that the command came: a dead band, a hysteresis loop.

With play_r(u) the output of a play of width r, which stays within r/2 of u, the output for a command u is

    play_b(u) + (4 h/D) (mean over r from 0 to D of (play_r(u) - u) + (u - u_0)/2 - D/4),

b the dead band, h the hysteresis, D the span and u_0 the command at the start. The second part is Prandtl's and
Ishlinskii's operator: the loop from u_0 over the span and back is h wide in its middle and closed at its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError
from valve.messages import say

FloatArray = npt.NDArray[np.float64]

_PLAYS: Final = 16
_WIDEST: Final = 0.125  # of the span: a wider loop would fall where the command rises


@dataclass(frozen=True, slots=True)
class Loop:
    """Dead band and hysteresis in the unit of the command, Pa. Raises ParameterError where one is not physical."""

    dead_band_pa: float
    hysteresis_pa: float
    span_pa: float

    def __post_init__(self) -> None:
        for name, size_pa in (("dead_band_pa", self.dead_band_pa), ("hysteresis_pa", self.hysteresis_pa)):
            if not 0.0 <= size_pa <= _WIDEST * self.span_pa:
                raise ParameterError(
                    say(
                        "transducer_nonlinearity_outside",
                        "the transducer's {name} is {size:g Pa}, give 0 to {most:g Pa}",
                        name=name,
                        size=size_pa,
                        most=_WIDEST * self.span_pa,
                    )
                )

    @property
    def is_neutral(self) -> bool:
        """Whether the output is the command."""
        return self.dead_band_pa == 0.0 and self.hysteresis_pa == 0.0


class LoopState:
    """A loop with what it remembers, at rest at ``start_pa`` and with its hysteresis at the low end there."""

    def __init__(self, loop: Loop, start_pa: float) -> None:
        widths_pa = (np.arange(_PLAYS) + 0.5) / _PLAYS * loop.span_pa
        self._loop, self._start_pa = loop, start_pa
        self._half_pa = 0.5 * np.concatenate([[loop.dead_band_pa], widths_pa])
        self._levels_pa = start_pa + np.concatenate([[0.0], 0.5 * widths_pa])

    def at(self, command_pa: float) -> float:
        """Go to this command and return the output, Pa."""
        loop = self._loop
        if loop.is_neutral:
            return command_pa
        self._levels_pa = np.clip(self._levels_pa, command_pa - self._half_pa, command_pa + self._half_pa)
        bent_pa = float(np.mean(self._levels_pa[1:])) - command_pa
        bent_pa += 0.5 * (command_pa - self._start_pa) - 0.25 * loop.span_pa
        return float(self._levels_pa[0]) + 4.0 * loop.hysteresis_pa / loop.span_pa * bent_pa

    def follow(self, time_s: FloatArray, command_pa: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Corners of the output for the lines through these corners of the command: one more where a play takes up.

        Both: shape (n_corners,).
        """
        if self._loop.is_neutral:
            return time_s, command_pa
        times_s, outputs_pa = [float(time_s[0])], [self.at(float(command_pa[0]))]
        for i in range(1, time_s.size):
            before_pa, now_pa = float(command_pa[i - 1]), float(command_pa[i])
            if now_pa != before_pa and time_s[i] > time_s[i - 1]:
                taken_up_pa = self._levels_pa + np.sign(now_pa - before_pa) * self._half_pa
                shares = np.unique((taken_up_pa - before_pa) / (now_pa - before_pa))
                for share in shares[(shares > 0.0) & (shares < 1.0)]:
                    times_s.append(float(time_s[i - 1] + share * (time_s[i] - time_s[i - 1])))
                    outputs_pa.append(self.at(before_pa + float(share) * (now_pa - before_pa)))
            times_s.append(float(time_s[i]))
            outputs_pa.append(self.at(now_pa))
        return np.array(times_s), np.array(outputs_pa)
