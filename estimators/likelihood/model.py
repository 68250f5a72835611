"""The simulated stem as a function of all unknowns, beside the measured positions and their weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Final, Protocol

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.places import Places, Restarts, placed
from estimators.likelihood.shooting_kernel import differences, shoot_each
from estimators.samples import BoolArray, FloatArray, IntArray
from valve.kernel.sampling import even_period

_MOST_EVENTS: Final = 4_000  # a test has some hundred; more is a trial valve that chatters
NO_NOISE: Final = 1.0e-9  # of a position that is computed and not measured, as a share of its range
_FEW_CHANGES: Final = 4  # of the shares of what bends the force: a difference is one or two
STEP: Final = 1.0e-6  # of differences, in the coordinates
# Ranges of the position per unit of a coordinate: a difference beyond this straddles a slip more or less.
_LARGEST_SLOPE: Final = 3.0e3


Corners = tuple[FloatArray, FloatArray]


class ForcePath(Protocol):
    """The actuator's force as straight lines between corners, for given values of what is not known of it."""

    def corners(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times, s, and forces, N, of the corners."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class StemModel:
    """Measured positions, shape (n,), with the weight of each (0: not measured), and the simulation beside them.

    ``section_row`` are the rows from which on the stem begins anew, 0 first: section j at the unknown position x_j
    and, where there is one, velocity v_j. ``input_names`` are the unknowns that the force path takes; unknown ``d`` is
    F_s/F_c - 1. ``deviations`` are changes of the corners (s, N) that the unknowns input_1, ... scale. ``spread``,
    shape (n, d), is B where errors other than white noise have the inverse root of covariance I - B B^T. Where a row
    stands for a block, ``block_s``, shape (n,), is the scatter of its rows' times, and the simulated position is the
    mean of those at both sides of it: that of the block to the third order.
    """

    time_s: FloatArray
    position_m: FloatArray
    weight: FloatArray
    path: ForcePath
    coordinates: Coordinates
    section_row: IntArray
    input_names: tuple[str, ...]
    range_m: float
    deviations: tuple[tuple[FloatArray, FloatArray], ...] = ()
    restarts: Restarts | None = None
    most_events: int = _MOST_EVENTS
    spread: FloatArray | None = None
    stepped: bool = False  # the force is a staircase: the stem moves by its treads
    events: int = 0  # changes of mode that the measured motion has, about: what a simulation costs
    block_s: FloatArray | None = None
    even_step: float = field(init=False)
    _places: Places = field(init=False)
    _input_shares: tuple[str, ...] = field(init=False)
    _corners: dict[tuple[float, ...], Corners] = field(init=False, default_factory=dict)
    _bends: list[tuple[tuple[float, ...], Corners]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        shares = tuple(f"input_{number}" for number in range(1, len(self.deviations) + 1))
        object.__setattr__(self, "_input_shares", shares)
        taken = (*self.input_names, *shares)
        places = placed(
            self.coordinates.names,
            taken,
            self.section_row,
            self.restarts,
            time_s=self.time_s,
            block_s=self.block_s,
        )
        object.__setattr__(self, "_places", places)
        object.__setattr__(self, "even_step", float(even_period(self._places.out_s)))

    def corners(self, values: dict[str, float]) -> Corners:
        """Corners of the force for these values: times, s, and forces, N."""
        return self._corners_for(tuple(values[name] for name in (*self.input_names, *self._input_shares)))

    def _corners_at(self, point: FloatArray) -> Corners:
        entries = self.coordinates.entries
        return self._corners_for(tuple(entries[i].value(float(point[i])) for i in self._places.inputs))

    def _corners_for(self, inputs: tuple[float, ...]) -> Corners:
        """Corners for the values of ``input_names``, and of the shares of the deviations after them."""
        found = self._corners.get(inputs)
        if found is None:
            count = len(self.input_names)
            time_s, force_n = self._bent(self.path.corners(np.array(inputs[:count])), inputs[count:])
            if len(self._corners) > 8:
                self._corners.clear()
            found = self._corners[inputs] = (time_s, force_n)
        return found

    def _bent(self, plain: Corners, shares: tuple[float, ...]) -> Corners:
        """Corners with each deviation added by its share: of those that changed since they were last asked for.

        Differences change one of a hundred shares at a time, and a force may have 20,000 corners.
        """
        if not shares:
            return plain
        none: tuple[tuple[float, ...], Corners] = ((0.0,) * len(shares), (np.zeros(1), np.zeros(1)))
        before, (late_s, more_n) = self._bends[0] if self._bends else none
        if sum(new != old for new, old in zip(shares, before, strict=True)) > _FEW_CHANGES:
            before, (late_s, more_n) = none  # what is left of rounding does not pile up
        for (far_s, far_n), new, old in zip(self.deviations, shares, before, strict=True):
            if new != old:
                late_s, more_n = late_s + (new - old) * far_s, more_n + (new - old) * far_n
        self._bends[:] = [(shares, (late_s, more_n))]
        return np.maximum.accumulate(plain[0] + late_s), plain[1] + more_n

    @property
    def corner_count(self) -> int:
        """How many corners the force had when it was last asked for; 0 before."""
        return 0 if not self._corners else next(reversed(self._corners.values()))[0].size

    def simulate(self, point: FloatArray) -> FloatArray | None:
        """Position at ``time_s``, m, shape (n,), for the unknowns at ``point``; None where it cannot be followed."""
        simulated_m, followed = self.simulate_each(point[None, :])
        return simulated_m[0] if followed[0] else None

    def simulate_each(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Positions, m, shape (b, n), for the unknowns in each row of ``points``, shape (b, p), under one force.

        The force is that of the first row; what cannot be followed is False in the second array, shape (b,).
        """
        own, places = self.coordinates, self._places
        position_m = np.empty((points.shape[0], self.time_s.size))
        followed = np.empty(points.shape[0], dtype=np.bool_)
        shoot_each(
            points,
            own.logarithmic,
            own.unit,
            places.valve,
            places.start,
            places.speed,
            places.rest_m,
            *self._corners_at(points[0]),
            places.out_s,
            self.even_step,
            places.first_out,
            places.first_s,
            places.sides[0],
            places.sides[1],
            self.most_events,
            position_m,
            followed,
        )
        return position_m, followed

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Weighted measured minus simulated position, shape (n,), in standard deviations."""
        simulated_m = self.simulate(point)
        return None if simulated_m is None else self.left_by(simulated_m)

    def left_by(self, simulated_m: FloatArray) -> FloatArray:
        """Weighted measured minus this position, shape (n,), in standard deviations."""
        return self._whitened((self.position_m - simulated_m) * self.weight)

    def _whitened(self, weighted: FloatArray) -> FloatArray:
        return weighted if self.spread is None else weighted - self.spread @ (self.spread.T @ weighted)

    def cost(self, point: FloatArray) -> float:
        """Sum of squared residuals and of squared departures from the priors; infinite where there is no motion."""
        residual = self.residuals(point)
        if residual is None:
            return float("inf")
        return float(residual @ residual) + self.prior_cost(point)

    def prior_cost(self, point: FloatArray) -> float:
        """Sum of squared departures from the priors, in their standard deviations."""
        off = point - self.coordinates.prior
        return float(self.coordinates.prior_weight @ (off * off))

    def slopes(
        self,
        point: FloatArray,
        free: list[int] | None = None,
        steps: FloatArray | None = None,
        *,
        one_sided: bool = False,
        here: FloatArray | None = None,
    ) -> FloatArray | None:
        """Derivatives of the weighted positions to the coordinates, shape (p, n), by central differences.

        One-sided where that is asked for, at a bound, and where one side slips once more or less than the other.
        ``steps``, shape (p,), are those of the differences; ``here``, shape (n,), is the position at ``point`` where it
        is known already.
        """
        here = self.simulate(point) if here is None else here
        if here is None:
            return None
        sizes = np.full(point.size, STEP) if steps is None else steps
        asked = np.arange(point.size) if free is None else np.array(free, dtype=np.int64)
        is_input = self._places.is_input[asked]
        lower, upper = self.coordinates.lower, self.coordinates.upper
        slopes: FloatArray = np.zeros((point.size, self.time_s.size))
        differ = partial(self._differ, point=point, sizes=sizes, here=here, slopes=slopes)
        differ(asked[~is_input], (point, point), (lower, upper), one_sided=one_sided)
        # an unknown of the force changes its corners
        for number in asked[is_input]:
            above, below = point.copy(), point.copy()
            above[number] += sizes[number]
            below[number] -= sizes[number]
            alone = np.array([number])
            if not one_sided:
                differ(alone, (above, below), (lower, upper), one_sided=False)
            elif not differ(alone, (above, above), (np.full(point.size, np.inf), upper), one_sided=False):
                differ(alone, (below, below), (lower, np.full(point.size, -np.inf)), one_sided=False)
        if self.spread is not None:
            slopes -= (slopes @ self.spread) @ self.spread.T
        return slopes

    def _differ(
        self,
        numbers: IntArray,
        sides: tuple[FloatArray, FloatArray],
        bounds: tuple[FloatArray, FloatArray],
        *,
        point: FloatArray,
        sizes: FloatArray,
        here: FloatArray,
        slopes: FloatArray,
        one_sided: bool,
    ) -> bool:
        """Write the slopes to these unknowns, the force being that of the points ``sides``; whether all were found."""
        own, places = self.coordinates, self._places
        found: bool = differences(
            point,
            numbers,
            sizes,
            *bounds,
            one_sided,
            here,
            self.weight,
            _LARGEST_SLOPE * self.range_m,
            own.logarithmic,
            own.unit,
            places.valve,
            places.start,
            places.speed,
            places.rest_m,
            *self._corners_at(sides[0]),
            *self._corners_at(sides[1]),
            places.out_s,
            self.even_step,
            places.first_out,
            places.first_s,
            places.sides[0],
            places.sides[1],
            self.most_events,
            slopes,
        )
        return found
