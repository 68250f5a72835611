"""m, F_v, k, A, F_0 and F_s from all slips at once, by least squares on the position: no derivative is taken of it.

The condition of least squares, that what is left over be orthogonal to the position's sensitivities, is the equation of
motion integrated against smooth test functions (those that the least noise passes): the integral form of Eq. (5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg.lapack import dgesv

from estimators.samples import FloatArray, IntArray
from estimators.slips.kernel import COMMON, D_V, F_S, F_V, A, K, M, normal_equations
from estimators.slips.windows import SlipWindows

# What is believed beforehand, standard deviations of logarithms: next to nothing of F_v; of m that valves weigh some
# kg, which matters only where the motion hides it; of DV as ``robust_form`` has it.
BELIEF_OF_MASS: Final = 1.0
BELIEF_OF_VISCOUS: Final = 2.3
BELIEF_OF_LIMIT: Final = 2.1  # DV may be as fast as the ramp, as of a real graphite packing
_LOGARITHMIC: Final = np.array([M, F_V, D_V])
_POSITIVE: Final = np.array([M, F_V, K, A, D_V])
_BELIEF: Final = np.zeros(COMMON)
_BELIEF[_LOGARITHMIC] = BELIEF_OF_MASS**-2, BELIEF_OF_VISCOUS**-2, BELIEF_OF_LIMIT**-2
_FIRST_DAMPING: Final = 1.0e-4
_LEAST_DAMPING: Final = 1.0e-8
_MOST_DAMPINGS: Final = 12
_MOST_ROUNDS: Final = 30
_ENOUGH: Final = 1.0e-4  # of a standard error: the largest step of the last round
_TRIFLE: Final = 1.0e-3  # of the sum of squares, in noise's variances
_FAR_OFF: Final = 5.0  # misfit: so far off
_TRIFLE_OF_FAR: Final = 1.0e-4  # of the sum of squares itself is one
_LARGEST_LIMIT: Final = 0.98  # of the slowest ramp's speed: below DV nothing slides
_MISFIT_ON_GRID: Final = 1.3
_LIGHTEST_KG: Final = 1.0e-3
_HEAVIEST_KG: Final = 1.0e3
_LARGEST_STEP: Final = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class SlipSolution:
    """``common`` (7,) in the order of ``slip_kernel`` with its covariance; ``own_n`` and ``rest_m`` of each slip.

    ``covariance`` is that of white noise of one standard deviation a row; ``misfit`` the root mean square of what is
    left over by it.
    """

    common: FloatArray
    covariance: FloatArray
    own_n: FloatArray
    rest_m: FloatArray
    cost: float
    costs: FloatArray
    freedom: int
    converged: bool
    reference_speed: float
    follows: FloatArray  # (7, 7): how the free unknowns follow a change of those that stayed

    @property
    def misfit(self) -> float:
        """Root mean square of what is left over, in noise's standard deviations."""
        return math.sqrt(self.cost / self.freedom)


@dataclass(frozen=True, slots=True, eq=False)
class _Evaluated:
    """Unknowns with their normal equations."""

    common: FloatArray
    own_n: FloatArray
    rest_m: FloatArray
    cost: float
    costs: FloatArray
    normal: FloatArray
    local: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SlipFit:
    """Levenberg and Marquardt's least squares over the ``free`` unknowns; the others stay at their start."""

    windows: SlipWindows
    noise_m: float
    reference_speed: float
    free: tuple[int, ...]
    believed: FloatArray  # (7,): the middle of what is believed of m, F_v and DV
    tie: float = math.inf
    slaved: bool = False  # F_s is F_c = A - F_v v_ref: a valve without stiction

    def fits(self, solution: SlipSolution) -> bool:
        """Whether what is left over is no more than noise, to 2.5 standard deviations and 1 % of the noise."""
        if self.windows.undithered:
            return solution.misfit <= _MISFIT_ON_GRID
        return solution.misfit <= math.sqrt(1.0 + 2.5 * math.sqrt(2.0 / solution.freedom)) + 0.01

    def solve(self, start: FloatArray, rounds: int = _MOST_ROUNDS, rest_m: FloatArray | None = None) -> SlipSolution:
        """Return the nearest minimum, or how far it was come in so many rounds."""
        common = start.copy()
        if self.slaved:
            common[F_S] = common[A] - common[F_V] * self.reference_speed
        rest = self.windows.rest_m if rest_m is None else rest_m
        at = self._evaluated(common, np.zeros(self.windows.count), rest.copy())
        damping, converged = _FIRST_DAMPING, False
        for _ in range(rounds):
            if not math.isfinite(at.cost):
                break
            step = self._step(at, damping)
            if step is None:
                converged = True  # no step betters it
                break
            at, gained, largest, damping = step
            converged = largest < _ENOUGH or gained < self._trifle(at.cost)
            if converged:
                break
        return self._described(at, converged)

    @property
    def _moving(self) -> IntArray:
        """Places of the unknowns that are solved for."""
        return np.array([i for i in self.free if not (self.slaved and i == F_S)], dtype=np.int64)

    @property
    def _freedom(self) -> int:
        """Degrees of freedom that are left."""
        return max(1, int(self.windows.time_s.size) - self._moving.size - self.windows.count)

    def _trifle(self, cost: float) -> float:
        """What of this sum of squares is not worth a round: as many times more where more than noise is left over.

        Of a minimum that explains nothing a share of itself: it is left for other starts.
        """
        over = cost / self._freedom
        return _TRIFLE_OF_FAR * cost if over > _FAR_OFF**2 else _TRIFLE * max(1.0, over)

    def _evaluated(self, common: FloatArray, own_n: FloatArray, rest_m: FloatArray) -> _Evaluated:
        """The normal equations here."""
        windows = self.windows
        normal, local = np.zeros((COMMON, COMMON + 1)), np.zeros((windows.count, 2, COMMON + 3))
        costs = np.zeros(windows.count)
        if not (math.isfinite(float(common.sum())) and float(common[_POSITIVE].min()) > 0.0):
            return _Evaluated(common, own_n, rest_m, math.inf, costs, normal, local)  # no valve
        cost = float(
            normal_equations(
                common, self.reference_speed, own_n, rest_m, windows.slips, windows.first, windows.time_s,
                windows.position_m, windows.rows / self.noise_m**2, self.tie, normal, local, costs,
            )
        )  # fmt: skip
        if self.slaved:
            self._slave(normal, local)
        cost += float(_BELIEF @ self._offset(common) ** 2)
        return _Evaluated(common, own_n, rest_m, cost, costs, normal, local)

    def _step(self, at: _Evaluated, damping: float) -> tuple[_Evaluated, float, float, float] | None:
        """The next point, what was gained, the largest step in standard errors and the next damping; None for none."""
        moving, unit = self._moving, _units(at.common)
        matrix = self._matrix(at)
        pull = (at.normal[:, COMMON] * unit - _BELIEF * self._offset(at.common))[moving]
        diagonal = matrix.diagonal()
        size = np.sqrt(np.abs(diagonal))
        for _ in range(_MOST_DAMPINGS):
            damped = matrix.copy()
            damped.flat[:: moving.size + 1] += damping * diagonal
            _, _, step, singular = dgesv(damped, pull)
            if singular:
                damping = max(10.0 * damping, _LEAST_DAMPING)
                continue
            common, taken = self._moved(at.common, moving, step)
            own_n = at.own_n + at.local[:, 0, COMMON] - at.local[:, 0, :COMMON] @ taken
            rest_m = at.rest_m + at.local[:, 1, COMMON] - at.local[:, 1, :COMMON] @ taken
            new = self._evaluated(common, own_n, rest_m)
            if new.cost <= at.cost * (1.0 + 1.0e-12):
                return new, at.cost - new.cost, float(np.max(np.abs(step) * size)), max(0.1 * damping, 1.0e-12)
            if float(pull @ step) < _TRIFLE:
                break  # the straight equations promise a trifle, and a shorter step gains no more
            damping = max(10.0 * damping, _LEAST_DAMPING)
        return None

    def _matrix(self, at: _Evaluated) -> FloatArray:
        """Normal equations of the unknowns that are solved for, logarithms where they are, beliefs included."""
        moving, unit = self._moving, _units(at.common)
        matrix = at.normal[:, :COMMON] * (unit[:, None] * unit)
        matrix.flat[:: COMMON + 1] += _BELIEF
        return matrix[moving[:, None], moving]

    def _described(self, at: _Evaluated, converged: bool) -> SlipSolution:
        moving, unit = self._moving, _units(at.common)
        try:
            inverse = np.asarray(np.linalg.inv(self._matrix(at)), dtype=np.float64)
        except np.linalg.LinAlgError:
            inverse, converged = np.full((moving.size, moving.size), np.inf), False
        stayed = [i for i in range(COMMON) if i not in moving and not (self.slaved and i == F_S)]
        follows = np.zeros((COMMON, COMMON))
        coupling = at.normal[np.ix_(moving, np.array(stayed, dtype=np.int64))] * unit[moving][:, None]
        follows[np.ix_(moving, np.array(stayed, dtype=np.int64))] = -(inverse @ coupling) * unit[moving][:, None]
        inverse = inverse + self._grid_covariance(at, inverse)
        covariance = np.zeros((COMMON, COMMON))
        covariance[np.ix_(moving, moving)] = inverse * np.outer(unit[moving], unit[moving])
        if self.slaved:
            weights = np.zeros(COMMON)
            weights[A], weights[F_V] = 1.0, -self.reference_speed
            covariance[F_S, :] = covariance[:, F_S] = covariance @ weights
            covariance[F_S, F_S] = float(weights @ covariance @ weights)
            follows[F_S] = weights @ (follows + np.diag(np.isin(np.arange(COMMON), stayed).astype(np.float64)))
        return SlipSolution(
            common=at.common,
            covariance=covariance,
            own_n=at.own_n,
            rest_m=at.rest_m,
            cost=at.cost,
            costs=at.costs,
            freedom=self._freedom,
            converged=converged,
            reference_speed=self.reference_speed,
            follows=follows,
        )

    def _offset(self, common: FloatArray) -> FloatArray:
        """How far m, F_v and DV are from what is believed of them, in logarithms."""
        offset = np.zeros(COMMON)
        offset[_LOGARITHMIC] = np.log(common[_LOGARITHMIC] / self.believed[_LOGARITHMIC])
        return offset

    def _moved(self, common: FloatArray, moving: IntArray, step: FloatArray) -> tuple[FloatArray, FloatArray]:
        by = np.zeros(COMMON)
        by[moving] = step
        moved = common + by
        factors = np.exp(np.minimum(np.maximum(by[_LOGARITHMIC], -_LARGEST_STEP), _LARGEST_STEP))
        moved[_LOGARITHMIC] = common[_LOGARITHMIC] * factors
        slowest = self.windows.slowest_rate / float(moved[K])
        moved[D_V] = min(moved[D_V], _LARGEST_LIMIT * slowest)
        moved[F_V] = min(moved[F_V], moved[A] / self.reference_speed)
        if self.slaved:
            moved[F_S] = moved[A] - moved[F_V] * self.reference_speed
        moved[M] = min(max(moved[M], _LIGHTEST_KG), _HEAVIEST_KG)
        taken = moved - common
        if self.slaved:
            taken[F_S] = 0.0  # its share is in the columns of A and F_v
        return moved, taken

    def _slave(self, normal: FloatArray, local: FloatArray) -> None:
        """Put F_s = A - F_v v_ref into the equations: its column goes to those of A and F_v."""
        for place, by in ((A, 1.0), (F_V, -self.reference_speed)):
            normal[:, place] += by * normal[:, F_S]
            local[:, :, place] += by * local[:, :, F_S]
        for place, by in ((A, 1.0), (F_V, -self.reference_speed)):
            normal[place, :] += by * normal[F_S, :]

    def _grid_covariance(self, at: _Evaluated, inverse: FloatArray) -> FloatArray:
        """What a rest that sits on one step of the sensor's grid adds: all its rows are wrong together."""
        added = np.zeros_like(inverse)
        windows = self.windows
        if windows.rest_error_m == 0.0:
            return added
        moving, unit = self._moving, _units(at.common)
        for slip in range(windows.count):
            score = -at.local[slip, 1, :COMMON] * windows.rest_rows[slip] * windows.rest_error_m / self.noise_m**2
            moved = inverse @ (score * unit)[moving]
            added += np.outer(moved, moved)
        return added


def _units(common: FloatArray) -> FloatArray:
    """What turns a derivative into that to the logarithm, where one is solved for."""
    units = np.ones(COMMON)
    units[_LOGARITHMIC] = common[_LOGARITHMIC]
    return units
