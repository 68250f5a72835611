"""The dynamic fit: Gauss and Newton's steps with damping, from hot noise to cold, from a few equivalent starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from estimators.engine.fields import no_fields
from estimators.engine.hyperparameters import Equations, field_likelihood, refined
from estimators.engine.laws import PathToFit
from estimators.engine.model import Linearised, Model, Paths, Unknowns
from estimators.engine.parameters import FC, FS, GLOBALS, HIGH, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, LONGEST, LOW
from estimators.engine.roughness import ROUGH, SMOOTH, RoughnessPrior
from estimators.linear_fit import inverse_of

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

HEATS: Final = (30.0, 5.0, 1.0)
_STEPS: Final = (6, 6, 10)
_TRIED_SECTIONS: Final = 10
_NEARLY: Final = 60.0  # of minus twice the logarithm of the likelihood, on some of the sections
LEAST_LAG_S: Final = 0.004  # of the stem, that a fit begins with where corners show none
_DAMPED_S: Final = 0.15  # the lag of a heavily damped stem
_MOST_KEPT: Final = 2
_TRIED_STEPS: Final = 5  # that show whether other times can be as likely
_NOT_UNDERSTOOD: Final = 4.0  # times what the better quarter of the sections leaves
_FEWEST_UNDERSTOOD: Final = 8
_ROUNDS_LEFT_OUT: Final = 2
_EXCHANGED_STEPS: Final = 25  # the same where each breakaway has another instant, too
_SAME: Final = 0.3  # of a logarithm: fits so near on some of the sections are one on all
_EQUAL: Final = 0.05
_MET: Final = 0.02  # the same for fits that go the same way from here on
_SETTLED: Final = 0.02  # of the logarithms of roughness and scatter
_USUAL_SCATTER: Final = 0.015  # of F_s: the median of what packings have
_SCATTER_SPREAD: Final = 1.5  # of its logarithm
_LAST_STEPS: Final = 12
ROUNDS: Final = 3  # of roughness, unknowns, colour of the noise and scatter, each given the others
_ROUND_STEPS: Final = 4
_HOT: Final = 10.0  # noise so many times as large: what is left says nothing of its colour
_DONE: Final = 0.05  # of a unit of the sum of squares
_NEARLY_DONE: Final = 0.5  # the same where a fit goes on
_LONGEST_INSTANT_S: Final = 0.004
_PROMISED: Final = 0.01  # of what a descent is done at: a step that promises no more is not tried
_PASSES: Final = 6  # of finding out which unknowns a step's limits hold
_LOOSE: Final = 1.0e3  # of F_s: a scatter that says nothing
_NEAR_LIMIT: Final = 0.6  # of the usual speed: a limit velocity that one start tries
_FILTER_SHARES: Final = (0.05, 0.5, 0.9)  # of the slowest filter that is quicker than the stem
_SLOW_FILTER_SHARES: Final = (0.9, 0.4)  # of the stem's delay where the filter is slower
_SLOW_ROWS_S: Final = 0.004
_MOST_DAMPING: Final = 1.0e8


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Where a fit ended: unknowns, their covariance, and minus twice the logarithm of the marginal likelihood.

    ``chi`` is the root mean square of the whitened residuals, 1 where the noise explains them.
    """

    unknowns: Unknowns
    paths: Paths
    model: Model
    covariance: FloatArray
    surprise: float
    chi: float


def _prior_terms(model: Model, unknowns: Unknowns, one: Linearised) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and right side with the priors."""
    normal, right = one.normal.copy(), one.right.copy()
    weight = model.prior.spread**-2.0
    index = np.arange(GLOBALS)
    normal[index, index] += weight
    right[:GLOBALS] += weight * (model.prior.mean - unknowns.parameters)
    fields = slice(GLOBALS, GLOBALS + unknowns.fields.size)
    if model.fields.count:
        normal[fields, fields] += model.fields.precision
        right[fields] -= model.fields.precision @ unknowns.fields
    below, slope = model.below_coulomb(unknowns)
    if slope > 0.0:
        both = np.array([FC, FS])
        signs = np.array([slope, -slope])
        normal[np.ix_(both, both)] += np.outer(signs, signs)
        right[both] -= signs * below
    if model.laws.count:
        laws = unknowns.first_law + np.arange(model.laws.count)
        weight = model.laws.spread**-2.0
        normal[laws, laws] += weight
        right[laws] += weight * (model.laws.mean - unknowns.laws)
    return normal, right


@dataclass(frozen=True, slots=True, eq=False)
class Quadratic:
    """The sum of squares about a point as its equations have it, in unknowns scaled to a diagonal of ones.

    ``scaled``: shape (n, n); ``right``: shape (n,), in the scaled unknowns; ``scale``: shape (n,), of one each.
    """

    scaled: FloatArray
    right: FloatArray
    scale: FloatArray

    def within(self, damping: float, box: tuple[FloatArray, FloatArray]) -> FloatArray | None:
        """Return the damped step within a box: what would leave it is held at its side, and the others answer to that.

        Cutting a step afterwards, without their answer, would leave m and F_v where a filter that may not be shorter
        put them. The answer takes the columns of the inverse that belong to what is held: no second factorisation.
        ``box``: least and largest step, shape (n,) each, in the unknowns' own units, as the step. None where the
        equations determine nothing.
        """
        damped = self.scaled.copy()
        damped[np.diag_indices_from(damped)] += damping + 1.0e-12
        try:
            factor = cho_factor(damped, lower=True, check_finite=False, overwrite_a=True)
            return self._held_within(factor, box)
        except LinAlgError:
            return None

    def _held_within(self, factor: tuple[FloatArray, bool], box: tuple[FloatArray, FloatArray]) -> FloatArray:
        free = cho_solve(factor, self.right, check_finite=False)
        low, high = (side / self.scale for side in box)
        step, held = free, np.zeros(free.size, np.bool_)
        for _ in range(_PASSES):
            beyond = (step < low) | (step > high)
            if not (beyond & ~held).any():
                return np.asarray(self.scale * step)
            held |= beyond
            at = np.flatnonzero(held)
            fixed = np.clip(step[at], low[at], high[at])
            columns = np.zeros((free.size, at.size), order="F")
            columns[at, np.arange(at.size)] = 1.0
            columns = cho_solve(factor, columns, check_finite=False, overwrite_b=True)
            step = free - columns @ np.linalg.solve(columns[at], free[at] - fixed)
            step[at] = fixed
        return np.asarray(self.scale * np.clip(step, low, high))

    def promised(self, step: FloatArray) -> float:
        """Return by how much a step, shape (n,), SI, lowers the sum of squares if the equations are right."""
        scaled = step / self.scale
        return float(2.0 * self.right @ scaled - scaled @ self.scaled @ scaled)


def quadratic(normal: FloatArray, right: FloatArray) -> Quadratic:
    """Return what normal equations say of the sum of squares.

    ``normal``: shape (n, n); ``right``: shape (n,); SI, whatever each unknown is in.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1.0e-300))
    return Quadratic(normal * scale * scale[:, np.newaxis], right * scale, scale)


def _is_finite(normal: FloatArray, right: FloatArray) -> bool:
    """Whether these are numbers: the slopes of a motion that runs away are none, which no factorisation refuses."""
    return bool(np.isfinite(normal).all() and np.isfinite(right).all())


def _box(unknowns: Unknowns, model: Model) -> tuple[FloatArray, FloatArray]:
    """The least and the largest step of each unknown that is allowed, in the order of the step."""
    nodes, laws = model.sections.nodes, model.laws
    first, last = nodes.time_s[nodes.first[:-1]] + 1.0e-6, nodes.time_s[nodes.first[1:] - 3]
    free, rests = np.full(unknowns.fields.size, math.inf), np.full(unknowns.rest_m.size, math.inf)
    low = (
        np.maximum(LOW - unknowns.parameters, -LONGEST),
        -free,
        np.maximum(first - unknowns.began_s, -_LONGEST_INSTANT_S),
        -rests,
        np.maximum(laws.low - unknowns.laws, -laws.longest_step),
    )
    high = (
        np.minimum(HIGH - unknowns.parameters, LONGEST),
        free,
        np.minimum(last - unknowns.began_s, _LONGEST_INSTANT_S),
        rests,
        np.minimum(laws.high - unknowns.laws, laws.longest_step),
    )
    return np.minimum(np.concatenate(low), 0.0), np.maximum(np.concatenate(high), 0.0)


def descend(
    model: Model,
    unknowns: Unknowns,
    paths: Paths,
    steps: int,
    done: float = _DONE,
    *,
    to: Unknowns | None = None,
) -> tuple[Unknowns, Paths, float]:
    """Return the unknowns, paths and sum of squares after at most so many accepted steps.

    It ends sooner where the dynamics are those of ``to``.
    """
    damping = 1.0e-3
    squares = model.squares(unknowns, paths)
    for _ in range(steps):
        normal, right = _prior_terms(model, unknowns, model.linearised(unknowns, paths))
        if not _is_finite(normal, right):
            break
        gained, box, about = 0.0, _box(unknowns, model), quadratic(normal, right)
        while damping < _MOST_DAMPING:
            step = about.within(damping, box)
            if step is not None:
                if about.promised(step) < _PROMISED * done:
                    break
                tried = unknowns.moved(step)
                tried_paths = model.followed_paths(tried, paths)
                new = model.squares(tried, tried_paths)
                if math.isfinite(new) and new < squares:
                    gained, squares, unknowns, paths = squares - new, new, tried, tried_paths
                    damping = max(damping * 0.1, 1.0e-9)
                    break
            damping *= 10.0
        if gained < done or (to is not None and _alike(unknowns, to, _EQUAL)):
            break
    return unknowns, paths, squares


def concluded(model: Model, unknowns: Unknowns, paths: Paths, squares: float) -> Found:
    """Return the fit with its covariance and marginal likelihood; an infinite surprise where nothing determines it."""
    one = model.linearised(unknowns, paths)
    normal, right = _prior_terms(model, unknowns, one)
    nowhere = Found(unknowns, paths, model, np.full_like(normal, math.nan), math.inf, math.inf)
    if not _is_finite(normal, right):
        return nowhere
    scale = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += 1.0e-12
    try:
        factor = cho_factor(scaled, lower=True, check_finite=False)
    except LinAlgError:
        return nowhere
    inverse = inverse_of(factor[0]) * np.outer(scale, scale)
    log_determinant = 2.0 * float(np.log(np.diag(factor[0])).sum()) - 2.0 * float(np.log(scale).sum())
    surprise = squares + log_determinant - model.fields.log_determinant + one.log_variances
    surprise += 2.0 * unknowns.began_s.size * math.log(model.scatter_n)
    surprise += 2.0 * float(np.log(model.laws.spread).sum())
    effective = max(1.0, one.rows - float(np.sum(inverse * one.normal)) + 0.0)
    return Found(unknowns, paths, model, np.asarray(inverse), surprise, math.sqrt(one.squares / effective))


def annealed(
    model: Model,
    unknowns: Unknowns,
    paths: Paths,
    heats: tuple[float, ...] = HEATS,
    *,
    prior: RoughnessPrior | None = None,
    rounds: int = ROUNDS,
) -> Found:
    """Return where the descent ends from one start, from hot noise to cold.

    With a ``prior`` the roughness is then found anew from the motion, in so many rounds.
    """
    heats = heats if model.settings.heated else HEATS[-1:]
    for heat, steps in zip(heats, _STEPS[-len(heats) :], strict=True):
        model, unknowns, paths = _cooled(model, unknowns, paths, heat, steps)
    return _ended(model, unknowns, paths, prior, rounds)


def _cooled(
    model: Model,
    unknowns: Unknowns,
    paths: Paths,
    heat: float,
    steps: int,
    *,
    to: Unknowns | None = None,
) -> tuple[Model, Unknowns, Paths]:
    """Where a descent leads with noise so large, and the model with the noise and the scatter that it shows."""
    hot = model.heated(heat, model.scatter_n)
    unknowns, paths, _ = descend(hot, unknowns, paths, steps, _NEARLY_DONE, to=to)
    model = hot.recoloured(unknowns, paths) if heat < _HOT else hot
    return model.heated(1.0, _scatter(model.heated(heat, hot.scatter_n), unknowns, paths)), unknowns, paths


def _ended(
    final: Model, unknowns: Unknowns, paths: Paths, prior: RoughnessPrior | None = None, rounds: int = 0
) -> Found:
    """The end of a descent; with a ``prior`` the roughness is found anew from the motion, in so many rounds."""
    if prior is not None and final.fields.count and final.settings.roughness_by_motion:
        for number in range(rounds):
            before = final
            final = _with_roughness(final, unknowns, paths, prior, anew=number == 0)
            unknowns, paths, _ = descend(final, unknowns, paths, _ROUND_STEPS, _NEARLY_DONE)
            final = final.recoloured(unknowns, paths)
            final = final.heated(1.0, _scatter(final, unknowns, paths))
            if _settled(before, final):
                break
    last = (_LAST_STEPS, _DONE) if prior is not None else (1, _NEARLY_DONE)
    unknowns, paths, squares = descend(final, unknowns, paths, *last)
    return concluded(final, unknowns, paths, squares)


def together(model: Model, starts: list[Unknowns], paths: Paths) -> list[Found]:
    """Return where the descents end from several starts; those that have met at the end of a heat go on as one."""
    going = [(model, one, paths) for one in starts]
    for heat, steps in zip(HEATS, _STEPS, strict=True) if model.settings.heated else [(HEATS[-1], _STEPS[-1])]:
        cooled = [_cooled(*one, heat, steps) for one in going]
        going = [
            one
            for number, one in enumerate(cooled)
            if not any(_alike(one[1], other[1], _MET) for other in cooled[:number])
        ]
    return [_ended(*one) for one in going]


def _settled(before: Model, after: Model) -> bool:
    """Whether a round has left roughness, noise and scatter nearly as they were."""
    assert before.fields.roughness is not None
    assert after.fields.roughness is not None
    moved = after.fields.roughness.logarithms()[:-1] - before.fields.roughness.logarithms()[:-1]
    same = before.noise == after.noise and before.fields.smoothness == after.fields.smoothness
    return same and max(float(np.abs(moved).max()), abs(math.log(after.scatter_n / before.scatter_n))) < _SETTLED


def equations_of(model: Model, unknowns: Unknowns, paths: Paths) -> Equations:
    """Return the normal equations here, with all priors but the fields'."""
    bare = replace(model, fields=no_fields())
    normal, right = _prior_terms(bare, unknowns, model.linearised(unknowns, paths))
    return Equations(normal, right, slice(GLOBALS, GLOBALS + unknowns.fields.size), unknowns.fields)


def _with_roughness(model: Model, unknowns: Unknowns, paths: Paths, prior: RoughnessPrior, *, anew: bool) -> Model:
    """Return the model with the hyperparameters that the motion makes likeliest; ``anew``: with any smoothness."""
    likelihood = field_likelihood(equations_of(model, unknowns, paths))
    if likelihood is None:
        return model
    kinds = (ROUGH, SMOOTH) if anew else (model.fields.smoothness,)
    return replace(model, fields=refined(model.fields, likelihood, prior, kinds))


def _scatter(model: Model, unknowns: Unknowns, paths: Paths) -> float:
    """The scatter of the breakaways' forces that maximises their marginal likelihood, N.

    Given the positions alone the forces are known to a covariance V; the instants of a stem that starts slowly are
    hardly known, and its forces would fit any scatter. Beside V the scatter's variance is what the residuals have.
    """
    static = unknowns.parameters[FS]
    usual_n = math.log(max(_USUAL_SCATTER * static, 1.0e-9))
    loose = model.heated(model.heat, _LOOSE * max(static, 1.0e-9))
    normal, right = _prior_terms(loose, unknowns, loose.linearised(unknowns, paths))
    if not _is_finite(normal, right):
        return model.scatter_n
    slopes = model.breakaway_slopes(unknowns, paths)
    # F_s is known by the breakaways alone: what is left is free of their mean
    contrasts = np.linalg.svd(np.ones((1, slopes.shape[0])))[2][1:]
    slopes = contrasts @ slopes
    normal[FS, FS] += 1.0 / max(static, 1.0e-9) ** 2
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1.0e-300))
    scaled = normal * np.outer(scale, scale)
    scaled[np.diag_indices_from(scaled)] += 1.0e-12
    try:
        factor = cho_factor(scaled, lower=True, check_finite=False)
    except LinAlgError:
        return model.scatter_n
    solved = scale[:, None] * cho_solve(factor, scale[:, None] * np.column_stack([right, slopes.T]), check_finite=False)
    left = contrasts @ model.breakaway_residuals(unknowns, paths) - slopes @ solved[:, 0]
    sizes, axes = np.linalg.eigh(slopes @ solved[:, 1:])
    squares = (axes.T @ left) ** 2

    def surprise(logarithm: float) -> float:
        variances = math.exp(2.0 * logarithm) + np.maximum(sizes, 0.0)
        away = (logarithm - usual_n) / _SCATTER_SPREAD
        return float(np.sum(np.log(variances) + squares / variances)) + away**2

    found = minimize_scalar(surprise, bounds=(usual_n - 6.0, usual_n + 4.0), method="bounded")
    return math.exp(float(found.x))


def _with_times(unknowns: Unknowns, slow_s: float, quick_s: float, filter_s: float) -> Unknowns:
    """Unknowns with these times: m = k t1 t2, F_v = k (t1 + t2)."""
    parameters = unknowns.parameters.copy()
    spring = parameters[LN_K]
    parameters[LN_M] = spring + math.log(slow_s * quick_s)
    parameters[LN_V] = spring + math.log(slow_s + quick_s)
    parameters[LN_FILTER] = math.log(filter_s)
    return replace(unknowns, parameters=np.clip(parameters, LOW, HIGH))


def assignments(unknowns: Unknowns) -> list[Unknowns]:
    """What a slip shows, shared out anew between the stem and the sensor's filter.

    Stem and filter together have 1 + T s + P s^2 + ... with T = F_v / k + filter and P = m / k + filter F_v / k. These
    two are kept, so that real times change places and a stem that swings finds them. A filter f leaves the stem the
    delay T - f and the mass k (P - f (T - f)): it lies below the lower root of f (T - f) = P, or above the upper one.
    """
    m, v, k, filter_s = np.exp(unknowns.parameters[[LN_M, LN_V, LN_K, LN_FILTER]])
    whole_s, second_s2 = float(v / k + filter_s), float(m / k + filter_s * v / k)
    inside = whole_s**2 - 4.0 * second_s2
    lower_s = 0.5 * (whole_s - math.sqrt(max(inside, 0.0)))
    filters_s = [share * lower_s for share in _FILTER_SHARES]
    filters_s += [whole_s - share * lower_s for share in _SLOW_FILTER_SHARES]
    shared = []
    for other_s in filters_s:
        stem_s = whole_s - other_s
        parameters = unknowns.parameters.copy()
        parameters[[LN_M, LN_V, LN_FILTER]] = np.log([k * (second_s2 - other_s * stem_s), k * stem_s, other_s])
        shared.append(replace(unknowns, parameters=np.clip(parameters, LOW, HIGH)))
    return shared


def permuted(unknowns: Unknowns) -> list[Unknowns]:
    """The two times of a stem that does not swing and the filter's, each of them in another's place."""
    m, v, k, filter_s = np.exp(unknowns.parameters[[LN_M, LN_V, LN_K, LN_FILTER]])
    inside = v * v - 4.0 * m * k
    if inside <= 0.0:
        return []
    root = math.sqrt(inside)
    slow, quick, other = float((v + root) / (2.0 * k)), float((v - root) / (2.0 * k)), float(filter_s)
    shared = [(slow, other, quick), (other, quick, slow)]
    return [_with_times(unknowns, max(a, b), max(min(a, b), 2.0e-4), max(c, 2.0e-4)) for a, b, c in shared]


def exchanged(unknowns: Unknowns, path: PathToFit | None) -> list[Unknowns]:
    """The stem's lag in the place of the fitted path's, and the other way round; nothing where no path is fitted."""
    if path is None or path.lag_at is None:
        return []
    lag_s, laws = math.exp(unknowns.laws[path.lag_at]), unknowns.laws.copy()
    laws[path.lag_at] = unknowns.parameters[LN_V] - unknowns.parameters[LN_K]
    out = _with_times(replace(unknowns, laws=laws), max(lag_s, 2.0e-3), 0.002, 0.004)
    out.parameters[FS] = min(out.parameters[FS], 1.1 * out.parameters[FC])
    return [out]


def _near_its_limit(unknowns: Unknowns, slow_s: float, speed_m_per_s: float, limit_share: float | None) -> Unknowns:
    """A stem driven at hardly more than DV: it stops at DV, long before it would turn, so that its lag is longer.

    With a ``limit_share`` known, DV over the speed, ``slow_s`` is that lag.
    """
    share = _NEAR_LIMIT if limit_share is None else limit_share
    longer_s = slow_s if limit_share is not None else slow_s * math.log(2.0) / math.log(2.0 / (1.0 + share))
    near = _damped(unknowns, slow_s, longer_s, speed_m_per_s)
    near.parameters[LN_DV] = math.log(share * max(speed_m_per_s, 1.0e-9))
    return replace(near, parameters=np.clip(near.parameters, LOW, HIGH))


def _damped(unknowns: Unknowns, slow_s: float, longer_s: float, speed_m_per_s: float) -> Unknowns:
    """The same friction in motion at this speed, with a longer lag: what F_v takes is not F_c's."""
    out = _with_times(unknowns, longer_s, 0.002, 0.004)
    moved_n = math.exp(out.parameters[LN_K]) * (longer_s - slow_s) * speed_m_per_s
    out.parameters[FC] = max(out.parameters[FC] - moved_n, 0.1 * out.parameters[FC])
    return out


def explored(
    model: Model,
    unknowns: Unknowns,
    paths: Paths,
    *,
    slow_s: float,
    speed_m_per_s: float,
    prior: RoughnessPrior,
    path: PathToFit | None = None,
    limit_share: float | None = None,
    is_tail: bool = False,
) -> list[Found]:
    """Return the fits from all assignments of the three times, the likeliest first.

    ``slow_s`` is the lag of the stem that turns back at a corner, ``speed_m_per_s`` its usual speed.
    ``path`` is the law of the force's path where that is fitted, too. ``limit_share`` is DV over that speed where it is
    known beforehand. ``is_tail``: the stem coasts as a reading does that is so slow.

    They are tried on some of the sections; the likeliest, and those that are nearly so, go on with all.
    """
    count = model.sections.count
    chosen = np.unique(np.linspace(0, count - 1, min(count, _TRIED_SECTIONS)).astype(np.int64))
    some, few, some_paths = _only(model, unknowns, paths, chosen)
    starts = [
        _with_times(few, slow_s, quick_s, filter_s)
        for quick_s, filter_s in ((0.002, 0.004), (0.004, 0.0005), (0.3 * slow_s, 0.02))
    ]
    starts += [
        _with_times(replace(few, laws=laws), lag_s, 0.002, 0.004) for laws, lag_s in (path.others if path else ())
    ]
    starts.append(_near_its_limit(few, slow_s, speed_m_per_s, limit_share))
    if is_tail:
        starts.append(_with_times(few, 0.01, 0.003, slow_s))
    if slow_s <= LEAST_LAG_S:  # no corner showed a lag: on travel stops at both ends it may be anything
        starts.append(_damped(few, slow_s, _DAMPED_S, speed_m_per_s))
    if not model.settings.several_starts:
        starts = starts[:1]
    found = together(some, starts, some_paths)
    best = min(found, key=lambda one: one.surprise)
    for one in assignments(best.unknowns) if model.settings.several_starts else []:
        # cold: noise that is heated loses what tells them apart
        cooled = _cooled(some, one, best.paths, HEATS[-1], _STEPS[-1], to=best.unknowns)
        if not _alike(cooled[1], best.unknowns, _EQUAL):
            found.append(_ended(*cooled))
    kept = _different(sorted(found, key=lambda one: one.surprise), _NEARLY, _MOST_KEPT)
    best = _on_all(kept[0], model, unknowns, paths, prior)
    for _ in range(_ROUNDS_LEFT_OUT if model.settings.understood else 0):
        good = _understood(best)
        if good.size == model.sections.count:
            break
        model, unknowns, paths = _only(model, unknowns, paths, good)
        best = _on_all(best, model, unknowns, paths, prior)
    whole = [best]
    # the same motion by other times, with all else as the likeliest fit has it
    squares = best.model.squares(best.unknowns, best.paths)
    others = [(one, _TRIED_STEPS) for one in permuted(best.unknowns)]
    others += [(one, _EXCHANGED_STEPS) for one in exchanged(best.unknowns, path)]
    for one, steps in others if model.settings.permuted else []:
        near, near_paths, left = descend(best.model, one, best.paths, steps, _NEARLY_DONE)
        if left < squares + _NEARLY:
            whole.append(annealed(best.model, near, near_paths, HEATS[-1:], prior=prior, rounds=1))
    whole += [
        _on_all(one, model, unknowns, paths, prior)
        for one in kept[1:]
        if not any(_alike(one.unknowns, other.unknowns, _SAME) for other in whole)
    ]
    return _different(sorted(whole, key=lambda one: one.surprise), math.inf, len(whole))


def _only(model: Model, unknowns: Unknowns, paths: Paths, chosen: IntArray) -> tuple[Model, Unknowns, Paths]:
    """The sections of these numbers alone, before any of their fields is known."""
    few = model.only(chosen)
    began_s, rest_m = unknowns.began_s[chosen], unknowns.rest_m[chosen]
    start = replace(unknowns, fields=np.zeros(few.fields.count), began_s=began_s, rest_m=rest_m)
    return few, start, paths.only(model.sections.nodes, chosen)


def _on_all(one: Found, model: Model, unknowns: Unknowns, paths: Paths, prior: RoughnessPrior) -> Found:
    """Where a fit of other sections, or of these, leads with all of the model's; ``unknowns`` begin there."""
    if one.model.sections.sections == model.sections.sections:
        return annealed(one.model, one.unknowns, one.paths, HEATS[-1:], prior=prior)
    fields = model.fields.taken_from(one.model.fields, one.unknowns.fields)
    start = replace(unknowns, parameters=one.unknowns.parameters, fields=fields, laws=one.unknowns.laws)
    whole = replace(one.model, sections=model.sections, fields=model.fields)
    # instants between slow rows are not near enough to begin cold
    rows_s = min(float(np.diff(section.time_s[section.row]).min()) for section in model.sections.sections)
    return annealed(whole, start, paths, HEATS[1:] if rows_s > _SLOW_ROWS_S else HEATS[-1:], prior=prior)


def _understood(found: Found) -> IntArray:
    """Numbers of the sections that a fit explains: all but those that are far worse than the better ones.

    In some a stem that slips rested unseen: they are no motion from one breakaway, and draw all parameters after them.
    What lines between the fields' knots leave of a rough friction is not held against them.
    """
    model = found.model
    off = model.section_chi(found.unknowns, found.paths)
    rough = model.fields.left_by_lines_n / (math.exp(found.unknowns.parameters[LN_K]) * model.noise.white_m)
    good = np.flatnonzero(off < _NOT_UNDERSTOOD * math.hypot(max(float(np.quantile(off, 0.25)), 1.0), rough))
    return good if good.size >= max(_FEWEST_UNDERSTOOD, off.size // 2) else np.arange(off.size)


def _different(found: list[Found], nearly: float, most: int) -> list[Found]:
    """The likeliest fit, and others nearly as likely whose dynamics differ from it, so many at most."""
    kept = [found[0]]
    for one in found[1:]:
        near = one.surprise - found[0].surprise < nearly
        if near and not any(_alike(one.unknowns, other.unknowns, _EQUAL) for other in kept) and len(kept) < most:
            kept.append(one)
    return kept


def _alike(one: Unknowns, other: Unknowns, most: float) -> bool:
    """Whether m, F_v, k and the filter of two fits differ by no more than this, in their logarithms."""
    return bool(np.abs(one.parameters[:4] - other.parameters[:4]).max() <= most)
