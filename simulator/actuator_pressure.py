"""The pressure at a simulated actuator, followed piece by piece, and what its gauge's filter makes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from simulator.loop import LoopState
from simulator.transducer import Transducer, lagged, limited, value_at

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AirState:
    """What the plant does to the air now: what can reach the actuator, Pa, and faults of the I/P.

    ``stuck``: the pressure stays as it is; ``runaway_pa``: it goes there whatever is asked for.
    """

    reaching_pa: float
    stuck: bool = False
    runaway_pa: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PressureCourse:
    """A piece of the pressure's course: corners from 0 s, straight lines between, of the true one and the gauge's."""

    after_s: FloatArray
    pressure_pa: FloatArray
    gauge_s: FloatArray
    gauge_pa: FloatArray

    def at(self, wanted_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pressure and what the gauge's filter shows at these times, Pa, shape as given."""
        pressure_pa = value_at(self.after_s, self.pressure_pa, wanted_s)
        if self.gauge_s is self.after_s:
            return pressure_pa, pressure_pa
        return pressure_pa, value_at(self.gauge_s, self.gauge_pa, wanted_s)


class ActuatorPressure:
    """The pressure that a transducer gives, settled at the start; ``filter_s`` is its gauge's."""

    def __init__(self, transducer: Transducer, filter_s: float, asked_pa: float, start_s: float) -> None:
        self._transducer, self._filter_s = transducer, filter_s
        self._loop = LoopState(transducer.loop, asked_pa)
        self._regulated_pa = transducer.settled_pa(asked_pa, transducer.supply_pa)  # before the hunting on top
        self.pressure_pa = self._regulated_pa + float(transducer.hunting.added_pa(np.array([start_s]))[0])
        self.gauge_pa = self.pressure_pa

    def follow(self, start_s: float, after_s: FloatArray, asked_pa: FloatArray, air: AirState) -> PressureCourse:
        """Go on from ``start_s`` while this is asked for; return the course.

        Corners, ``after_s`` from there on: shape (n_corners,).
        """
        duration_s = float(after_s[-1])
        after_s, asked_pa = self._loop.follow(after_s, asked_pa)
        after_s, target_pa = limited(after_s, asked_pa, air.reaching_pa)
        if air.runaway_pa is None:
            target_pa = self._transducer.leaking(target_pa)
        else:
            target_pa = np.full_like(target_pa, air.runaway_pa)
        after_s[-1] = duration_s
        after_s, pressure_pa = lagged(after_s, target_pa, self._regulated_pa, self._transducer.lag_s)
        if air.stuck:
            pressure_pa = np.full(pressure_pa.shape, self.pressure_pa)
        self._regulated_pa = float(pressure_pa[-1])
        if not air.stuck and air.runaway_pa is None:
            after_s, pressure_pa = self._transducer.hunting.swung(after_s, pressure_pa, start_s)
        gauge_s, gauge_pa = lagged(after_s, pressure_pa, self.gauge_pa, self._filter_s)
        self.pressure_pa, self.gauge_pa = float(pressure_pa[-1]), float(gauge_pa[-1])
        return PressureCourse(after_s, pressure_pa, gauge_s, gauge_pa)

    def is_level(self, asked_pa: float | None, air: AirState) -> bool:
        """Whether it stays as it is while ``asked_pa`` is held; None where what is asked for changes."""
        if air.stuck:
            return True
        if air.runaway_pa is not None:
            return self.pressure_pa == air.runaway_pa
        if asked_pa is None or self._transducer.hunting.swing_pa > 0.0:
            return False
        target_pa = self._transducer.settled_pa(self._loop.at(asked_pa), air.reaching_pa)
        if self._transducer.lag_s == 0.0:
            self.pressure_pa = self._regulated_pa = target_pa
        return target_pa == self.pressure_pa

    def stay(self, duration_s: float) -> None:
        """Stay as it is; only the gauge's filter still settles."""
        keep = math.exp(-duration_s / self._filter_s) if self._filter_s > 0.0 else 0.0
        self.gauge_pa = self.pressure_pa + (self.gauge_pa - self.pressure_pa) * keep
