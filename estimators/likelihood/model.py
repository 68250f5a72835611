"""The simulated stem as a function of all unknowns, beside the measured positions and their weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.shooting_kernel import shoot
from estimators.samples import FloatArray, IntArray
from valve.kernel.modes import FOLLOWED
from valve.kernel.sampling import even_period

_MOST_EVENTS: Final = 4_000  # a test has some hundred; more is a trial valve that chatters
NO_NOISE: Final = 1.0e-9  # of a position that is computed and not measured, as a share of its range
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
class Restarts:
    """Where the simulated stem begins anew for a first fit: part j at ``row[j]``, at rest at ``position_m[j]``."""

    row: IntArray
    position_m: FloatArray


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
    _out_s: FloatArray = field(init=False)
    _starts: tuple[tuple[str, str], ...] = field(init=False)
    _input_shares: tuple[str, ...] = field(init=False)
    _corners: dict[tuple[float, ...], tuple[FloatArray, FloatArray]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        out_s = self.time_s
        if self.block_s is not None:
            out_s = np.stack([self.time_s - self.block_s, self.time_s + self.block_s], axis=1).ravel()
        object.__setattr__(self, "_out_s", out_s)
        object.__setattr__(self, "even_step", float(even_period(out_s)))
        sections = range(self.section_row.size)
        object.__setattr__(self, "_starts", tuple((f"x_{number}", f"v_{number}") for number in sections))
        shares = tuple(f"input_{number}" for number in range(1, len(self.deviations) + 1))
        object.__setattr__(self, "_input_shares", shares)

    def corners(self, values: dict[str, float]) -> tuple[FloatArray, FloatArray]:
        """Corners of the force for these values: times, s, and forces, N."""
        wanted = tuple(values[name] for name in self.input_names)
        shares = tuple(values[name] for name in self._input_shares)
        found = self._corners.get(wanted + shares)
        if found is None:
            time_s, force_n = self.path.corners(np.array(wanted))
            if shares:
                for share, (late_s, more_n) in zip(shares, self.deviations, strict=True):
                    time_s, force_n = time_s + share * late_s, force_n + share * more_n
                time_s = np.maximum.accumulate(time_s)
            if len(self._corners) > 8:
                self._corners.clear()
            found = self._corners[wanted + shares] = (time_s, force_n)
        return found

    @property
    def corner_count(self) -> int:
        """How many corners the force had when it was last asked for; 0 before."""
        return 0 if not self._corners else next(reversed(self._corners.values()))[0].size

    def simulate(self, point: FloatArray) -> FloatArray | None:
        """Position at ``time_s``, m, shape (n,), for the unknowns at ``point``; None where it cannot be followed."""
        values = self.coordinates.values(point)
        valve = np.array(
            [
                values["m"],
                values["k"],
                values["F_v"],
                values["F_c"],
                values["F_c"] * (1.0 + values["d"]),
                values["DV"],
                values["F_0"],
                values.get("low", -np.inf),
                values.get("high", np.inf),
            ]
        )
        corner_s, force_n = self.corners(values)
        rows = self.section_row
        start_m = np.array([values[name] for name, _ in self._starts])
        start_v = np.array([values.get(name, 0.0) for _, name in self._starts])
        if self.restarts is not None:
            rows = np.concatenate([rows, self.restarts.row])
            order = np.argsort(rows, kind="stable")
            rows = rows[order]
            start_m = np.concatenate([start_m, self.restarts.position_m])[order]
            start_v = np.concatenate([start_v, np.zeros(self.restarts.row.size)])[order]
        out_m = np.empty(self._out_s.size)
        times = self._out_s.size // self.time_s.size
        timed = (times * rows, self.time_s[rows], start_m, start_v)
        grid = (self._out_s, self.even_step)
        status = shoot(valve, corner_s, force_n, *grid, *timed, out_m, self.most_events)
        if status != FOLLOWED or not bool(np.isfinite(out_m[-1])):
            return None
        return out_m if times == 1 else 0.5 * (out_m[0::2] + out_m[1::2])

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Weighted measured minus simulated position, shape (n,), in standard deviations."""
        simulated_m = self.simulate(point)
        return None if simulated_m is None else self._whitened((self.position_m - simulated_m) * self.weight)

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
    ) -> FloatArray | None:
        """Derivatives of the weighted positions to the coordinates, shape (p, n), by central differences.

        One-sided where that is asked for, at a bound, and where one side slips once more or less than the other.
        ``steps``, shape (p,), are those of the differences.
        """
        here = self.simulate(point)
        if here is None:
            return None
        columns = np.zeros((point.size, self.time_s.size))
        lower, upper = self.coordinates.lower, self.coordinates.upper
        largest = _LARGEST_SLOPE * self.range_m
        for number in range(point.size) if free is None else free:
            forward, backward = point.copy(), point.copy()
            step = STEP if steps is None else float(steps[number])
            forward[number] += step
            backward[number] -= step
            above = self.simulate(forward) if forward[number] <= upper[number] else None
            is_wanted = backward[number] >= lower[number] and not (one_sided and above is not None)
            below = self.simulate(backward) if is_wanted else None
            if above is not None and below is not None:
                slope = (above - below) / (2.0 * step)
                if float(np.abs(slope).max()) > largest:
                    sides = (above - here) / step, (here - below) / step
                    slope = min(sides, key=lambda side: float(np.abs(side).max()))
            elif above is not None:
                slope = (above - here) / step
            elif below is not None:
                slope = (here - below) / step
            else:
                continue
            if float(np.abs(slope).max()) <= largest:
                columns[number] = self._whitened(slope * self.weight)
        return columns
