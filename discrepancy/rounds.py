"""One round of a forward choice: which causes are fitted, which fits are followed further, and the work of it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.causes.base import Cause, Setting, is_at_bound, is_trifle
from discrepancy.falling_friction import may_ring
from discrepancy.least_squares import Fit, descend
from discrepancy.refining import refined
from discrepancy.screening import Candidate, refit
from discrepancy.significance import excess, is_settled
from discrepancy.to_and_fro import from_any_phase

Fits = list[tuple[Cause, Fit]]  # of one round, the lowest first

# The work of a choice in passes of the kernel, of 0.1 to 0.2 us each (discrepancy.model.Tally).
MOST_WORK: Final = 8.0e7
WHOLE_WORK: Final = 1.5e8  # of all rounds together, whatever each is given: after it no fit is led further
CLOSING_WORK: Final = 3.0e7  # beside it, of telling needless causes and rivals of what was found
CLOSER_WORK: Final = 2.5e7  # of following the lowest further, in each round
CAUSE_WORK: Final = 1.5e7  # of one cause, from which on no other start of it is tried
_HARD_WORK: Final = 3.5e7  # that hard causes have to themselves, where the ordinary ones took all
_UNCLEAR_SHARE: Final = 0.3  # of that, for a slow one that promises little
_USUAL_S: Final = 60.0
_LONGEST: Final = 2.0  # times as much work, however long the recordings are
# Polled rows tell causes apart less finely, and an answer on them is wanted within seconds.
_COARSE_PERIOD_S: Final = 8.0e-3
_COARSE_SHARE: Final = 0.2
_POLISHED: Final = 3
_POLISH: Final = 8
_REFINED: Final = 4
_LOWER: Final = 0.999  # of the cost, that following further must come to
_MUCH_LOWER: Final = 0.8  # and from which on it is followed again
_REFINEMENTS: Final = 4
_REFINED_EARLY: Final = 2
NEARLY_ALL: Final = 0.2  # of the misfit is left
_NEXT_TO_ALL: Final = 0.02  # of it, above which none but a kin is refined once a cause leaves noise alone
# Causes that shape the same curve, friction or spring force over travel: none is named before the others were tried.
KIN: Final = (
    frozenset({"friction_gradient", "pressure_dependent_friction"}),
    frozenset({"spring_hardening", "dual_rate_spring", "diaphragm_area_change", "position_nonlinearity"}),
)
_LEAST_LEFT: Final = 0.8  # misfit: no valve leaves less than that of a sensor whose noise is known so well
_LEAST_PROMISE: Final = 25.0  # of the cost: with less a cause is not worth a fit
_RIVAL_SHARE: Final = 0.5


def share_of_work(fit: Fit) -> float:
    """Return the work that a choice may take on these recordings, as a share of that on 60 s."""
    observed = fit.model.observed
    span_s = sum(float(np.ptp(motion.samples.time_s)) for motion in observed.motions)
    return (_COARSE_SHARE if _is_coarse(fit) else 1.0) * min(max(span_s / _USUAL_S, 1.0), _LONGEST)


def _is_coarse(fit: Fit) -> bool:
    return fit.model.observed.motions[0].samples.period_s > _COARSE_PERIOD_S


def refits(best: Fit, candidates: list[Candidate], setting: Setting, most: int, last: float) -> Fits:
    """Return the fits of the most promising causes and of the hard ones, the lowest first; slow ones are tried last.

    Once one leaves noise alone, only those are tried that promise about as much: its rivals. No fit is begun after
    ``last`` work, but for the hard ones, whose promise says nothing: they have some of their own, but not on polled
    rows, which hardly show them, where an ordinary one takes nearly all.
    """
    ordinary = [one for one in candidates if not one.cause.is_hard and not one.cause.is_shy][:most]
    clear = math.inf if _is_coarse(best) or not ordinary else _RIVAL_SHARE * ordinary[0].promise
    slow = [one for one in ordinary[1:] if one.cause.is_slow and one.promise < clear]
    # shy ones in their place: last of all, one that takes most of the misfit found the work used up
    ordinary = [one for one in candidates if one.cause.is_shy or (one in ordinary and one not in slow)]
    # quick ones first: with others before them the work of polled rows is used up
    quick = [one for one in ordinary if one.cause.is_quick and one.promise > _RIVAL_SHARE * ordinary[0].promise]
    ordinary = [*quick, *(one for one in ordinary if one not in quick)]
    hard = [one for one in candidates if one.cause.is_hard]
    # a valve without damping, or with a wide DV, rings: no other cause does, and after all others no work is left
    # but for a clear wave in the forces at hundreds of breakaways, which that stands in for
    is_shaken = bool(ordinary) and ordinary[0].cause.promise(setting) > 0.0
    if not _is_coarse(best) and may_ring(best, setting) and not is_shaken:
        ordinary, hard = [*hard, *ordinary], []
    fits: Fits = []
    lowest, explained, promise = math.inf, False, 0.0
    for one in [one for one in candidates if one.cause.is_periodic and not _is_coarse(best)]:
        # of hundreds of rests the first tell a force within a second, and all else takes what work there is
        fit = from_any_phase(best, one, setting)
        if fit is not None and is_settled(best, fit):
            fits, lowest, explained, promise = [(one.cause, fit)], fit.cost, True, max(one.promise, 1.0 - NEARLY_ALL)
            ordinary, slow = ([other for other in group if other is not one] for group in (ordinary, slow))
    # of polled rows one refinement would take the work of all that was not tried yet
    early = 0 if _is_coarse(best) else _REFINED_EARLY
    for one in [*ordinary, *hard, *slow]:
        if explained and (
            one.cause.is_hard or one.cause.is_slow or (one.promise < _RIVAL_SHARE * promise and not one.cause.is_shy)
        ):
            continue
        is_found = _is_coarse(best) and any(excess(fit) < NEARLY_ALL * excess(best) for _, fit in fits)
        own = share_of_work(best) * _HARD_WORK if one.cause.is_hard and not is_found else 0.0
        if one.cause.is_slow and not _is_coarse(best):
            own = share_of_work(best) * CAUSE_WORK
        if best.model.tally.work > last + own:
            continue
        work = _UNCLEAR_SHARE * CAUSE_WORK if one in slow else CAUSE_WORK
        fit = refit(best, one, setting, lowest, share_of_work(best) * work)
        if not fit.is_followed:
            continue
        is_rival = explained and not _are_kin(one.cause, min(fits, key=lambda pair: pair[1].cost)[0])
        left = (_NEXT_TO_ALL if is_rival else NEARLY_ALL) * excess(best)
        if early > 0 and not is_settled(best, fit) and excess(fit) < left:
            # it is likely the one: if it leaves noise alone, the others need no fit
            fit, early = _refined(fit), early - 1
        fits.append((one.cause, fit))
        if fit.cost < lowest:
            lowest, explained, promise = fit.cost, is_settled(best, fit), one.promise
    return sorted(fits, key=lambda pair: pair[1].cost)


def _are_kin(one: Cause, other: Cause) -> bool:
    return any({one.name, other.name} <= group for group in KIN)


def is_possible(cause: Cause, fit: Fit, setting: Setting) -> bool:
    """Whether all parameters of a cause are the data's and not a bound's, and its strength is no trifle."""
    found = [(unknown, fit.values[unknown.name]) for unknown in cause.unknowns(setting)]
    return not any(is_at_bound(cause, unknown, value) or is_trifle(cause, unknown, value) for unknown, value in found)


def own_error(chosen: Iterable[Cause], plain: Fit, best: Fit) -> float:
    """Return how much of the cost what is chosen may leave by its own laws' errors: another cause must win more."""
    return max((cause.law_error for cause in chosen), default=0.0) ** 2 * (plain.cost - best.cost)


def is_all_but_own_error(chosen: Iterable[Cause], plain: Fit, fit: Fit) -> bool:
    """Whether a fit with these causes leaves no more beside noise than their own laws' errors may."""
    return fit.cost - _LEAST_LEFT * fit.model.observed.count < own_error(chosen, plain, fit)


def is_promising(candidate: Candidate, best: Fit) -> bool:
    """Whether a cause is worth a fit; what one step of a hard cause promises says nothing."""
    cause = candidate.cause
    return cause.is_hard or cause.is_shy or candidate.promise * best.cost > _LEAST_PROMISE


def polished(fits: Fits) -> Fits:
    """Return the fits with the lowest of them descended some steps more."""
    lowest = [(cause, descend(fit, most_steps=_POLISH)) for cause, fit in fits[:_POLISHED]]
    return sorted([*lowest, *fits[_POLISHED:]], key=lambda pair: pair[1].cost)


def closer(best: Fit, fits: Fits, last: float) -> Fits:
    """Return the fits with the lowest and the hard ones followed further, until one leaves noise alone.

    None is refined after ``last`` work; what does not come lower stays the fit it was.
    """
    found: Fits = []
    for number, (cause, fit) in enumerate(fits):
        is_worth = number < _REFINED or cause.is_hard
        explained = any(is_settled(best, one) for _, one in found) or best.model.tally.work > last
        followed = _followed(best, fit, last) if is_worth and not explained else fit
        found.append((cause, followed))
    return sorted(found, key=lambda pair: pair[1].cost)


def _followed(best: Fit, fit: Fit, last: float) -> Fit:
    """Return a fit refined for as long as that leads much lower; the fit itself where it leads nowhere."""
    for _ in range(_REFINEMENTS):
        if is_settled(best, fit) or best.model.tally.work > last:
            break
        if fit.cost > _LOWER * fit.refined_to:
            # it would lead to the same place again
            break
        further = _refined(fit)
        if further.cost > _LOWER * fit.cost:
            break
        is_slight, fit = further.cost > _MUCH_LOWER * fit.cost, further
        if is_slight:
            break
    return fit


def _refined(fit: Fit) -> Fit:
    """Return the fit refined; with the cost that it came to where that is hardly lower."""
    further = refined(fit)
    return replace(further, refined_to=further.cost) if further.cost > _MUCH_LOWER * fit.cost else further
