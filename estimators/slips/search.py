"""The slips' joint fit from a recording alone: where it starts, which slips it leaves out, and what it may not do."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray
from estimators.slips.kernel import COMMON, D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.settling import viscous_from_settling
from estimators.slips.solution import SlipFit, SlipSolution
from estimators.slips.windows import SlipWindows, slip_windows
from valve.nameplate import Action

# Own choices, tried on random valves at 0.3 to 100 um and 1 to 50 ms.
_USUAL_LIMIT: Final = 0.015  # DV as a share of the speed of the slowest ramp
_BAD_SLIP: Final = 2.0  # misfit of one slip beside the usual one of all
_MOST_LEFT_OUT: Final = 0.34
_FIRST_ROUNDS: Final = 4
_FEWEST_SLIPS: Final = 2
_FEWEST_OF_BREAKAWAYS: Final = 0.5
_SHOWN: Final = 9.0  # of the sum of squares in noise's variances: 3 standard deviations
_FIRST_SCATTER: Final = 0.01
_SCATTER_ROUNDS: Final = 3
_SLIDES: Final = 0.5  # of F_s - F_c: from this share of F_v v on the stem may slide at DV
_LARGE_LIMITS: Final = ((0.3, 1.0), (0.9, 1.0), (0.9, 2.5))  # DV by the slowest ramp's speed, F_v by what was found
_FAR_OFF: Final = 5.0  # misfit of a minimum that says no more of where to go on than the start
_SHOWN_ON_GRID: Final = 0.15  # of the sum of squares itself: on a sensor's grid its steps are not chance
_HEAVILY: Final = 2.0  # damping ratio
_SEVERAL_RATES: Final = 2.0
_CLEAR_JUMP: Final = 0.02  # F_s - F_c as a share of the friction in motion
_TOLD: Final = 0.5  # standard error of ln DV: several rates tell it from F_s
SHARED: Final = "slips"
ALL_AT_ONCE: Final = (M, F_V, K, A, F_0, F_S)  # method 1: one regression for all
AFTER_THE_BALANCE: Final = (M, F_V, F_S)  # method 2: k, A and F_0 are known from uniform motion
_USUAL_KG: Final = 3.0  # of the moving parts, where nothing is said
_BETTER: Final = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class SlipsFound:
    """The fit and its solution, when each slip left out began, whether F_s was held at F_c, and whether DV shows."""

    fit: SlipFit
    solution: SlipSolution
    left_out_s: tuple[float, ...]
    without_stiction: bool
    limit_shown: bool

    @property
    def left_out(self) -> int:
        """How many slips were left out."""
        return len(self.left_out_s)

    @property
    def windows(self) -> SlipWindows:
        """The slips that it is of."""
        return self.fit.windows


def solve_slips(motion: RecordedMotion, balance: Balance, free: tuple[int, ...]) -> SlipsFound | None:
    """Fit all slips at once with the ``free`` unknowns, the others as the balance has them; None where it cannot be.

    DV is fitted where the data show it beyond doubt; elsewhere it stays at its usual share of the ramp's speed. F_s is
    held at F_c where it would come out below it.
    """
    if motion.action is not Action.SPRING or balance.preload is None or not balance.is_physical:
        return None
    if motion.samples.position_noise_m <= 0.0:
        return None
    if SHARED not in motion.shared and free != ALL_AT_ONCE:
        solve_slips(motion, balance, ALL_AT_ONCE)  # so that no method depends on what was asked for before it
    before = motion.shared.get(SHARED)
    if isinstance(before, SlipsFound) and free != ALL_AT_ONCE:
        fit, solution = _continued(before, balance, free)
        all_s = {*before.left_out_s, *fit.windows.began_s.tolist()}
    else:
        windows = slip_windows(motion, balance.spring[0])
        if windows is None or windows.count < _FEWEST_SLIPS or balance.speed <= 0.0:
            return None
        if windows.count < _FEWEST_OF_BREAKAWAYS * len(motion.phases.breakaways):
            return None  # what breaks away mostly is no slip along a ramp
        start, further = _starts(motion, balance, windows)
        fit = SlipFit(windows, motion.samples.position_noise_m, balance.speed, free, start)
        all_s = set(windows.began_s.tolist())
        fit, solution = _searched(fit, start, further)
    shown = D_V in fit.free
    if not shown and not isinstance(before, SlipsFound):
        fit, solution, shown = _with_limit(fit, solution)
    held = F_S in free and _excess(solution) < 0.0
    if held:
        fit = replace(fit, slaved=True)
        solution = fit.solve(solution.common)
    if not math.isfinite(solution.cost) or not bool((np.diag(solution.covariance) >= 0.0).all()):
        return None
    found = SlipsFound(fit, solution, tuple(sorted(all_s - set(fit.windows.began_s.tolist()))), held, shown)
    if free == ALL_AT_ONCE:
        motion.shared[SHARED] = found
    return found


def _continued(before: SlipsFound, balance: Balance, free: tuple[int, ...]) -> tuple[SlipFit, SlipSolution]:
    """The fit with other unknowns free, from where one of the same slips ended; what stays is the balance's."""
    assert balance.preload is not None
    shown = (D_V,) if before.limit_shown else ()
    believed = before.fit.believed
    fit = replace(before.fit, free=(*free, *shown), slaved=False, believed=believed)
    start = before.solution.common.copy()
    for place, value in ((K, balance.spring[0]), (A, balance.friction[0]), (F_0, balance.preload[0])):
        if place not in free:
            start[place] = value
    return fit, fit.solve(start, rest_m=before.solution.rest_m)


def _searched(fit: SlipFit, start: FloatArray, further: list[tuple[float, float]]) -> tuple[SlipFit, SlipSolution]:
    """The best of several starts; the first one is enough where it fits as well as noise lets, or nearly.

    What does not fit then is tried with DV free, without its bad slips, and with an F_s that scatters, in this order.
    """
    best = fit.solve(start)
    if not best.converged or not fit.fits(best):
        near = best.converged and best.misfit < _FAR_OFF
        sliding_fit, sliding = _sliding(fit, best if near else None, start)
        if sliding.converged and sliding_fit.fits(sliding):
            return sliding_fit, sliding
        best = _best_start(fit, best, start, further)
    for cleaned in (False, True):
        if cleaned:
            fit, best = _without_bad_slips(fit, best)
        if fit.fits(best):
            return fit, best
        freed = replace(fit, free=(*fit.free, D_V))
        limited = freed.solve(best.common)
        if limited.converged and freed.fits(limited):
            return freed, limited
    fit, best = _with_scatter(fit, best)
    return fit, best


def _best_start(
    fit: SlipFit, best: SlipSolution, start: FloatArray, further: list[tuple[float, float]]
) -> SlipSolution:
    """The best of what was found and what further starts of m and F_v lead to."""
    tried = []
    for mass, viscous in further:
        begin = start.copy()
        begin[M], begin[F_V] = mass, viscous
        tried.append(fit.solve(begin, rounds=_FIRST_ROUNDS))
    tried.sort(key=_cost)
    for one in tried[:2]:
        solution = fit.solve(one.common)
        if not best.converged or solution.cost < best.cost:
            best = solution
    return best


def _sliding(fit: SlipFit, found: SlipSolution | None, start: FloatArray) -> tuple[SlipFit, SlipSolution]:
    """The fit with DV free, from large ones: an overdamped stem may slide at DV before it slips."""
    freed = replace(fit, free=(*fit.free, D_V))
    slowest = fit.windows.slowest_rate / float(start[K])
    tried = []
    for share, factor in _LARGE_LIMITS:
        begin = start.copy() if found is None else found.common.copy()
        begin[D_V], begin[F_V] = share * slowest, factor * begin[F_V]
        begin[M] = min(begin[M], begin[F_V] ** 2 / (4.0 * begin[K]))
        tried.append(freed.solve(begin, rounds=_FIRST_ROUNDS + 2))
    least = min(tried, key=_cost)
    return freed, freed.solve(least.common, rest_m=least.rest_m)


def _with_limit(fit: SlipFit, solution: SlipSolution) -> tuple[SlipFit, SlipSolution, bool]:
    """Let DV go where that betters the fit beyond doubt; where the stem may slide at DV, from large ones too."""
    freed = replace(fit, free=(*fit.free, D_V))
    common = solution.common
    best = freed.solve(common)
    slowest = fit.windows.slowest_rate / float(common[K])
    slides = float(common[F_V]) * slowest > _SLIDES * max(_excess(solution), 0.0)
    heavily_damped = float(common[F_V]) ** 2 > _HEAVILY**2 * 4.0 * float(common[M] * common[K])
    if (slides and heavily_damped) or not fit.fits(solution):
        best = min(best, _sliding(fit, solution, common)[1], key=_cost)
    beyond = _SHOWN * max(1.0, solution.misfit**2)
    if fit.windows.undithered:
        beyond = max(beyond, _SHOWN_ON_GRID * solution.cost)
    rates = np.abs(fit.windows.slips[:, 1])
    spread = math.sqrt(max(0.0, float(best.covariance[D_V, D_V]))) / float(best.common[D_V])
    slipping = _excess(best) > _CLEAR_JUMP * float(best.common[A])
    told = (
        slipping
        and float(rates.max()) > _SEVERAL_RATES * float(rates.min())
        and spread < _TOLD
        and not fit.windows.undithered
    )
    if best.converged and (told or solution.cost - best.cost > beyond):
        return freed, best, True
    return fit, solution, False


def _cost(solution: SlipSolution) -> float:
    return solution.cost if math.isfinite(solution.cost) else math.inf


def _with_scatter(fit: SlipFit, solution: SlipSolution) -> tuple[SlipFit, SlipSolution]:
    """Let F_s differ from slip to slip, by as much as it is found to, where that betters the fit."""
    spread_n = _FIRST_SCATTER * abs(float(solution.common[F_S]))
    scattered, found = fit, solution
    for _ in range(_SCATTER_ROUNDS):
        scattered = replace(fit, tie=1.0 / spread_n**2)
        found = scattered.solve(solution.common)
        if not found.converged or found.misfit > _BETTER * solution.misfit:
            return fit, solution
        spread_n = max(float(np.sqrt(np.mean(found.own_n**2))), 1.0e-3 * spread_n)
    return scattered, found


def _excess(solution: SlipSolution) -> float:
    """F_s - F_c, N."""
    common = solution.common
    return float(common[F_S] - common[A] + common[F_V] * solution.reference_speed)


def _starts(
    motion: RecordedMotion, balance: Balance, windows: SlipWindows
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """The likeliest start of all unknowns, and further ones of m and F_v."""
    assert balance.preload is not None
    spring, friction, preload = balance.spring[0], balance.friction[0], balance.preload[0]
    slowest = windows.slowest_rate / spring
    most = friction / balance.speed
    known = motion.moving_mass_kg

    def mass(viscous: float) -> float:
        return known if known is not None else min(0.7 * viscous**2 / (4.0 * spring), _USUAL_KG)

    # what can be seen: half a period of sampling, or the noise as a lag
    least = spring * max(0.5 * motion.samples.period_s, motion.samples.position_noise_m / balance.speed)
    settling = viscous_from_settling(motion.samples, motion.phases, balance)
    viscous = settling[0] if settling is not None and settling[0] > 0.0 else min(4.0 * least, 0.3 * most)
    start = np.zeros(COMMON)
    start[M], start[F_V], start[K], start[A], start[F_0] = mass(viscous), viscous, spring, friction, preload
    start[F_S] = float(np.median(windows.slips[:, 0] * (windows.began_n - spring * windows.rest_m - preload)))
    start[D_V] = _USUAL_LIMIT * slowest
    trials = np.geomspace(min(0.3 * least, 0.02 * most), 0.9 * most, 7).tolist()
    further = [(mass(trial), trial) for trial in trials]
    return start, [*further, (0.1 * mass(viscous), viscous), (4.0 * mass(viscous), viscous)]


def _without_bad_slips(fit: SlipFit, solution: SlipSolution) -> tuple[SlipFit, SlipSolution]:
    """Leave out slips that fit much worse than the usual one, and fit the others again."""
    all_slips = fit.windows.count
    for _ in range(4):
        sizes = np.maximum(np.diff(fit.windows.first), 1)
        misfit = np.sqrt(solution.costs / sizes)
        usual = float(np.quantile(misfit, 0.4))
        # a bad one draws the fit away from its neighbours: the worst go first
        bad = misfit > max(_BAD_SLIP * max(usual, 1.0), 0.5 * float(misfit.max()))
        kept = ~bad
        if not bad.any() or int(kept.sum()) < max(_FEWEST_SLIPS, (1.0 - _MOST_LEFT_OUT) * all_slips):
            break
        fit = replace(fit, windows=chosen_slips(fit.windows, kept))
        solution = fit.solve(solution.common)
    return fit, solution


def chosen_slips(windows: SlipWindows, kept: BoolArray) -> SlipWindows:
    """Return the windows with only these slips."""
    sizes = np.diff(windows.first)
    rows = np.repeat(kept, sizes)
    return replace(
        windows,
        slips=windows.slips[kept],
        first=np.concatenate([[0], np.cumsum(sizes[kept])]).astype(np.int64),
        time_s=windows.time_s[rows],
        position_m=windows.position_m[rows],
        rows=windows.rows[rows],
        rest_m=windows.rest_m[kept],
        rest_rows=windows.rest_rows[kept],
        began_s=windows.began_s[kept],
        began_n=windows.began_n[kept],
        within_n=windows.within_n[kept],
    )
