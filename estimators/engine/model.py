"""The model of all sections at once: what it predicts, how far that is off, and how it answers to each unknown.

Unknown are m, F_v, k and the sensor's filter (as logarithms), F_0, F_c, F_s, DV, the force's lead, the fields' values,
and of each section the instant of breakaway and the place of the rest before it, and the parameters of laws beyond the
plain valve. All enter one sum of squares: the whitened positions, the rests' levels, the breakaways' forces and the
priors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.fields import Fields
from estimators.engine.laws import NO_LAWS, Laws, Travel, Where
from estimators.engine.motion import Dynamics, Steps, after_play, answers, follow, steps_of
from estimators.engine.neighbours import Beside, Followed, beside
from estimators.engine.noise import PositionNoise
from estimators.engine.parameters import FC, FO, FS, GLOBALS, LEAD, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, Prior
from estimators.engine.sections import Section, Sections
from estimators.engine.settings import USUAL, Settings
from estimators.engine.whitening import gather, surprises, whitened

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_LOG_STEP: Final = 1.0e-4
_TIME_STEP_S: Final = 1.0e-5
_DYNAMIC: Final = (LN_M, LN_V, LN_K, LN_FILTER, LN_DV)
_FORCED: Final = (FO, FC, LEAD)
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
    def first_law(self) -> int:
        """Place of the laws' first parameter among the unknowns."""
        return self.count - self.laws.size

    @property
    def dynamics(self) -> Dynamics:
        """What the steps are made of."""
        m, v, k, filter_s = np.exp(self.parameters[[LN_M, LN_V, LN_K, LN_FILTER]])
        return Dynamics(float(m), float(v), float(k), float(filter_s))


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where the stem was at a section's nodes, how fast, m/s, where it rested before, and what is beside it, m."""

    travel_m: FloatArray
    speed_m_per_s: FloatArray
    rest_m: float
    beside: Beside


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

    def measured_paths(self) -> list[Path]:
        """Paths as they were measured."""
        return [
            Path(
                section.path_m,
                np.gradient(section.path_m, section.time_s),
                section.rest_m,
                Beside(np.zeros(section.row.size), 0.0),
            )
            for section in self.sections.sections
        ]

    @staticmethod
    def _where(section: Section, path: Path) -> Where:
        """The laws' coordinates at a section's nodes."""
        way = np.array([[section.direction], [section.rested_s], [section.before]], dtype=np.float64)
        everywhere = np.broadcast_to(way, (3, path.travel_m.size))
        forces = section.force_n, section.rate_n_per_s
        return Where(section.time_s, path.travel_m, path.speed_m_per_s, *forces, *everywhere)

    @staticmethod
    def _rest_where(section: Section, path: Path) -> Where:
        """The laws' coordinates at the end of the rest before a section."""
        way = np.array([[section.direction], [section.rested_s], [section.before]], dtype=np.float64)
        now_s = np.array([section.began_s])
        force_n = np.interp(now_s, section.time_s, section.force_n)
        rate = np.interp(now_s, section.time_s, section.rate_n_per_s)
        return Where(now_s, np.array([path.rest_m]), np.zeros(1), force_n, rate, *way)

    def _play(self, section: Section, unknowns: Unknowns) -> tuple[float, float, Travel]:
        """How far the stem is from where the sensor sees it at a rest, m; the play that it takes up; the travel."""
        travel = self.laws.travel(unknowns.laws)
        if travel.play_m == 0.0:
            return 0.0, 0.0, travel
        # the sensor trails the stem by half of the play
        if section.before == 0:
            taken_m = travel.first_share * travel.play_m
        else:
            taken_m = travel.play_m if section.before != section.direction else 0.0
        return section.direction * (0.5 * travel.play_m - taken_m), taken_m, travel

    def _force(self, number: int, unknowns: Unknowns, path: Path) -> FloatArray:
        """Force that drives the stem away from its rest, at the nodes."""
        section, at = self.sections.sections[number], unknowns.parameters
        friction_n = at[FC] + self.fields.friction_n(path.travel_m, section.time_s, section.direction, unknowns.fields)
        spring_n = math.exp(at[LN_K]) * (unknowns.rest_m[number] + self._play(section, unknowns)[0])
        force_n = section.force_n - at[LEAD] * section.rate_n_per_s - at[FO] - section.direction * friction_n - spring_n
        if self.laws.laws:
            force_n = force_n + self.laws.driving_n(unknowns.laws, self._where(section, path))
        return np.asarray(force_n)

    def _steps(self, unknowns: Unknowns) -> Steps:
        """Steps of all lengths, then the first one of each section."""
        made_of = unknowns, self.sections
        if self.memory.steps is None or not Memory.same(self.memory.steps_of, made_of):
            first_s = [
                float(section.time_s[section.time_s.searchsorted(began, side="right")]) - began
                for section, began in zip(self.sections.sections, unknowns.began_s, strict=True)
            ]
            self.memory.steps_of = made_of
            self.memory.steps = steps_of(unknowns.dynamics, np.concatenate([self.sections.step_s, first_s]))
        return self.memory.steps

    def _follow(
        self, number: int, steps: Steps, force_n: FloatArray, unknowns: Unknowns
    ) -> tuple[FloatArray, FloatArray, FloatArray, int, float]:
        section = self.sections.sections[number]
        began_s, limit = float(unknowns.began_s[number]), math.exp(unknowns.parameters[LN_DV])
        first_n = float(_at_instant(section, began_s, force_n))
        away_m, taken_m, travel = self._play(section, unknowns)
        end_m = (travel.high_m if section.direction > 0 else travel.low_m) - unknowns.rest_m[number] - away_m
        found: tuple[FloatArray, FloatArray, FloatArray, int, float] = follow(
            section.time_s, section.step, self.sections.step_s.size + number, section.free, float(section.direction),
            limit, end_m, began_s, first_n, force_n, steps.state, steps.from_start, steps.from_end, steps.sensor,
        )  # fmt: skip
        if travel.play_m > 0.0:
            filter_s = unknowns.dynamics.filter_s
            shown = after_play(section.time_s, began_s, float(section.direction), taken_m, found[0], filter_s)
            found = (*found[:2], shown, *found[3:])
        return found

    def _noise(self, section: Section) -> tuple[FloatArray, float]:
        """Variances of a section's rows and of the coloured noise, m^2."""
        white = self.noise.white_m**2 / section.rows
        return self.heat**2 * white, self.heat**2 * self.noise.coloured_m**2

    def _whitened(self, section: Section, lines: FloatArray) -> tuple[FloatArray, float]:
        """Innovations of each line in their standard deviations, and the sum of the variances' logarithms."""
        white, coloured = self._noise(section)
        times_s = section.time_s[section.row]
        found: tuple[FloatArray, float] = whitened(times_s, lines, white, coloured, self.noise.coloured_s)
        return found

    def squares(self, unknowns: Unknowns, paths: list[Path]) -> float:
        """Return the whole sum of squares, the priors' with it."""
        steps = self._steps(unknowns)
        total = 0.0
        for number, (section, path) in enumerate(zip(self.sections.sections, paths, strict=True)):
            force_n = self._force(number, unknowns, path)
            sensed_m = self._follow(number, steps, force_n, unknowns)[2]
            left = self._off(number, unknowns, path, sensed_m)
            white = self._whitened(section, left[None, :])[0][0]
            total += float(white @ white)
            rest_m = section.rest_m - path.beside.rest_m
            total += ((rest_m - unknowns.rest_m[number]) / self._rest_error_m(section, path)) ** 2
            total += (self._breakaway(number, unknowns, path)[0] / self._breakaway_error()) ** 2
        return total + self.prior_squares(unknowns)

    def _rest_error_m(self, section: Section, path: Path) -> float:
        """Standard error of the level of a rest, m: the noise's, and of what other motions have in it."""
        own_m = math.hypot(section.rest_error_m, self.at_rest.coloured_m if section.rested_s < _SHORT_REST_S else 0.0)
        return self.heat * math.hypot(own_m, _BESIDE_SHARE * path.beside.rest_m)

    def _off(self, number: int, unknowns: Unknowns, path: Path, sensed_m: FloatArray) -> FloatArray:
        """Measured less modelled positions at a section's rows, m; the sensor's motion is given at its nodes."""
        section = self.sections.sections[number]
        return np.asarray(section.measured_m - path.beside.rows_m - unknowns.rest_m[number] - sensed_m[section.row])

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

    def _breakaway_error(self) -> float:
        return self.scatter_n

    def _breakaway(self, number: int, unknowns: Unknowns, path: Path) -> tuple[float, float, float, float]:
        """Residual of a breakaway's force, N, the force's rate, the band to DV, and the share of the local friction."""
        section, at = self.sections.sections[number], unknowns.parameters
        began_s = float(unknowns.began_s[number])
        whole_n = float(_at_instant(section, began_s, section.force_n))
        rate = float(_at_instant(section, began_s, section.rate_n_per_s))
        force_n = whole_n - at[LEAD] * rate
        place_m = unknowns.rest_m[number] + self._play(section, unknowns)[0]
        net_n = section.direction * (force_n - math.exp(at[LN_K]) * place_m - at[FO])
        band_n = math.sqrt(2.0 * math.exp(at[LN_M] + at[LN_DV]) * abs(rate))
        share = at[FS] / max(at[FC], 1.0e-9)
        here = np.array([path.rest_m]), np.array([section.began_s]), section.direction
        local_n = share * float(self.fields.friction_n(*here, unknowns.fields)[0])
        if self.laws.laws:
            local_n += self.laws.breakaway_n(unknowns.laws, self._rest_where(section, path), share)
        return float(net_n - band_n - at[FS] - local_n), rate, band_n, share

    def followed_paths(self, unknowns: Unknowns, paths: list[Path]) -> list[Path]:
        """Return the paths of the stem that these unknowns make."""
        steps = self._steps(unknowns)
        followed = []
        for number, (section, path) in enumerate(zip(self.sections.sections, paths, strict=True)):
            away_m, speed, sensed_m, stop, _ = self._follow(
                number, steps, self._force(number, unknowns, path), unknowns
            )
            settled_m = max(section.direction * float(away_m[-1]) - self._play(section, unknowns)[1], 0.0)
            settled_m = section.direction * settled_m if stop < section.time_s.size else math.nan
            followed.append(Followed(section, away_m, speed, sensed_m, sensed_m - settled_m))
        new = []
        for number, one in enumerate(followed):
            before = followed[number - 1] if number > 0 else None
            after = followed[number + 1] if number + 1 < len(followed) else None
            if not self.settings.beside:
                before = after = None
            rest_m = float(unknowns.rest_m[number]) + self._play(one.section, unknowns)[0]
            beside_it = beside(one.section, one.sensed_m, before, after, unknowns.dynamics.filter_s)
            new.append(Path(rest_m + one.away_m, one.speed_m_per_s, rest_m, beside_it))
        return new

    def linearised(self, unknowns: Unknowns, paths: list[Path]) -> Linearised:
        """Return the normal equations here, the priors' left out."""
        made_of = unknowns, paths, self.sections, self.noise, self.laws
        if self.memory.rows is None or not Memory.same(self.memory.rows_of, made_of):
            self.memory.rows_of = made_of
            self.memory.rows = replace(self, heat=1.0)._rows_linearised(unknowns, paths)
        cold, cooler = self.memory.rows, self.heat**-2.0
        normal, right = cooler * cold.normal, cooler * cold.right
        for number, path in enumerate(paths):
            self._add_breakaway(number, unknowns, path, normal, right)
        logarithms = cold.log_variances + 2.0 * cold.rows * math.log(self.heat)
        return Linearised(normal, right, cooler * cold.squares, cold.rows, logarithms)

    def _rows_linearised(self, unknowns: Unknowns, paths: list[Path]) -> Linearised:
        """The normal equations of all rows and of the rests' levels."""
        count, fields = unknowns.count, unknowns.fields.size
        normal, right = np.zeros((count, count)), np.zeros(count)
        squares, rows, logarithms = 0.0, 0, 0.0
        tried = self._varied(unknowns)
        of_laws = unknowns.first_law + np.arange(self.laws.count)
        for number, (section, path) in enumerate(zip(self.sections.sections, paths, strict=True)):
            began_at, rest_at = GLOBALS + fields + number, GLOBALS + fields + self.sections.count + number
            shares, touched = self.fields.lines(path.travel_m, section.time_s, section.direction)
            numbers = np.concatenate([_FORCED, [rest_at], GLOBALS + touched, _DYNAMIC, [began_at], of_laws])
            lines = self._section_lines(number, path, tried, shares)
            white, log_variances = self._whitened(section, lines)
            gather(white, numbers.astype(np.int64), normal, right)
            squares += float(white[0] @ white[0])
            rows += white.shape[1]
            logarithms += log_variances
            error_m = self._rest_error_m(section, path)
            normal[rest_at, rest_at] += error_m**-2.0
            right[rest_at] += (section.rest_m - path.beside.rest_m - unknowns.rest_m[number]) / error_m**2
        return Linearised(normal, right, squares, rows, logarithms)

    def _varied(self, unknowns: Unknowns) -> list[tuple[Unknowns, Steps, float]]:
        """The unknowns, then the same with one of them varied: each dynamic one, all instants, each of the laws.

        With each its steps, and by how much it is varied.
        """
        base = self._steps(unknowns)
        varied = [(unknowns, base, 0.0)]
        for at in _DYNAMIC:
            moved = unknowns.parameters.copy()
            moved[at] += _LOG_STEP
            one = replace(unknowns, parameters=moved)
            varied.append((one, base if at == LN_DV else self._steps(one), _LOG_STEP))
        later = replace(unknowns, began_s=unknowns.began_s + _TIME_STEP_S)
        varied.append((later, self._steps(later), _TIME_STEP_S))
        for at, parameter in enumerate(self.laws.parameters):
            # away from a bound, beyond which a law may not be defined
            step = parameter.step if unknowns.laws[at] + parameter.step <= parameter.high else -parameter.step
            moved = unknowns.laws.copy()
            moved[at] += step
            varied.append((replace(unknowns, laws=moved), base, step))
        return varied

    def _section_lines(
        self, number: int, path: Path, tried: list[tuple[Unknowns, Steps, float]], shares: FloatArray
    ) -> FloatArray:
        """Residual and slopes of a section's rows: forces, rest, fields (by their shares), dynamics, instant, laws.

        ``tried``: the unknowns, and all that are varied.
        """
        unknowns, base, _ = tried[0]
        section = self.sections.sections[number]
        began_s, spring = float(unknowns.began_s[number]), math.exp(unknowns.parameters[LN_K])
        force_n = self._force(number, unknowns, path)
        away_m, speed_m_per_s, sensed_m, stop, share = self._follow(number, base, force_n, unknowns)
        later_s = _later_s(section, speed_m_per_s, stop, math.exp(unknowns.parameters[LN_DV]))
        direct, moved = [], []
        for one, steps, step in tried[1:]:
            # the force knows nothing of the other times
            same = one.laws is unknowns.laws and one.parameters[LN_K] == unknowns.parameters[LN_K]
            other_n = force_n if same else self._force(number, one, path)
            other_m, _, other_sensed_m, *_ = self._follow(number, steps, other_n, one)
            direct.append((other_sensed_m - sensed_m)[section.row] / step)
            moved.append((other_m - away_m) / step)
        # a stem that is elsewhere meets another friction
        stiffer = section.direction * self.fields.slope_n_per_m(path.travel_m, section.direction, unknowns.fields)
        rest, met = len(_FORCED), len(_FORCED) + 1 + shares.shape[0]
        driven = np.empty((met + len(moved), section.time_s.size))
        driven[0], driven[1], driven[2], driven[3] = -1.0, -section.direction, -section.rate_n_per_s, -spring
        np.multiply(shares, -section.direction, out=driven[rest + 1 : met])
        np.multiply(moved, -stiffer, out=driven[met:])
        first = _at_instant(section, began_s, driven.T)
        out = np.zeros((1 + driven.shape[0], section.row.size))
        out[0] = self._off(number, unknowns, path, sensed_m)
        answers(
            section.time_s, section.step, section.row, self.sections.step_s.size + number, stop, share, later_s,
            began_s, first, driven, stiffer, base.state, base.from_start, base.from_end, base.sensor, out[1:],
        )  # fmt: skip
        taken_m = self._play(section, unknowns)[1]
        if taken_m > 0.0:
            # the sensor sees nothing of the stem until it has taken up the play
            out[1:, section.direction * away_m[section.row] <= taken_m] = 0.0
        out[1 + rest] += 1.0
        out[1 + met :] += direct
        return out

    def _add_breakaway(
        self, number: int, unknowns: Unknowns, path: Path, normal: FloatArray, right: FloatArray
    ) -> None:
        left, numbers, slopes = self._breakaway_line(number, unknowns, path)
        weight = self._breakaway_error() ** -2.0
        normal[np.ix_(numbers, numbers)] += weight * np.outer(slopes, slopes)
        right[numbers] += weight * slopes * left

    def _breakaway_line(self, number: int, unknowns: Unknowns, path: Path) -> tuple[float, IntArray, FloatArray]:
        """Residual of a breakaway's force, N, and its slopes by the unknowns of these numbers, the sign changed."""
        section, fields = self.sections.sections[number], unknowns.fields.size
        left, rate, band_n, share = self._breakaway(number, unknowns, path)
        of_laws = []
        for at, parameter in enumerate(self.laws.parameters):
            step = parameter.step if unknowns.laws[at] + parameter.step <= parameter.high else -parameter.step
            moved = unknowns.laws.copy()
            moved[at] += step
            of_laws.append((left - self._breakaway(number, replace(unknowns, laws=moved), path)[0]) / step)
        here = np.array([path.rest_m]), np.array([section.began_s]), section.direction
        shares, touched = self.fields.lines(*here)
        spring, sign = math.exp(unknowns.parameters[LN_K]), section.direction
        began_at, rest_at = GLOBALS + fields + number, GLOBALS + fields + self.sections.count + number
        numbers = np.array([LN_K, FO, FS, LN_M, LN_DV, LEAD, began_at, rest_at, *(GLOBALS + touched),
                            *(unknowns.first_law + np.arange(self.laws.count))])  # fmt: skip
        slopes = np.array(
            [
                sign * spring * unknowns.rest_m[number],
                sign,
                1.0,
                0.5 * band_n,
                0.5 * band_n,
                sign * rate,
                -sign * rate,
                sign * spring,
                *(share * shares[:, 0]),
                *of_laws,
            ]
        )
        return left, numbers, slopes

    def breakaway_slopes(self, unknowns: Unknowns, paths: list[Path]) -> FloatArray:
        """Slopes of the breakaways' residuals by the unknowns, the sign changed, shape (n, unknowns)."""
        out = np.zeros((len(paths), unknowns.count))
        for number, path in enumerate(paths):
            _, numbers, slopes = self._breakaway_line(number, unknowns, path)
            out[number, numbers] = slopes
        return out

    def recoloured(self, unknowns: Unknowns, paths: list[Path]) -> Model:
        """Return the model with the coloured noise that makes what is left at these unknowns likeliest.

        In motion it holds more than the sensor's: an I/P that hunts, and friction between the fields' knots.
        """
        if not self.settings.recoloured:
            return self
        sections = self.sections.sections
        left = np.concatenate(self._left(unknowns, paths))
        times_s = np.concatenate([section.time_s[section.row] for section in sections])
        white = self.noise.white_m**2 / np.concatenate([section.rows for section in sections])
        firsts = np.cumsum([0, *(section.row.size for section in sections)])
        best, best_cost = self.noise, math.inf
        floor_m = max(self.at_rest.coloured_m, 0.03 * self.at_rest.white_m)
        for size_m in floor_m * np.geomspace(1.0, _MOST_COLOURED, _COLOURED_SIZES):
            for time_s in _COLOURED_TIMES_S:
                cost = surprises(times_s, left, white, firsts, size_m**2, time_s)
                if cost < best_cost:
                    best, best_cost = replace(self.noise, coloured_m=float(size_m), coloured_s=time_s), cost
        return replace(self, noise=best, heat=1.0)

    def _left(self, unknowns: Unknowns, paths: list[Path]) -> list[FloatArray]:
        """Residuals of each section's rows, m, shape (rows,)."""
        left = []
        steps = self._steps(unknowns)
        for number, path in enumerate(paths):
            sensed_m = self._follow(number, steps, self._force(number, unknowns, path), unknowns)[2]
            left.append(self._off(number, unknowns, path, sensed_m))
        return left

    def section_chi(self, unknowns: Unknowns, paths: list[Path]) -> FloatArray:
        """What each section leaves, root mean square in white noises of a row, shape (n,)."""
        left = self._left(unknowns, paths)
        weighed = [section.rows @ one**2 / one.size for section, one in zip(self.sections.sections, left, strict=True)]
        return np.asarray(np.sqrt(weighed) / self.noise.white_m)

    def residual_rms(self, unknowns: Unknowns, paths: list[Path], white_m: float) -> float:
        """Root mean square of measured minus modelled position, the fields and rests as found, m.

        ``white_m`` is the noise of a row, of which the means of many rows keep little.
        """
        left = self._left(unknowns, paths)
        rows = np.concatenate([section.rows for section in self.sections.sections])
        squares = rows @ np.concatenate(left) ** 2 + white_m**2 * (rows - 1.0).sum()
        return float(np.sqrt(squares / rows.sum()))

    def breakaway_residuals(self, unknowns: Unknowns, paths: list[Path]) -> FloatArray:
        """Residuals of the breakaways' forces, N, shape (n,)."""
        return np.array([self._breakaway(number, unknowns, path)[0] for number, path in enumerate(paths)])


def _at_instant(section: Section, began_s: float, at_nodes: FloatArray) -> FloatArray:
    """Values at an instant by straight lines between the nodes, shape (c,); before the first one the line goes on."""
    time_s = section.time_s
    after = min(max(int(time_s.searchsorted(began_s, side="right")), 1), time_s.size - 1)
    share = (began_s - time_s[after - 1]) / (time_s[after] - time_s[after - 1])
    return np.asarray(at_nodes[after - 1] + share * (at_nodes[after] - at_nodes[after - 1]))


def _later_s(section: Section, speed_m_per_s: FloatArray, stop: int, limit_m_per_s: float) -> float:
    """How far a stem goes on at its stop for each m/s that it is faster there: DV over its slowing down, s."""
    if not 2 <= stop < section.time_s.size:
        return 0.0
    lost = section.direction * float(speed_m_per_s[stop - 2] - speed_m_per_s[stop - 1])
    step_s = float(section.time_s[stop - 1] - section.time_s[stop - 2])
    return min(limit_m_per_s * step_s / lost, _LONGEST_LATER_S) if lost > 0.0 else 0.0
