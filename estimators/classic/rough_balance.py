"""k, F_c, F_v and F_0 of a valve whose friction varies, by balances of forces over windows of motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import LARGEST_RELATIVE_HALF_WIDTH
from estimators.classic.breakaway_law import BreakawayLaw, breakaway_law, late_s, law_of_jumps
from estimators.classic.bristles import leaving_of_bristles
from estimators.classic.force_windows import COAST, SLIDE, SLIP, ForceWindows, Leaving, RoughMotion, rough_motion
from estimators.classic.window_fit import (
    Known,
    Lag,
    Scatter,
    Strokes,
    WindowFit,
    fit_windows,
    jackknife,
    wandering_mean,
)
from estimators.engine.yielding import Held
from estimators.motion.channels import channels_apart_s
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray, Samples
from valve.nameplate import Action

# Own choices, from rough valves (benchmark classic_rough).
_TRAVEL_PARTS: Final = 8  # of the travel swept, for what the roughness along it does to k
_FEWEST_SLIDES: Final = 6  # windows in each direction
_SEVERAL_RATES: Final = 1.5  # between the fastest ramps and the 10 % quantile of the ramps' speeds
_SPRING_OFF: Final = 0.25  # a first spring rate that was further off is not good enough to find rests by
_LONGEST_LAG_S: Final = 0.04  # of a gauge's filter; an I/P that hunts does so more slowly
_LAG_OF_BEND: Final = 0.8  # a filter's time constant by the lag at which second differences stop to grow
_CAPTURE_S: Final = 2.0e-3  # a row; slower ones are polled
_ROW_OPEN: Final = 0.3  # of a row: the standard deviation of an instant in it
_WHITE: Final = 0.8
_SATURATED: Final = 1.7  # over twice the lag: noise that hangs together stops to grow, a bend grows four times
_OPEN_S: Final = 1.0e-3  # of the instant of a breakaway, beside what its row leaves open
_SETTLED_AFTER: Final = 4.0  # times F_v / k
_PLACES: Final = 25  # of the travel: as long as the roughness hangs together
_MODEL_SHARE: Final = 0.06  # of F_v: windows that begin or end in a transient
_HIDDEN: Final = 6.0  # of what noise hides: a halt between two jumps is not told apart before that
_LEAST_ERROR: Final = 2.0e-4  # of the friction: what windows leave of transients
_JUMP: Final = 0.2  # of the friction
_FLOOR: Final = 1.0e-3  # of the friction: what inertia may do to a window
_ROUNDS: Final = 3  # of the instruments, which need F_v / k
_READ: Final = "rough"
_SOLVED: Final = "rough balances"


@dataclass(frozen=True, slots=True)
class RoughBalance:
    """What the windows say; ``friction`` is F_c + F_v ``speed``; ``roughness_n`` is its scatter from window to window.

    ``viscous`` is None where nothing shows F_v; ``is_assumed`` says that F_c rests on what F_v or an overshoot may be.
    """

    spring: Known
    coulomb: Known
    viscous: Known | None
    preload: Known
    friction: Known
    speed: float
    slowest: float  # of the ramps, m/s
    law: BreakawayLaw | None
    roughness_n: float
    slides: int
    jumps_only: bool
    is_assumed: bool


def read_rough(motion: RecordedMotion) -> RoughMotion | None:
    """Return the motion in windows, with a spring rate that suits them; kept for the other method."""
    if _READ not in motion.shared:
        motion.shared[_READ] = _read(motion)
    found = motion.shared[_READ]
    return found if isinstance(found, RoughMotion) else None


def _read(motion: RecordedMotion) -> RoughMotion | None:
    found = rough_motion(motion.samples, motion.action, motion.stops)
    if found is None or motion.action is Action.DOUBLE:
        return found
    spring = _first_spring(found)
    if spring is None or abs(found.spring_n_per_m / spring - 1.0) < _SPRING_OFF:
        return found
    again = rough_motion(motion.samples, motion.action, motion.stops, spring)
    return found if again is None else again


def _first_spring(rough: RoughMotion) -> float | None:
    """Spring rate of steady motion, or of the breakaways where there is none, N/m."""
    windows, leaving = rough.windows, rough.leaving
    tables = []
    if _enough(windows):
        slide = windows.is_slide
        tables.append((windows.position_m[slide], windows.sense[slide], windows.force_n[slide]))
    if leaving.count >= 4 and np.unique(leaving.sense).size == 2:
        tables.append((leaving.position_m, leaving.sense, leaving.force_n))
    for position_m, sense, force_n in tables:
        ones = np.ones(sense.size)
        fit = fit_windows(np.column_stack([position_m, ones, sense]), force_n, ones)
        if fit is not None and fit.coefficients[0] > 0.0:
            return float(fit.coefficients[0])
    return None


def _enough(windows: ForceWindows) -> bool:
    slide = windows.is_slide
    return all(int(np.count_nonzero(slide & (windows.sense == sense))) >= _FEWEST_SLIDES for sense in (1.0, -1.0))


def rough_balance(motion: RecordedMotion, *, jointly: bool) -> RoughBalance | None:
    """Return the balance, ``jointly`` in one regression of all windows or step by step; None without motion both ways.

    Step by step: k, F_0 and the friction at the ramp's speed from steady motion up against down, then F_v from what
    the slips and the ends of the ramps take longer than the force, then F_c. Where the two ways differ by more than
    either admits, the difference counts as an error of both.
    """
    if _SOLVED not in motion.shared:
        motion.shared[_SOLVED] = _solved_both_ways(motion)
    solved = motion.shared[_SOLVED]
    assert isinstance(solved, _BothWays)
    own, other = (solved.jointly, solved.by_steps) if jointly else (solved.by_steps, solved.jointly)
    if own is None or other is None:
        return own or other
    if (
        own.spring.half_width > LARGEST_RELATIVE_HALF_WIDTH * own.spring.value
        and other.spring.half_width < own.spring.half_width
    ):
        own, other = other, own  # the steps alone do not tell k
    law = own.law
    if law is not None and other.law is not None:
        law = replace(law, static=_agreeing(law.static, other.law.static))
    return replace(
        own,
        spring=_agreeing(own.spring, other.spring),
        coulomb=_agreeing(own.coulomb, other.coulomb),
        preload=_agreeing(own.preload, other.preload),
        law=law,
    )


@dataclass(frozen=True, slots=True)
class _BothWays:
    """The balance of one recording in one regression, and step by step."""

    jointly: RoughBalance | None
    by_steps: RoughBalance | None


def _solved_both_ways(motion: RecordedMotion) -> _BothWays:
    rough = read_rough(motion)
    if rough is None or len(rough.directions) < 2:
        return _BothWays(None, None)
    if not _enough(rough.windows):
        found = _by_jumps(motion, rough)
        return _BothWays(found, found)
    slides = _Slides(motion, rough)
    return _BothWays(slides.balance(jointly=True), slides.balance(jointly=False))


def _agreeing(own: Known, other: Known) -> Known:
    apart = abs(own.value - other.value)
    return own if apart <= max(own.half_width, other.half_width) else own.with_more(apart)


class _Slides:
    """The windows as equations: F = k x + F_0 + s (A + F_v (ramp - reference)) + s F_v (speed - ramp)."""

    def __init__(self, motion: RecordedMotion, rough: RoughMotion) -> None:
        windows = rough.windows
        self.motion, self.rough, self.windows = motion, rough, windows
        self.samples: Samples = motion.samples
        self.sprung = motion.action is not Action.DOUBLE
        self.slide = windows.is_slide
        self.spring = (_first_spring(rough) or rough.spring_n_per_m) if self.sprung else 0.0
        self.ramp = windows.rate / self.spring if self.sprung else self._usual_speed()
        # by time, as F_c is the mean over the time recorded
        self.by_time = windows.length_s / float(windows.length_s[self.slide].mean())
        self.reference = self._quantile(0.5, self.slide)
        self.slowest = self._quantile(0.1, self.slide)
        # by direction: a drive that goes faster one way has one speed each way
        ways = [self.slide & (windows.sense == sense) for sense in (1.0, -1.0)]
        spans = [np.sort(self.ramp[way])[-_FEWEST_SLIDES] / max(self._quantile(0.1, way), 1.0e-12) for way in ways]
        self.several = bool(min(spans) > _SEVERAL_RATES)
        self.lag = _lag(motion)
        self.force_n = windows.force_n + self.lag.late_s * windows.rate * windows.sense
        self.settled = self.slide
        # without several rates a window's own speed counts against that of all ramps
        self.excess = windows.speed - (self.ramp if self.several else self.reference)

    def _quantile(self, share: float, rows: BoolArray) -> float:
        """Speed of the ramp, m/s, below which these windows (n,) spend this share of their time."""
        order = np.argsort(self.ramp[rows])
        total = np.cumsum(self.by_time[rows][order])
        return float(np.interp(share, total / total[-1], self.ramp[rows][order]))

    def _usual_speed(self) -> FloatArray:
        """Usual speed of each window's stroke, m/s, shape (n,): what a drive was asked for."""
        windows = self.windows
        usual = np.zeros(int(windows.stroke.max()) + 1)
        for stroke in np.unique(windows.stroke):
            usual[stroke] = np.median(windows.speed[windows.stroke == stroke])
        return np.asarray(usual[windows.stroke])

    def balance(self, *, jointly: bool) -> RoughBalance | None:
        """Return all but what the breakaways say of m."""
        steady, through = self._steady()
        first = self._fit(steady, through, self.slide, self.by_time)
        if first is None:
            return None
        place = int(self.sprung)
        roughness = float(np.sqrt(np.mean(first.residual_n[first.kept] ** 2)))
        fit, chosen, viscous = first, self.slide, None
        names = ["k"] * place + ["F_0", "A"] + (["steady"] if self.several else [])
        if self.sprung:
            found = self._with_speed(first, steady, through, roughness, slides_only=self.several and not jointly)
            if found is not None and (jointly or self.several):
                fit, chosen = found
                names = [*names, "F_v"]
            elif found is not None:
                self.settled = self._settled(float(found[0].coefficients[-1]))
                again = self._fit(steady, through, self.settled, self.by_time)
                fit, chosen = (first, self.slide) if again is None else (again, self.settled)
                viscous = self._by_settling(fit, steady, roughness)
        steadily = self.slide[chosen] & fit.kept
        roughness = float(np.sqrt(np.mean(fit.residual_n[steadily] ** 2)))
        scatter = self._scatter(fit, chosen)
        if "F_v" in names and not self.several:
            scatter = self._with_places(scatter, fit, chosen, roughness)
        unit = {name: np.eye(len(names))[number] for number, name in enumerate(names)}
        value = dict(zip(names, fit.coefficients.tolist(), strict=True))
        known = {name: scatter.of(unit[name], value[name]) for name in names}
        friction = known["A"]
        if self.several:
            viscous = known["steady"]
            weights = unit["A"] - self.reference * unit["steady"]
        elif "F_v" in names:
            viscous = known["F_v"]
            weights = unit["A"] - self.reference * unit["F_v"]
        else:
            weights = unit["A"]
        across = scatter.of(weights, float(weights @ fit.coefficients))
        if viscous is not None and self.sprung:
            more = math.hypot(
                self.spring * max(self.lag.error_s, _ROW_OPEN * self.samples.period_s),
                _MODEL_SHARE * abs(viscous.value),
                0.0 if self.several else self._hidden_viscous(viscous.value),
            )
            viscous = viscous.with_more(more)
            if not self.several:  # F_c is what F_v leaves of the friction
                across = across.with_more(more * self.reference)
        coulomb, viscous, is_assumed = self._coulomb(across, friction, viscous, has_speed="F_v" in names)
        coulomb = self._wandering(coulomb, fit, chosen).with_more(_LEAST_ERROR * friction.value)
        spring = known["k"] if self.sprung else Known(0.0, 0.0)
        law = breakaway_law(
            self._leaving(spring.value, known["F_0"].value, coulomb.value, viscous),
            spring=spring.value,
            preload=known["F_0"],
            lag=self.lag,
            period_s=self.samples.period_s,
            local_share=roughness / max(coulomb.value, 1.0e-12 * abs(friction.value), 1.0e-300),
        )
        coulomb = self._without_hidden_jumps(coulomb, viscous, law)
        return RoughBalance(
            spring=spring,
            coulomb=coulomb,
            viscous=viscous,
            preload=known["F_0"],
            friction=friction,
            speed=self.reference,
            slowest=self.slowest,
            law=law,
            roughness_n=roughness,
            slides=int(self.slide.sum()),
            jumps_only=False,
            is_assumed=is_assumed,
        )

    def _leaving(self, spring: float, preload_n: float, coulomb_n: float, viscous: Known | None) -> Leaving:
        """Where the stem broke away: on bristles it leaves its rest long before."""
        if not self.sprung or spring <= 0.0 or coulomb_n <= 0.0:
            return self.rough.leaving
        late_s = self.lag.late_s + (0.0 if viscous is None else max(0.0, viscous.value) / spring)
        soft = leaving_of_bristles(self.samples, Held(spring, preload_n, coulomb_n, late_s))
        return self.rough.leaving if soft is None else soft

    def _steady(self) -> tuple[FloatArray, FloatArray]:
        """Regressors of steady motion and their instruments: the force for the position, which friction moves."""
        windows = self.windows
        columns = [np.ones(windows.count), windows.sense]
        if self.several:
            columns.append(windows.sense * (self.ramp - self.reference))
        steady = np.column_stack([windows.position_m, *columns] if self.sprung else columns)
        through = steady
        if self.sprung:
            through = np.column_stack([self.force_n / self.spring, *columns])
        return steady, through

    def _fit(self, matrix: FloatArray, through: FloatArray, chosen: BoolArray, weight: FloatArray) -> WindowFit | None:
        return fit_windows(matrix[chosen], self.force_n[chosen], weight[chosen], through[chosen])

    def _with_speed(
        self, first: WindowFit, steady: FloatArray, through: FloatArray, roughness: float, *, slides_only: bool
    ) -> tuple[WindowFit, BoolArray] | None:
        """The fit with F_v free, by instruments: where friction is higher a stem is slower, so its speed is none."""
        windows = self.windows
        chosen = self.slide if slides_only else np.ones(windows.count, dtype=np.bool_)
        matrix = np.column_stack([steady, windows.sense * self.excess])
        weight = self.by_time * self._weights(float(first.coefficients[int(self.sprung) + 1]), roughness)
        viscous, found = self._first_viscous(first, steady), None
        for _ in range(_ROUNDS):
            expected = self._expected_excess(viscous / self.spring)
            fit = self._fit(matrix, np.column_stack([through, windows.sense * expected]), chosen, weight)
            if fit is None:
                break
            found = fit
            most = float(fit.coefficients[int(self.sprung) + 1]) / self.reference
            viscous = min(max(float(fit.coefficients[-1]), 0.01 * most), most)
        return None if found is None else (found, chosen)

    def _first_viscous(self, first: WindowFit, steady: FloatArray) -> float:
        """F_v of slips and coasts as far as steady motion leaves it, N s/m."""
        windows = self.windows
        other = ~self.slide
        friction = abs(float(first.coefficients[int(self.sprung) + 1]))
        most = friction / self.reference
        left = (self.force_n - steady @ first.coefficients)[other] * windows.sense[other]
        excess, length_s = self.excess[other], windows.length_s[other]
        square = float(np.sum(length_s * excess**2))
        value = float(np.sum(length_s * excess * left)) / square if square > 0.0 else 0.1 * most
        return min(max(value, 0.01 * most), most)

    def _expected_excess(self, lag_s: float) -> FloatArray:
        """What the speed is expected to exceed the ramp's by, shape (n,): means of its kind, falling with age."""
        windows = self.windows
        shape = np.exp(-windows.age_s / max(lag_s, 1.0e-6))
        expected = np.zeros(windows.count)
        for kind in (SLIDE, SLIP, COAST):
            rows = windows.kind == kind
            if not rows.any():
                continue
            basis = np.ones(int(rows.sum()))
            if kind == SLIDE:
                basis = shape[rows] * (np.abs(self.ramp[rows]) if self.several else 1.0)
            elif self.several:
                basis = np.abs(self.ramp[rows])
            square = float(basis @ basis)
            expected[rows] = basis * (float(basis @ self.excess[rows]) / square if square > 0.0 else 0.0)
        return expected

    def _settled(self, viscous: float) -> BoolArray:
        """Windows that no transient reaches, or all of steady motion where too few are left."""
        settled = self.slide & (self.windows.age_s > _SETTLED_AFTER * max(0.0, viscous) / self.spring)
        left = [int(np.count_nonzero(settled & (self.windows.sense == sense))) for sense in (1.0, -1.0)]
        return settled if min(left) >= _FEWEST_SLIDES else self.slide

    def _by_settling(self, fit: WindowFit, steady: FloatArray, roughness: float) -> Known | None:
        """F_v by transients: their impulse beyond steady motion by their way beyond it (an integral balance).

        By slips and ends of ramps alone, or with the beginnings of slides too, whichever tells it better.
        """
        found = [self._balanced(fit, steady, roughness, rows) for rows in (~self.slide, ~self.settled)]
        return min((one for one in found if one is not None), key=lambda one: one.error, default=None)

    def _balanced(self, fit: WindowFit, steady: FloatArray, roughness: float, other: BoolArray) -> Known | None:
        windows = self.windows
        count = int(other.sum())
        if count < 2:
            return None
        left = ((self.force_n - steady @ fit.coefficients) * windows.sense)[other]
        excess = self.excess[other]
        place = int(self.sprung) + 1
        viscous = self._first_viscous(fit, steady)
        expected = self._expected_excess(viscous / self.spring)[other]
        weight = (self.by_time * self._weights(float(fit.coefficients[place]), roughness))[other]
        moment = float(np.sum(weight * expected * excess))
        if moment <= 0.0:
            return None
        value = float(np.sum(weight * expected * left)) / moment
        scores = weight * expected * (left - value * excess)
        by_stroke = np.bincount(windows.stroke[other], scores)
        number = int(np.unique(windows.stroke[other]).size)
        if number < 2:
            return None
        error = math.sqrt(float(by_stroke @ by_stroke) * number / (number - 1)) / moment
        influence = weight * expected / moment
        late_n = self._late_n(float(fit.coefficients[place]))[other]
        together = float(np.sum(influence * late_n * (windows.kind[other] == SLIP)))
        local = roughness * self._over_places(influence, other)
        return Known(value, error, float(number - 1)).with_more(math.hypot(local, together))

    def _jump_n(self) -> float:
        """How far slips go beyond their ramp, as a force, N; 0 for a stem that starts without a slip jump."""
        windows, slip = self.windows, self.windows.kind == SLIP
        beyond = ((windows.speed - self.ramp) * windows.length_s)[slip]
        return self.spring * max(0.0, float(np.median(beyond))) if beyond.size else 0.0

    def _hidden_viscous(self, seen: float) -> float:
        """By how much F_v, N s/m, may exceed what is ``seen`` of it in transients whose beginning noise hides.

        In a share u of its time constant F_v / k a stem with a slip jump J goes J u + v F_v u^2 / (2 k), which may be
        as much as noise hides, h. What is seen is then F_v (1 - u): a quadratic equation, with one root below 1.
        """
        hidden_n, jump_n = self.rough.hidden_m * self.spring, self._jump_n()
        if hidden_n <= 0.0:
            return 0.0
        seen_n = max(seen * self.reference, 1.0e-3 * hidden_n)
        square, linear = 0.5 * seen_n - jump_n, jump_n + hidden_n
        share = 2.0 * hidden_n / (linear + math.sqrt(linear**2 + 4.0 * square * hidden_n))
        return seen_n / self.reference * share / max(1.0 - share, 1.0e-3)

    def _with_places(self, scatter: Scatter, fit: WindowFit, chosen: BoolArray, roughness: float) -> Scatter:
        """The scatter with what F_v has of the places at which stems slip and turn: the same in every stroke."""
        kept = fit.kept
        normal = (fit.through[kept] * fit.weight[kept, None]).T @ fit.matrix[kept]
        influence = fit.weight * (fit.through @ np.linalg.pinv(normal)[-1]) * kept
        late_n = self._late_n(float(fit.coefficients[int(self.sprung) + 1]))[chosen]
        together = float(np.sum(influence * late_n * (self.windows.kind[chosen] == SLIP)))
        covariance = scatter.covariance.copy()
        covariance[-1, -1] += (roughness * self._over_places(influence, chosen)) ** 2 + together**2
        return Scatter(covariance, scatter.freedom)

    def _over_places(self, influence: FloatArray, chosen: BoolArray) -> float:
        """Root of the sum of squares of influences (n,) added up place by place: kind, sense and part of the travel."""
        windows, (low, high) = self.windows, self.rough.swept_m
        part = np.clip((windows.position_m[chosen] - low) / max(high - low, 1.0e-12) * _PLACES, 0, _PLACES - 1)
        place = part.astype(np.int64) + _PLACES * (windows.sense[chosen] > 0.0)
        return float(np.sqrt(np.sum(np.bincount(place, influence) ** 2)))

    def _late_n(self, friction_n: float) -> FloatArray:
        """What the instants of breakaway and stop, as far as they are open, do to the windows that they bound, N."""
        open_s = _ROW_OPEN * self.samples.period_s + _OPEN_S
        # a breakaway's force is about that much above the friction in motion
        return np.where(self.windows.is_slide, 0.0, open_s / self.windows.length_s * _JUMP * abs(friction_n))

    def _weights(self, friction_n: float, roughness: float) -> FloatArray:
        """Inverse variances of the windows: roughness, and what the instant of a breakaway is open by."""
        windows = self.windows
        late_n = self._late_n(friction_n)
        turned_n = self.lag.error_s * self.spring * np.where(windows.kind == COAST, self.ramp - self.reference, 0.0)
        return np.asarray(1.0 / (roughness**2 + late_n**2 + turned_n**2 + (_FLOOR * friction_n) ** 2))

    def _scatter(self, fit: WindowFit, chosen: BoolArray) -> Scatter:
        """What the coefficients scatter by: between strokes, and, for k, between parts of the travel."""
        return _scatter_of(
            fit,
            stroke=self.windows.stroke[chosen],
            sense=self.windows.sense[chosen],
            position_m=self.windows.position_m[chosen],
            swept_m=self.rough.swept_m,
            sprung=self.sprung,
        )

    def _coulomb(
        self, known: Known, friction: Known, viscous: Known | None, *, has_speed: bool
    ) -> tuple[Known, Known | None, bool]:
        """F_c, F_v and whether F_c rests on what F_v may be at most."""
        if self.several:
            return known, viscous, False
        if not self.sprung:
            return friction, None, True  # at one speed: the friction at that speed
        most = friction.value / self.reference
        if viscous is not None and viscous.error < most / math.sqrt(12.0) and 0.0 <= viscous.value <= most:
            if not has_speed:
                known = Known(friction.value - viscous.value * self.reference, friction.error, friction.freedom)
                known = replace(
                    known.with_more(viscous.error * self.reference), freedom=min(friction.freedom, viscous.freedom)
                )
        else:
            # F_v is not negative and leaves F_c above 0, and what is seen of it counts as far as it goes
            believed = Known(0.5 * most, most / math.sqrt(12.0)) if viscous is None else _within(viscous, most)
            viscous = believed
            known = Known(friction.value - believed.value * self.reference, friction.error, friction.freedom)
            known = known.with_more(believed.error * self.reference)
        return known, viscous, False

    def _without_hidden_jumps(self, coulomb: Known, viscous: Known | None, law: BreakawayLaw | None) -> Known:
        """F_c of a stem whose jumps would hide in the noise: it seems to slide under the mean of F_s and F_c."""
        if law is None or not self.sprung:
            return coulomb
        moving = coulomb.value + max(0.0, 0.0 if viscous is None else viscous.value) * self.slowest
        jump_n = law.static.value - moving
        if not 0.0 < 2.0 * jump_n < _HIDDEN * self.rough.hidden_m * self.spring:
            return coulomb
        lower = Known(coulomb.value - 0.5 * jump_n, coulomb.error, coulomb.freedom)
        return lower.with_more(jump_n / math.sqrt(12.0))

    def _wandering(self, coulomb: Known, fit: WindowFit, chosen: BoolArray) -> Known:
        """F_c as the mean over the record of a friction that wanders, with what that leaves open."""
        windows = self.windows
        slide = self.slide[chosen] & fit.kept
        stroke, sense = windows.stroke[chosen][slide], windows.sense[chosen][slide]
        weight = windows.length_s[chosen][slide]
        total = np.bincount(stroke, weight)
        met = total > 0.0

        def mean(values: FloatArray) -> FloatArray:
            return np.asarray(np.bincount(stroke, weight * values)[met] / total[met])

        columns = [np.ones(int(met.sum())), mean(sense)]
        target = [1.0, 0.0]
        if self.several:
            columns.append(mean(self.ramp[chosen][slide] - self.reference))
            target.append(-self.reference)
        strokes = Strokes(
            time_s=mean(windows.time_s[chosen][slide]) - float(self.samples.time_s[0]),
            friction_n=mean(sense * fit.residual_n[slide]),
            regressors=np.column_stack(columns),
            weight=np.asarray(total[met], dtype=np.float64),
            duration_s=float(self.samples.time_s[-1] - self.samples.time_s[0]),
        )
        more = wandering_mean(strokes, np.array(target))
        if more is None:
            return coulomb
        moved = Known(coulomb.value + more.value, coulomb.error, coulomb.freedom)
        if more.half_width <= coulomb.half_width:
            return moved
        return Known(moved.value, more.error, more.freedom)


def _within(seen: Known, most: float) -> Known:
    """A value between 0 and ``most``, all of it as likely, with what was seen of it."""
    grid = (np.arange(400) + 0.5) / 400 * most
    error = max(seen.error, 1.0e-3 * most)
    away = (grid - seen.value) / error
    away -= away[np.argmin(np.abs(away))]
    shares = np.exp(-0.5 * away**2)
    shares /= shares.sum()
    mean = float(shares @ grid)
    return Known(mean, math.sqrt(float(shares @ (grid - mean) ** 2)))


def _scatter_of(
    fit: WindowFit,
    *,
    stroke: FloatArray | np.ndarray,
    sense: FloatArray,
    position_m: FloatArray,
    swept_m: tuple[float, float],
    sprung: bool,
) -> Scatter:
    """Return what the coefficients, k first where there is a spring and then F_0, scatter by.

    Between strokes of a direction; the roughness along the travel is in every stroke and part of the friction's mean,
    so that it is an error of k alone, about the middle of the travel.
    """
    ways = sense.astype(np.int64)
    between = jackknife(fit, np.asarray(stroke, dtype=np.int64), ways)
    low, high = swept_m
    part = (position_m - low) / max(high - low, 1.0e-12) * _TRAVEL_PARTS
    along = jackknife(fit, np.clip(part, 0, _TRAVEL_PARTS - 1).astype(np.int64), ways)
    width = fit.coefficients.size
    if between is None:
        if along is not None:
            return along
        plain = np.linalg.pinv((fit.through * fit.weight[:, None]).T @ fit.matrix)
        square = float(np.mean(fit.residual_n[fit.kept] ** 2 * fit.weight[fit.kept]))
        return Scatter(np.abs(plain) * square * float(_TRAVEL_PARTS), 2.0)
    if along is None or not sprung:
        return between
    tilted = np.zeros(width)
    tilted[0], tilted[1] = 1.0, -0.5 * (low + high)
    return Scatter(between.covariance + np.outer(tilted, tilted) * float(along.covariance[0, 0]), between.freedom)


def _lag(motion: RecordedMotion) -> Lag:
    """What the force is late by: a gauge's filter at most as long as its noise hangs together, and the clocks."""
    samples, recording = motion.samples, motion.recording
    filter_s = _noise_time_s(samples)
    # a file that does not say how its rows were taken, or a poll: the row's time is that of either channel
    clock_s = max(channels_apart_s(recording), _ROW_OPEN * samples.period_s if samples.period_s > _CAPTURE_S else 0.0)
    return Lag(0.5 * filter_s, math.hypot(filter_s / math.sqrt(12.0), clock_s))


def _noise_time_s(samples: Samples) -> float:
    """How long the force's noise hangs together, s; 0 where it is white, or none."""
    longest = round(_LONGEST_LAG_S / samples.period_s)
    if longest < 2 or samples.count < 8 * longest:
        return 0.0
    plateau = _bend_n(samples, longest)
    if plateau <= 0.0 or _bend_n(samples, 1) >= _WHITE * plateau:
        return 0.0
    if plateau > _SATURATED * _bend_n(samples, longest // 2):
        return 0.0  # it is the force itself that bends
    lag = 1
    while lag < longest and _bend_n(samples, lag) < _WHITE * plateau:
        lag = max(lag + 1, round(1.3 * lag))
    return _LAG_OF_BEND * min(lag, longest) * samples.period_s


def _bend_n(samples: Samples, lag: int) -> float:
    """Usual second difference of the force over this many rows: of ramps nothing but noise is left."""
    force_n = samples.force_n
    bend = force_n[2 * lag :] - 2.0 * force_n[lag:-lag] + force_n[: -2 * lag]
    return float(np.median(np.abs(bend[:: 1 + bend.size // 20_000])))


def _by_jumps(motion: RecordedMotion, rough: RoughMotion) -> RoughBalance | None:
    """A stem that only sticks and slips: k, F_0, F_s and F_c from where its jumps begin and end."""
    sprung = motion.action is not Action.DOUBLE
    lag = _lag(motion)
    found = law_of_jumps(rough, sprung=sprung)
    if found is None:
        return None
    fit = found.fit
    scatter = _scatter_of(
        fit,
        stroke=found.stroke,
        sense=found.sense,
        position_m=found.position_m,
        swept_m=rough.swept_m,
        sprung=sprung,
    )
    unit, late_n = np.eye(fit.coefficients.size), np.abs(found.late_n(late_s(lag, motion.samples.period_s)))
    known = [
        scatter.of(unit[place], float(value)).with_more(float(late_n[place]))
        for place, value in enumerate(fit.coefficients)
    ]
    place = int(sprung)
    spring = known[0] if sprung else Known(0.0, 0.0)
    law = breakaway_law(
        rough.leaving,
        spring=spring.value,
        preload=known[place],
        lag=lag,
        period_s=motion.samples.period_s,
        local_share=0.0,
    )
    if law is None:
        return None
    ended = known[place + 2] if found.has_ends else None
    coulomb = law.coulomb_of_jumps(ended)
    return RoughBalance(
        spring=spring,
        coulomb=coulomb,
        viscous=None,
        preload=known[place],
        friction=coulomb,
        speed=0.0,
        slowest=0.0,
        law=law,
        roughness_n=0.0,
        slides=0,
        jumps_only=True,
        is_assumed=True,
    )
