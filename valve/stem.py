"""The stem: the modes of its motion, its state, and the record of a simulated motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError
from valve.messages import say

FloatArray = npt.NDArray[np.float64]
ModeArray = npt.NDArray[np.int8]


class Mode(IntEnum):
    """What the stem does between two events."""

    STUCK = 0  # at rest, held by static friction: |F| <= F_s
    BAND = 1  # |v| < DV and |F| > F_s: accelerated by what exceeds F_s (Eq. 2, third line)
    SLIP = 2  # |v| >= DV: Coulomb and viscous friction
    SLIDE = 3  # v = +-DV while F_s < |F| < F_c + F_v DV (Filippov's solution on the edge of the band)
    STOPPED = 4  # at rest on a travel stop


@dataclass(frozen=True, slots=True)
class StemState:
    """All that the stem's future depends on beside the force, SI; by default at rest at 0.

    The mode decides only where position, velocity and force leave it open to rounding.
    Raises ParameterError where a value is not finite.
    """

    position_m: float = 0.0
    velocity_m_per_s: float = 0.0
    mode: Mode = Mode.STUCK

    def __post_init__(self) -> None:
        if not (math.isfinite(self.position_m) and math.isfinite(self.velocity_m_per_s)):
            raise ParameterError(
                say(
                    "stem_state_not_finite",
                    "stem state: position {position} m and velocity {velocity} m/s must be finite numbers: correct "
                    "them",
                    position=self.position_m,
                    velocity=self.velocity_m_per_s,
                )
            )


@dataclass(frozen=True, slots=True, eq=False)
class ModeChanges:
    """The events of a motion, shape (n,): when the mode changed, s, and to which (a Mode as int8)."""

    time_s: FloatArray
    mode: ModeArray

    def __len__(self) -> int:
        return int(self.time_s.size)

    def times_of(self, mode: Mode) -> FloatArray:
        """Return the times at which ``mode`` began, s; those of Mode.BAND are the breakaways."""
        return np.asarray(self.time_s[self.mode == mode])


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A simulated motion, arrays of shape (n,) at ``time_s``; at an event the values after it count."""

    time_s: FloatArray
    position_m: FloatArray
    velocity_m_per_s: FloatArray
    mode: ModeArray
    force_n: FloatArray
    events: ModeChanges
    final_state: StemState
