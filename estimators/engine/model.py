"""The model of all sections at once: what it predicts, how far that is off, and how it answers to each unknown.

Unknown are m, F_v, k and the sensor's filter (as logarithms), F_0, F_c, F_s, DV, the force's lead, the fields' values,
and of each section the instant of breakaway and the place of the rest before it, and the parameters of laws beyond the
plain valve. All enter one sum of squares: the whitened positions, the rests' levels, the breakaways' forces and the
priors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.fields import Fields
from estimators.engine.laws import NO_LAWS, Laws, Where
from estimators.engine.motion import Dynamics, Steps, follow, instants, steps_of
from estimators.engine.neighbours import beside
from estimators.engine.nodes import Nodes, Sections
from estimators.engine.noise import PositionNoise
from estimators.engine.parameters import FC, FO, FS, GLOBALS, LEAD, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, Prior
from estimators.engine.row_equations import VARIED, row_equations
from estimators.engine.settings import USUAL, Settings
from estimators.engine.whitening import gather_lines, surprises

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_LOG_STEP: Final = 1.0e-4
_TIME_STEP_S: Final = 1.0e-5
_MOST_COLOURED: Final = 100.0  # times the coloured noise at rest
_COLOURED_SIZES: Final = 12
_BELOW_COULOMB: Final = 0.01  # of F_c: F_s is not below it
_LONGEST_LATER_S: Final = 1.0
_SHORT_REST_S: Final = 0.1
_BESIDE_SHARE: Final = 0.2  # of what other motions have in a rest's level, how well that is known
_COLOURED_TIMES_S: Final = (0.004, 0.01, 0.025, 0.06, 0.15)


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Values of the parameters, shape (9,), fields, (f,), instants (s) and rests (m), (n,), and the laws', (p,)."""

    parameters: FloatArray
    fields: FloatArray
    began_s: FloatArray
    rest_m: FloatArray
    laws: FloatArray = field(default_factory=lambda: np.empty(0))

    def moved(self, step: FloatArray) -> Unknowns:
        """Return the unknowns after this step, in the order parameters, fields, instants, rests, laws.

        ``step``: shape (unknowns,), in SI.
        """
        ends = np.cumsum([GLOBALS, self.fields.size, self.began_s.size, self.rest_m.size])
        by_kind = np.split(step, ends)
        return Unknowns(
            self.parameters + by_kind[0],
            self.fields + by_kind[1],
            self.began_s + by_kind[2],
            self.rest_m + by_kind[3],
            self.laws + by_kind[4],
        )

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return GLOBALS + self.fields.size + 2 * self.began_s.size + self.laws.size

    @property
    def first_instant(self) -> int:
        """Place of the first section's instant among the unknowns."""
        return GLOBALS + self.fields.size

    @property
    def first_rest(self) -> int:
        """Place of the first section's rest among the unknowns."""
        return self.first_instant + self.began_s.size

    @property
    def first_law(self) -> int:
        """Place of the laws' first parameter among the unknowns."""
        return self.count - self.laws.size

    @property
    def dynamics(self) -> Dynamics:
        """What the steps are made of."""
        m, v, k, filter_s = np.exp(self.parameters[[LN_M, LN_V, LN_K, LN_FILTER]])
        return Dynamics(float(m), float(v), float(k), float(filter_s))


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Where the stem was at the nodes of all sections, how fast, m/s, where it rested before, and what is beside it, m.

    ``travel_m`` and ``speed_m_per_s`` have the shape (N,), ``rest_m`` and ``beside_rest_m`` (n,), ``beside_rows_m``
    (R,); see ``nodes.Nodes`` and ``neighbours.beside``.
    """

    travel_m: FloatArray
    speed_m_per_s: FloatArray
    rest_m: FloatArray
    beside_rows_m: FloatArray
    beside_rest_m: FloatArray

    def only(self, nodes: Nodes, chosen: IntArray) -> Paths:
        """Return those of the sections with these numbers, shape (n_chosen,), alone."""
        at = np.concatenate([np.arange(nodes.first[one], nodes.first[one + 1]) for one in chosen])
        rows = np.concatenate([np.arange(nodes.first_row[one], nodes.first_row[one + 1]) for one in chosen])
        return Paths(
            self.travel_m[at],
            self.speed_m_per_s[at],
            self.rest_m[chosen],
            self.beside_rows_m[rows],
            self.beside_rest_m[chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """The motion of all sections from their rests, at the nodes, m, and what the sensor shows of it.

    ``stop`` is the node at which each stopped, ``share`` where in the step to it (``motion.follow``).
    """

    away_m: FloatArray
    speed_m_per_s: FloatArray
    sensed_m: FloatArray
    stop: IntArray
    share: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Breakaways:
    """Of each breakaway the residual of its force, N, the force's rate, the band to DV; F_s over F_c. Shape (n,)."""

    left_n: FloatArray
    rate_n_per_s: FloatArray
    band_n: FloatArray
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Gauss-Newton's normal matrix and right side without the priors', and the sum of squares, at one place."""

    normal: FloatArray
    right: FloatArray
    squares: float
    rows: int
    log_variances: float


@dataclass(slots=True, eq=False)
class Memory:
    """The last steps and the last rows' normal equations, each with what it was made of: a fit asks for them again."""

    steps_of: tuple[object, ...] = ()
    steps: Steps | None = None
    rows_of: tuple[object, ...] = ()
    rows: Linearised | None = None

    @staticmethod
    def same(one: tuple[object, ...], other: tuple[object, ...]) -> bool:
        """Whether these are the same objects."""
        return len(one) == len(other) and all(a is b for a, b in zip(one, other, strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Sections, fields and noise; ``heat`` multiplies the noise, ``scatter_n`` is that of the breakaways."""

    sections: Sections
    fields: Fields
    noise: PositionNoise
    prior: Prior
    at_rest: PositionNoise
    scatter_n: float
    heat: float = 1.0
    laws: Laws = NO_LAWS
    settings: Settings = USUAL
    memory: Memory = field(default_factory=Memory)

    def heated(self, heat: float, scatter_n: float) -> Model:
        """Return the model with the noise as many times as large, and this scatter."""
        return replace(self, heat=heat, scatter_n=scatter_n)

    def only(self, chosen: IntArray) -> Model:
        """Return the model of the sections with these numbers, shape (n_chosen,), alone."""
        some = tuple(self.sections.sections[number] for number in chosen)
        if len(some) == self.sections.count:
            return self
        spans_s = [(float(section.time_s[0]), float(section.time_s[-1])) for section in some]
        sections = Sections(some, self.sections.step_s, self.sections.left_out + self.sections.count - len(some))
        return replace(self, sections=sections, fields=self.fields.within(spans_s))

    def measured_paths(self) -> Paths:
        """Paths as they were measured."""
        nodes = self.sections.nodes
        speeds = [np.gradient(section.path_m, section.time_s) for section in self.sections.sections]
        nothing = np.zeros(nodes.row.size), np.zeros(self.sections.count)
        return Paths(nodes.path_m, np.concatenate(speeds), nodes.rest_m, *nothing)

    def _where(self, paths: Paths) -> Where:
        """The laws' coordinates at the nodes."""
        nodes = self.sections.nodes
        forces = nodes.force_n, nodes.rate_n_per_s
        return Where(nodes.time_s, paths.travel_m, paths.speed_m_per_s, *forces, *nodes.way)

    def _rest_where(self, paths: Paths) -> Where:
        """The laws' coordinates at the ends of the rests before the sections."""
        nodes = self.sections.nodes
        forces = nodes.rest_force_n, nodes.rest_rate_n_per_s
        return Where(nodes.seen_s, paths.rest_m, np.zeros(self.sections.count), *forces, *nodes.rest_way)

    def _force(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """Force that drives the stem away from its rest, at the nodes."""
        nodes, at, sign = self.sections.nodes, unknowns.parameters, self.sections.nodes.way[0]
        friction_n = at[FC] + self.fields.friction_n(paths.travel_m, nodes.time_s, sign > 0.0, unknowns.fields)
        spring_n = np.repeat(math.exp(at[LN_K]) * unknowns.rest_m, np.diff(nodes.first))
        force_n = nodes.force_n - at[LEAD] * nodes.rate_n_per_s - at[FO] - sign * friction_n - spring_n
        if self.laws.laws:
            force_n += self.laws.driving_n(unknowns.laws, self._where(paths))
        return np.asarray(force_n)

    def _instants(self, unknowns: Unknowns) -> tuple[IntArray, IntArray, FloatArray]:
        nodes = self.sections.nodes
        found: tuple[IntArray, IntArray, FloatArray] = instants(nodes.time_s, nodes.first, unknowns.began_s)
        return found

    def _steps(self, unknowns: Unknowns) -> Steps:
        """Steps of all lengths, then the first one of each section."""
        made_of = unknowns, self.sections
        if self.memory.steps is None or not Memory.same(self.memory.steps_of, made_of):
            first_s = self.sections.nodes.time_s[self._instants(unknowns)[0]] - unknowns.began_s
            self.memory.steps_of = made_of
            self.memory.steps = steps_of(unknowns.dynamics, np.concatenate([self.sections.step_s, first_s]))
        return self.memory.steps

    def _follow(self, steps: Steps, force_n: FloatArray, unknowns: Unknowns) -> Followed:
        nodes, limit = self.sections.nodes, math.exp(unknowns.parameters[LN_DV])
        return Followed(
            *follow(
                nodes.time_s, nodes.step, nodes.first, *self._instants(unknowns), nodes.free, nodes.direction, limit,
                force_n, *steps,
            )
        )  # fmt: skip

    def _noise(self) -> tuple[FloatArray, float, float]:
        """Variances of the rows, shape (R,), and of the coloured noise, m^2, and its time, s."""
        white = self.noise.white_m**2 / self.sections.nodes.rows
        return self.heat**2 * white, self.heat**2 * self.noise.coloured_m**2, self.noise.coloured_s

    def squares(self, unknowns: Unknowns, paths: Paths) -> float:
        """Return the whole sum of squares, the priors' with it."""
        nodes, (white, coloured, coloured_s) = self.sections.nodes, self._noise()
        left_m = self._left(unknowns, paths)
        total = surprises(nodes.row_time_s, left_m, white, nodes.first_row, coloured, coloured_s)[0]
        rests = self._rest_left(unknowns, paths) / self._rest_error_m(paths)
        breakaways = self._breakaways(unknowns, paths).left_n / self.scatter_n
        return float(total + rests @ rests + breakaways @ breakaways) + self.prior_squares(unknowns)

    def _rest_left(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """Measured less modelled levels of the rests, m."""
        return self.sections.nodes.rest_m - paths.beside_rest_m - unknowns.rest_m

    def _rest_error_m(self, paths: Paths) -> FloatArray:
        """Standard errors of the levels of the rests, m: the noise's, and of what other motions have in them."""
        nodes = self.sections.nodes
        coloured_m = np.where(nodes.rested_s < _SHORT_REST_S, self.at_rest.coloured_m, 0.0)
        own_m = np.hypot(nodes.rest_error_m, coloured_m)
        return self.heat * np.hypot(own_m, _BESIDE_SHARE * paths.beside_rest_m)

    def _off(self, unknowns: Unknowns, paths: Paths, sensed_m: FloatArray) -> FloatArray:
        """Measured less modelled positions at the rows, m; the sensor's motion is given at the nodes."""
        nodes = self.sections.nodes
        rest_m = np.repeat(unknowns.rest_m, np.diff(nodes.first_row))
        return nodes.measured_m - paths.beside_rows_m - rest_m - sensed_m[nodes.row]

    def prior_squares(self, unknowns: Unknowns) -> float:
        """Return what the priors add."""
        away = (unknowns.parameters - self.prior.mean) / self.prior.spread
        squares = float(away @ away) + float(unknowns.fields @ self.fields.precision @ unknowns.fields)
        squares += self.below_coulomb(unknowns)[0] ** 2
        if self.laws.count:
            squares += float(np.sum(((unknowns.laws - self.laws.mean) / self.laws.spread) ** 2))
        return squares

    @staticmethod
    def below_coulomb(unknowns: Unknowns) -> tuple[float, float]:
        """By how much F_s is below F_c, in what it may be, and the slope of that by F_c; zeros where it is not."""
        static, coulomb = unknowns.parameters[FS], unknowns.parameters[FC]
        if static >= coulomb:
            return 0.0, 0.0
        slope = 1.0 / (_BELOW_COULOMB * max(coulomb, 1.0e-9))
        return slope * (coulomb - static), slope

    def _breakaways(self, unknowns: Unknowns, paths: Paths) -> Breakaways:
        """The balance of forces at the instants of breakaway."""
        nodes, at, sign = self.sections.nodes, unknowns.parameters, self.sections.nodes.direction
        _, after, part = self._instants(unknowns)
        whole_n, rate = (
            values[after - 1] + part * (values[after] - values[after - 1])
            for values in (nodes.force_n, nodes.rate_n_per_s)
        )
        force_n = whole_n - at[LEAD] * rate
        net_n = sign * (force_n - math.exp(at[LN_K]) * unknowns.rest_m - at[FO])
        band_n = np.sqrt(2.0 * math.exp(at[LN_M] + at[LN_DV]) * np.abs(rate))
        share = float(at[FS] / max(at[FC], 1.0e-9))
        local_n = share * self.fields.friction_n(paths.rest_m, nodes.seen_s, sign > 0.0, unknowns.fields)
        if self.laws.laws:
            local_n += self.laws.breakaway_n(unknowns.laws, self._rest_where(paths), share)
        return Breakaways(net_n - band_n - at[FS] - local_n, rate, band_n, share)

    def followed_paths(self, unknowns: Unknowns, paths: Paths) -> Paths:
        """Return the paths of the stem that these unknowns make."""
        nodes = self.sections.nodes
        one = self._follow(self._steps(unknowns), self._force(unknowns, paths), unknowns)
        travel_m = np.repeat(unknowns.rest_m, np.diff(nodes.first)) + one.away_m
        near = beside(nodes, one.away_m, one.sensed_m, one.stop, unknowns.dynamics.filter_s, self.settings.beside)
        return Paths(travel_m, one.speed_m_per_s, unknowns.rest_m, *near)

    def linearised(self, unknowns: Unknowns, paths: Paths) -> Linearised:
        """Return the normal equations here, the priors' left out."""
        made_of = unknowns, paths, self.sections, self.noise, self.laws
        if self.memory.rows is None or not Memory.same(self.memory.rows_of, made_of):
            self.memory.rows_of = made_of
            self.memory.rows = replace(self, heat=1.0)._rows_linearised(unknowns, paths)
        cold, cooler = self.memory.rows, self.heat**-2.0
        normal, right = cooler * cold.normal, cooler * cold.right
        left, numbers, slopes = self._breakaway_lines(unknowns, paths)
        gather_lines(slopes, numbers, left, self.scatter_n**-2.0, normal, right)
        logarithms = cold.log_variances + 2.0 * cold.rows * math.log(self.heat)
        return Linearised(normal, right, cooler * cold.squares, cold.rows, logarithms)

    def _rows_linearised(self, unknowns: Unknowns, paths: Paths) -> Linearised:
        """The normal equations of all rows and of the rests' levels."""
        nodes, count = self.sections.nodes, unknowns.count
        normal, right = np.zeros((count, count)), np.zeros(count)
        (_, base, _), *varied = self._varied(unknowns)
        force_n = self._force(unknowns, paths)
        one = self._follow(base, force_n, unknowns)
        direct, moved = np.empty((len(varied), nodes.row.size)), np.empty((len(varied), nodes.time_s.size))
        for line, (other, steps, step) in enumerate(varied):
            # the force knows nothing of the other times
            same = other.laws is unknowns.laws and other.parameters[LN_K] == unknowns.parameters[LN_K]
            there = self._follow(steps, force_n if same else self._force(other, paths), other)
            direct[line] = (there.sensed_m - one.sensed_m)[nodes.row] / step
            moved[line] = (there.away_m - one.away_m) / step
        stops = one.stop, one.share, _later_s(nodes, one, math.exp(unknowns.parameters[LN_DV]))
        sign = nodes.way[0]
        # a stem that is elsewhere meets another friction
        stiffer = sign * self.fields.slope_n_per_m(paths.travel_m, sign > 0.0, unknowns.fields)
        squares, logarithms = row_equations(
            nodes, tuple(base), self._instants(unknowns), stops, (self.fields.travel_m, self.fields.time_s),
            paths.travel_m, math.exp(unknowns.parameters[LN_K]), stiffer, self._off(unknowns, paths, one.sensed_m),
            direct, moved, self._noise(), normal, right,
        )  # fmt: skip
        rests, weight = unknowns.first_rest + np.arange(self.sections.count), self._rest_error_m(paths) ** -2.0
        normal[rests, rests] += weight
        right[rests] += weight * self._rest_left(unknowns, paths)
        return Linearised(normal, right, squares, nodes.row.size, logarithms)

    def _varied(self, unknowns: Unknowns) -> list[tuple[Unknowns, Steps, float]]:
        """The unknowns, then the same with one of them varied: each dynamic one, all instants, each of the laws.

        With each its steps, and by how much it is varied.
        """
        base = self._steps(unknowns)
        varied = [(unknowns, base, 0.0)]
        for at in VARIED:
            moved = unknowns.parameters.copy()
            moved[at] += _LOG_STEP
            one = replace(unknowns, parameters=moved)
            varied.append((one, base if at == LN_DV else self._steps(one), _LOG_STEP))
        later = replace(unknowns, began_s=unknowns.began_s + _TIME_STEP_S)
        varied.append((later, self._steps(later), _TIME_STEP_S))
        varied += [(one, base, step) for one, step in self._varied_laws(unknowns)]
        return varied

    def _varied_laws(self, unknowns: Unknowns) -> Iterator[tuple[Unknowns, float]]:
        """The unknowns with each of the laws' parameters varied, and by how much."""
        for at, parameter in enumerate(self.laws.parameters):
            # away from a bound, beyond which a law may not be defined
            step = parameter.step if unknowns.laws[at] + parameter.step <= parameter.high else -parameter.step
            moved = unknowns.laws.copy()
            moved[at] += step
            yield replace(unknowns, laws=moved), step

    def _breakaway_lines(self, unknowns: Unknowns, paths: Paths) -> tuple[FloatArray, IntArray, FloatArray]:
        """Residuals of the breakaways' forces, N, and their slopes by the unknowns of these numbers, the sign changed.

        Shapes (n,), (n, lines), (n, lines).
        """
        nodes, count = self.sections.nodes, self.sections.count
        one = self._breakaways(unknowns, paths)
        of_laws = [
            (one.left_n - self._breakaways(moved, paths).left_n) / step for moved, step in self._varied_laws(unknowns)
        ]
        spring, sign = math.exp(unknowns.parameters[LN_K]), nodes.direction
        touched, shares = self.fields.beside(paths.rest_m, nodes.seen_s, sign > 0.0)
        each = np.arange(count)
        by_unknown = {
            LN_K: sign * spring * unknowns.rest_m,
            FO: sign,
            FS: np.ones(count),
            LN_M: 0.5 * one.band_n,
            LN_DV: 0.5 * one.band_n,
            LEAD: sign * one.rate_n_per_s,
        }
        numbers = [
            *(np.full(count, at) for at in by_unknown),
            unknowns.first_instant + each,
            unknowns.first_rest + each,
        ]
        numbers += [*(GLOBALS + touched).T, *(np.full(count, unknowns.first_law + at) for at in range(self.laws.count))]
        slopes = [*by_unknown.values(), -sign * one.rate_n_per_s, sign * spring, *(one.share * shares).T, *of_laws]
        return one.left_n, np.column_stack(numbers).astype(np.int64), np.column_stack(slopes)

    def breakaway_slopes(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """Slopes of the breakaways' residuals by the unknowns, the sign changed, shape (n, unknowns)."""
        _, numbers, slopes = self._breakaway_lines(unknowns, paths)
        out = np.zeros((self.sections.count, unknowns.count))
        np.put_along_axis(out, numbers, slopes, axis=1)
        return out

    def recoloured(self, unknowns: Unknowns, paths: Paths) -> Model:
        """Return the model with the coloured noise that makes what is left at these unknowns likeliest.

        In motion it holds more than the sensor's: an I/P that hunts, and friction between the fields' knots.
        """
        if not self.settings.recoloured:
            return self
        nodes, left = self.sections.nodes, self._left(unknowns, paths)
        white = self.noise.white_m**2 / nodes.rows
        best, best_cost = self.noise, math.inf
        floor_m = max(self.at_rest.coloured_m, 0.03 * self.at_rest.white_m)
        for size_m in floor_m * np.geomspace(1.0, _MOST_COLOURED, _COLOURED_SIZES):
            for time_s in _COLOURED_TIMES_S:
                cost = sum(surprises(nodes.row_time_s, left, white, nodes.first_row, size_m**2, time_s))
                if cost < best_cost:
                    best, best_cost = replace(self.noise, coloured_m=float(size_m), coloured_s=time_s), cost
        return replace(self, noise=best, heat=1.0)

    def _left(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """Residuals of the rows, m, shape (R,)."""
        followed = self._follow(self._steps(unknowns), self._force(unknowns, paths), unknowns)
        return self._off(unknowns, paths, followed.sensed_m)

    def section_chi(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """What each section leaves, root mean square over its rows in white noises of one, shape (n,).

        The mean of many rows counts as each of them: in their own noise a long slide would never be understood.
        """
        nodes = self.sections.nodes
        squares = np.add.reduceat(nodes.rows * self._left(unknowns, paths) ** 2, nodes.first_row[:-1])
        return np.asarray(np.sqrt(squares / np.add.reduceat(nodes.rows, nodes.first_row[:-1])) / self.noise.white_m)

    def residual_rms(self, unknowns: Unknowns, paths: Paths, white_m: float) -> float:
        """Root mean square of measured minus modelled position, the fields and rests as found, m.

        ``white_m`` is the noise of a row, of which the means of many rows keep little.
        """
        rows = self.sections.nodes.rows
        squares = rows @ self._left(unknowns, paths) ** 2 + white_m**2 * (rows - 1.0).sum()
        return float(np.sqrt(squares / rows.sum()))

    def breakaway_residuals(self, unknowns: Unknowns, paths: Paths) -> FloatArray:
        """Residuals of the breakaways' forces, N, shape (n,)."""
        return self._breakaways(unknowns, paths).left_n


def _later_s(nodes: Nodes, one: Followed, limit_m_per_s: float) -> FloatArray:
    """How far a stem goes on at its stop for each m/s that it is faster there: DV over its slowing down, s."""
    later_s = np.zeros(one.stop.size)
    known = np.flatnonzero((one.stop - nodes.first[:-1] >= 2) & (one.stop < nodes.first[1:]))
    stop = one.stop[known]
    lost = nodes.direction[known] * (one.speed_m_per_s[stop - 2] - one.speed_m_per_s[stop - 1])
    step_s = nodes.time_s[stop - 1] - nodes.time_s[stop - 2]
    slows = lost > 0.0
    later_s[known[slows]] = np.minimum(limit_m_per_s * step_s[slows] / lost[slows], _LONGEST_LATER_S)
    return later_s
