"""Faults of a valve and its device, as data: what fails, from when to when, in simulated time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from valve.errors import ParameterError
from valve.messages import say


class FaultKind(StrEnum):
    """What fails."""

    STUCK_STEM = "stuck_stem"  # the stem stays where it is, whatever the pressure
    AIR_LOST = "air_lost"  # the supply falls to ``amount`` Pa
    FROZEN_SENSOR = "frozen_sensor"  # the position reads as it was at the start
    SENSOR_LOST = "sensor_lost"  # the position reads NaN
    SENSOR_JUMP = "sensor_jump"  # the position reads ``amount`` m too much
    OUTPUT_RESET = "output_reset"  # at the start the output falls to the low end of its range, unasked
    RESTART = "restart"  # at the start the device restarts: outputs low, owner, watchdog and capture lost
    IGNORED_WRITES = "ignored_writes"  # writes are acknowledged and not executed
    PRESSURE_STUCK = "pressure_stuck"  # the I/P holds the actuator's pressure, whatever is asked
    PRESSURE_RUNAWAY = "pressure_runaway"  # the I/P drives the actuator to ``amount`` Pa, whatever is asked
    SENSOR_SPIKES = "sensor_spikes"  # every third reading of the position is ``amount`` m too much
    LOOP_IN_AUTOMATIC = "loop_in_automatic"  # the device's status no longer says that the loop is in manual
    INTERLOCK = "interlock"  # the device's status says that an interlock is active
    REFUSAL = "refusal"  # every request is answered with exception ``amount``
    SILENCE = "silence"  # no request is answered; writes are executed all the same


# These happen once, at their start.
MOMENTARY = frozenset({FaultKind.OUTPUT_RESET, FaultKind.RESTART})


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, from ``start_s`` to just before ``end_s`` of the simulated clock.

    Raises ParameterError where the times or the amount make no sense.
    """

    kind: FaultKind
    start_s: float
    end_s: float = math.inf
    amount: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start_s) and self.end_s > self.start_s):
            raise ParameterError(
                say(
                    "fault_ends_before_start",
                    "fault {fault}: it lasts from {start:g in s} to {end:g s}, give a rise",
                    fault=self.kind,
                    start=self.start_s,
                    end=self.end_s,
                )
            )
        if not math.isfinite(self.amount):
            raise ParameterError(
                say(
                    "fault_amount_not_finite",
                    "fault {fault}: its amount is {amount}, give a finite number",
                    fault=self.kind,
                    amount=self.amount,
                )
            )
        if self.kind is FaultKind.REFUSAL and not 1 <= self.amount <= 255:
            raise ParameterError(
                say(
                    "fault_code_outside",
                    "fault {fault}: exception code {exception:g} is outside 1 to 255",
                    fault=self.kind,
                    exception=self.amount,
                )
            )

    def active(self, at_s: float) -> bool:
        """Whether it is there at this time."""
        return self.start_s <= at_s < self.end_s


def active_fault(faults: Iterable[Fault], kind: FaultKind, at_s: float) -> Fault | None:
    """Return the first fault of this kind that is there at this time."""
    for fault in faults:
        if fault.kind is kind and fault.active(at_s):
            return fault
    return None


def next_edge_s(faults: Iterable[Fault], after_s: float) -> float:
    """First time later than ``after_s`` at which a fault begins or ends; infinite where there is none."""
    edges = (edge for fault in faults for edge in (fault.start_s, fault.end_s) if edge > after_s)
    return min(edges, default=math.inf)
