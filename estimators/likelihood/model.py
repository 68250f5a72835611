"""The simulated stem as a function of all unknowns, beside the measured positions and their weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.shooting_kernel import shoot_each
from estimators.samples import BoolArray, FloatArray, IntArray
from valve.kernel.sampling import even_period

_MOST_EVENTS: Final = 4_000  # a test has some hundred; more is a trial valve that chatters
NO_NOISE: Final = 1.0e-9  # of a position that is computed and not measured, as a share of its range
STEP: Final = 1.0e-6  # of differences, in the coordinates
# Ranges of the position per unit of a coordinate: a difference beyond this straddles a slip more or less.
_LARGEST_SLOPE: Final = 3.0e3
_ONE_INSTANT_S: Final = 1.0e-9  # a block of no more is one row
_AT_ONCE: Final = 20_000  # positions: more would not stay in a core's cache


Corners = tuple[FloatArray, FloatArray]


class ForcePath(Protocol):
    """The actuator's force as straight lines between corners, for given values of what is not known of it."""

    def corners(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times, s, and forces, N, of the corners."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Restarts:
    """Where the simulated stem begins anew for a first fit: part j at ``row[j]``, at rest at ``position_m[j]``."""

    row: IntArray
    position_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where a simulation's numbers stand among the unknowns, -1 for none, as ``shoot_each`` takes them.

    Part j begins at output ``first_out[j]``, ``first_s[j]``, at the unknown ``start[j]`` or, begun anew at a measured
    rest, at ``rest_m[j]``. Outputs are at ``out_s``: a block's at both ``sides``, (2, n), a single row's once.
    """

    valve: IntArray  # of m, k, F_v, F_c, F_s/F_c - 1, DV, F_0 and both stops
    inputs: IntArray
    is_input: BoolArray
    start: IntArray
    speed: IntArray
    rest_m: FloatArray
    out_s: FloatArray
    sides: IntArray
    first_out: IntArray
    first_s: FloatArray


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
    _places: _Places = field(init=False)
    _input_shares: tuple[str, ...] = field(init=False)
    _corners: dict[tuple[float, ...], Corners] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        shares = tuple(f"input_{number}" for number in range(1, len(self.deviations) + 1))
        object.__setattr__(self, "_input_shares", shares)
        object.__setattr__(self, "_places", self._placed())
        object.__setattr__(self, "even_step", float(even_period(self._places.out_s)))

    def _placed(self) -> _Places:
        names = self.coordinates.names
        place = {name: number for number, name in enumerate(names)}
        rows, sections = self.section_row, range(self.section_row.size)
        start = [place.get(f"x_{number}", -1) for number in sections]
        speed = [place.get(f"v_{number}", -1) for number in sections]
        rest_m = np.zeros(len(sections))
        if self.restarts is not None:
            others = self.restarts.row.size
            rows, rest_m = np.append(rows, self.restarts.row), np.append(rest_m, self.restarts.position_m)
            start, speed = start + [-1] * others, speed + [-1] * others
        order = np.argsort(rows, kind="stable")
        out_s, sides = self.time_s, np.empty((2, 0), dtype=np.int64)
        if self.block_s is not None:
            has_two = self.block_s > _ONE_INSTANT_S
            last = np.cumsum(1 + has_two) - 1
            sides = np.stack([last - has_two, last])
            out_s = np.empty(int(last[-1]) + 1)
            out_s[sides[0]], out_s[sides[1]] = self.time_s - self.block_s, self.time_s + self.block_s
        inputs = np.array([place[name] for name in (*self.input_names, *self._input_shares)], dtype=np.int64)
        first = rows[order]
        return _Places(
            valve=np.array([place.get(name, -1) for name in ("m", "k", "F_v", "F_c", "d", "DV", "F_0", "low", "high")]),
            inputs=inputs,
            is_input=np.isin(np.arange(len(names)), inputs),
            start=np.array(start)[order],
            speed=np.array(speed)[order],
            rest_m=rest_m[order],
            out_s=out_s,
            sides=sides,
            first_out=first if self.block_s is None else sides[0][np.minimum(first, self.time_s.size - 1)],
            first_s=self.time_s[first],
        )

    def corners(self, values: dict[str, float]) -> Corners:
        """Corners of the force for these values: times, s, and forces, N."""
        return self._corners_for(tuple(values[name] for name in (*self.input_names, *self._input_shares)))

    def _corners_for(self, inputs: tuple[float, ...]) -> Corners:
        """Corners for the values of ``input_names``, and of the shares of the deviations after them."""
        found = self._corners.get(inputs)
        if found is None:
            count = len(self.input_names)
            time_s, force_n = self.path.corners(np.array(inputs[:count]))
            if inputs[count:]:
                for share, (late_s, more_n) in zip(inputs[count:], self.deviations, strict=True):
                    time_s, force_n = time_s + share * late_s, force_n + share * more_n
                time_s = np.maximum.accumulate(time_s)
            if len(self._corners) > 8:
                self._corners.clear()
            found = self._corners[inputs] = (time_s, force_n)
        return found

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
        inputs = tuple(own.values_at(points[0], places.inputs).tolist()) if places.inputs.size > 0 else ()
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
            *self._corners_for(inputs),
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
        lower, upper = self.coordinates.lower, self.coordinates.upper
        sizes = np.full(point.size, STEP) if steps is None else steps
        asked = np.arange(point.size) if free is None else np.array(free, dtype=np.int64)
        forward = asked[point[asked] + sizes[asked] <= upper[asked]]
        backward = asked[point[asked] - sizes[asked] >= lower[asked]]
        rising, has_above = self._beside(point, here, forward, sizes)
        if one_sided:
            known = np.zeros(point.size, dtype=np.bool_)
            known[forward[has_above]] = True
            backward = backward[~known[backward]]
        falling, has_below = self._beside(point, here, backward, -sizes)
        slopes: FloatArray = np.zeros((point.size, self.time_s.size))
        sides = np.zeros(point.size, dtype=np.int64)
        for numbers, side, has in ((forward, rising, has_above), (backward, falling, has_below)):
            slopes[numbers[has]] += side[has]
            sides[numbers[has]] += 1
        slopes[sides == 2] *= 0.5
        largest = _LARGEST_SLOPE * self.range_m
        steep = np.maximum(slopes.max(axis=1), -slopes.min(axis=1)) > largest
        for number in np.flatnonzero(steep & (sides == 2)):
            both = rising[forward == number][0], falling[backward == number][0]
            slopes[number] = min(both, key=lambda one: float(np.abs(one).max()))
            steep[number] = float(np.abs(slopes[number]).max()) > largest
        slopes[steep] = 0.0
        slopes *= self.weight
        if self.spread is not None:
            slopes -= (slopes @ self.spread) @ self.spread.T
        return slopes

    def _beside(
        self, point: FloatArray, here: FloatArray, numbers: IntArray, steps: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Slopes of the position, shape (b, n), with each of these unknowns a step off; where they can be followed."""
        slopes, followed = np.empty((numbers.size, here.size)), np.empty(numbers.size, dtype=np.bool_)
        if numbers.size == 0:
            return slopes, followed
        points = np.repeat(point[None, :], numbers.size, axis=0)
        points[np.arange(numbers.size), numbers] += steps[numbers]
        # an unknown of the force changes its corners: those are simulated one by one
        alone = self._places.is_input[numbers]
        most = max(1, _AT_ONCE // self._places.out_s.size)
        together = np.flatnonzero(~alone)
        groups = [together[i : i + most] for i in range(0, together.size, most)]
        groups += [np.array([row]) for row in np.flatnonzero(alone)]
        for rows in groups:
            slopes[rows], followed[rows] = self.simulate_each(points[rows])
        slopes -= here
        slopes /= steps[numbers][:, None]
        return slopes, followed
