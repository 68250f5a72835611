"""The extended stem beside the measured positions: residuals and their slopes as functions of named unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from discrepancy.observed import Observed
from discrepancy.sensed_places import rests_of, start_state
from discrepancy.unknowns import Unknown, Unknowns, valve_of
from estimators.samples import BoolArray, FloatArray
from valve.errors import MotionError, ParameterError
from valve.extended_motion import ExtendedStem, input_corners
from valve.extended_valve import ExtendedValve

_MOST_EVENTS: Final = 20_000
_LONGEST_SUB_STEP_S: Final = 1.0e-2
_THIN_SUB_STEP_S: Final = 2.0e-2
_PASSES_A_MOTION: Final = 2500  # 0.2 to 0.35 ms of preparing beside 0.1 to 0.2 us a pass
_NO_EXTRA: Final[dict[str, float]] = {}


@dataclass(slots=True)
class Tally:
    """How many motions were followed for a diagnosis, and the kernel's passes in them."""

    motions: int = 0
    passes: int = 0
    most: float = math.inf  # work, after which no fit is led further

    @property
    def work(self) -> int:
        """The work of a diagnosis in passes, the same on every machine: a motion costs some beside its own."""
        return self.passes + _PASSES_A_MOTION * self.motions

    @property
    def is_spent(self) -> bool:
        """Whether all the work that may be done is done: fits stay where they are."""
        return self.work >= self.most


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What is fitted: the recordings, the unknowns, the causes in the valve and what of them is held.

    ``held`` are values by name of what is not fitted; ``thin`` are the recordings in longer blocks; ``tally`` is shared
    by all models that come of this one.
    """

    observed: Observed
    unknowns: Unknowns
    causes: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=lambda: _NO_EXTRA)
    longest_s: float = _LONGEST_SUB_STEP_S
    thin: Observed | None = None
    tally: Tally = field(default_factory=Tally)

    def with_causes(self, causes: tuple[str, ...], more: tuple[Unknown, ...], held: Mapping[str, float]) -> Model:
        """Return the model with these causes besides, and their unknowns."""
        return replace(
            self,
            unknowns=self.unknowns.joined(more),
            causes=(*self.causes, *causes),
            held={**self.held, **held},
        )

    def with_free(self, more: tuple[Unknown, ...], held: Mapping[str, float]) -> Model:
        """Return the model with these unknowns besides, which were held; ``held`` is what still is."""
        return replace(self, unknowns=self.unknowns.joined(more), held=held)

    def thinned(self) -> Model:
        """Return the model of the recordings in longer blocks, for fits that have not found their place yet."""
        return self if self.thin is None else replace(self, observed=self.thin, thin=None, longest_s=_THIN_SUB_STEP_S)

    def values(self, point: FloatArray) -> dict[str, float]:
        """All values by name at a point, those that are held too."""
        return {**self.held, **self.unknowns.values(point)}

    def valve(self, point: FloatArray) -> ExtendedValve:
        """Return the valve at a point."""
        return valve_of(self.values(point), self.causes)

    def simulate(self, point: FloatArray) -> FloatArray | None:
        """Positions as sensed in all blocks, m, shape (count,); None where the stem cannot be followed."""
        values = self.values(point)
        self.tally.motions += 1
        try:
            return simulated(self.observed, valve_of(values, self.causes), values, self.longest_s, self.tally)
        except (ParameterError, MotionError):
            return None

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Measured minus simulated position in standard deviations, shape (count,)."""
        simulated_m = self.simulate(point)
        if simulated_m is None or not np.isfinite(simulated_m).all():
            return None
        return self.observed.residuals(simulated_m)

    def slopes(
        self, point: FloatArray, here: FloatArray, free: BoolArray | None = None, *, is_backward: bool = False
    ) -> FloatArray:
        """Derivatives of the residuals to the coordinates, shape (p, count), by differences from ``here``.

        0 for those that are not ``free``, shape (p,). Forward differences, or backward ones; at a bound the other.
        """
        columns = np.zeros((point.size, here.size))
        lower, upper = self.unknowns.lower, self.unknowns.upper
        steps = -self.unknowns.steps if is_backward else self.unknowns.steps
        for number in range(point.size) if free is None else np.flatnonzero(free):
            step = float(steps[number])
            if not lower[number] <= point[number] + step <= upper[number]:
                step = -step
            moved = point.copy()
            moved[number] += step
            there = self.residuals(moved)
            if there is not None:
                columns[number] = (there - here) / step
        return columns


def simulated(
    observed: Observed,
    valve: ExtendedValve,
    values: Mapping[str, float],
    longest_s: float = _LONGEST_SUB_STEP_S,
    tally: Tally | None = None,
) -> FloatArray:
    """Positions as sensed of this valve in all blocks, m; ``values`` has the nuisances (``x_0`` ..., ``delay_s``)."""
    stem = ExtendedStem(valve, _MOST_EVENTS, longest_s)
    delay_s = values.get("delay_s", 0.0)
    parts = []
    for number, segment in enumerate(observed.segments):
        corner_s, corner_n = segment.corner_s, segment.corner_n
        if delay_s != 0.0:
            corner_s = np.maximum(corner_s + delay_s, segment.time_s[0])
            corner_s[0] = segment.time_s[0]
        if observed.command_only and not valve.input.is_neutral:
            corner_s, corner_n = input_corners(valve.input, corner_s, corner_n, float(segment.time_s[-1]))
        begin_m, speed = values.get(f"x_{number}", segment.start_m), values.get(f"v_{number}", segment.start_velocity)
        state = start_state(segment, begin_m, speed, valve, float(corner_n[0]))
        rests = rests_of(segment, valve.sensor)
        sensed_m, passes = stem.sensed(state, corner_s, corner_n, segment.time_s, rests=rests)
        parts.append(sensed_m)
        if tally is not None:
            tally.passes += passes
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
