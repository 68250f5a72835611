"""Which causes explain a misfit: forward, one at a time, each beyond chance and away from its bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final

from discrepancy.causes.base import Cause, Setting, is_at_bound, is_trifle
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.screening import Candidate, extended_model, glance, refined, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import NEAR, gain, is_significant, misfit, noise_factor

MOST_CAUSES: Final = 3
_REFITTED: Final = (9, 6, 5)  # in the first, second and third round
_POLISHED: Final = 3
_POLISH: Final = 8
_REFINED: Final = 4
_LOWER: Final = 0.999  # of the cost, that following further must come to
_REFINED_EARLY: Final = 2
_NEARLY_ALL: Final = 0.2  # of the misfit is left
_LEAST_PROMISE: Final = 25.0  # of the cost: with less a cause is not worth a fit
# A second cause must win this share of what the first left, for a wrong first one drags others along.
_SECOND_SHARE: Final = 0.3
_DONE_MISFIT: Final = 1.15
_SETTLED_FACTOR: Final = 2.0
_FOLLOWED_FURTHER: Final = 30.0  # misfit, below which the baseline is first followed further
# The work of a choice in passes of the kernel, of 0.1 to 0.2 us each (discrepancy.model.Tally).
_MOST_WORK: Final = 8.0e7
_CLOSER_WORK: Final = 2.5e7  # of following the lowest further, in each round
_CAUSE_WORK: Final = 1.5e7  # of one cause, from which on no other start of it is tried
# Polled rows tell causes apart less finely, and an answer on them is wanted within seconds.
_COARSE_PERIOD_S: Final = 8.0e-3
_COARSE_SHARE: Final = 0.2
_PRUNING_STEPS: Final = 15
_LOOK_CLOSER: Final = 2.0  # times the misfit of all causes: one may be needless
_RIVAL_SHARE: Final = 0.5
_WORTH: Final = 12.0  # gain of a short fit, from which on a long one is made


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen: the fits from the baseline on, the last with all ``causes``, and each one's near rivals."""

    baseline: Fit
    best: Fit
    causes: tuple[Cause, ...]
    rivals: tuple[str, ...]
    rival_fits: tuple[Fit, ...]
    tried: tuple[tuple[str, float], ...]


Fits = list[tuple[Cause, Fit]]  # of one round, the lowest first


def choose(baseline: Fit, causes: Iterable[Cause], tell: Callable[[float, str], None]) -> Choice:
    """Return the causes that explain the misfit of the baseline, none where noise does.

    First by short fits; only where those leave more than noise are the lowest followed further, for of two causes
    neither comes to its place without the other.
    """
    if misfit(baseline) < _FOLLOWED_FURTHER and not is_noise(baseline):
        # a small misfit may be the fit's own: a cause that only helps it down is none
        baseline = refined(baseline)
    search = _Search(list(causes), baseline.model.tally.work + _share(baseline) * _MOST_WORK, tell)
    begun = _Way(baseline)
    way = search.followed(begun, is_closer=False)
    if not (way.is_done or is_noise(way.best)):
        other = search.followed(begun, is_closer=True)
        way = other if other.is_done or other.best.cost < way.best.cost else way
    best, chosen = _pruned(baseline, way.best, list(way.chosen))
    tried = tuple((cause.name, gain(baseline, fit)) for cause, fit in search.tried)
    if not chosen:
        # what looked like a cause only showed the baseline a better place
        return Choice(best, best, (), (), (), tried)
    return Choice(
        baseline,
        best,
        tuple(chosen),
        tuple(cause.name for cause, _ in way.rivals),
        tuple(fit for _, fit in way.rivals),
        tried,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """How far a forward choice has come: its last fit, what is in it, the last one's rivals, and whether it ends."""

    best: Fit
    chosen: tuple[Cause, ...] = ()
    rivals: tuple[tuple[Cause, Fit], ...] = ()
    is_done: bool = False


class _Search:
    """The forward choices from one baseline: what each round tried is kept for the next that comes by."""

    def __init__(self, known: list[Cause], last: float, tell: Callable[[float, str], None]) -> None:
        self._known, self._last, self._tell = known, last, tell
        self._rounds: list[tuple[Fit, Fits]] = []

    @property
    def tried(self) -> Fits:
        """The fits of the first round."""
        return self._rounds[0][1] if self._rounds else []

    def followed(self, way: _Way, *, is_closer: bool) -> _Way:
        """Return where a forward choice ends; ``is_closer``: each round's lowest fits are followed further first."""
        tally = way.best.model.tally
        while len(way.chosen) < MOST_CAUSES and not way.is_done:
            number = len(way.chosen)
            if tally.work > self._last:
                break
            self._tell(number / MOST_CAUSES, "trying further causes" if number else "trying one cause after the other")
            fits = self._round(way)
            if is_closer:
                fits = _closer(way.best, fits, tally.work + _share(way.best) * _CLOSER_WORK)
            further = _taken(way, fits)
            if further is None:
                break
            way = further
        return way

    def _round(self, way: _Way) -> Fits:
        for at, kept in self._rounds:
            if at is way.best:
                return kept
        best, number = way.best, len(way.chosen)
        setting = setting_of(best)
        left = [cause for cause in self._known if cause not in way.chosen and (number == 0 or not cause.is_hard)]
        candidates = [one for one in screen(best, left, setting) if _is_promising(one, best)]
        if is_noise(best):
            candidates = [one for one in candidates if gain(best, glance(best, one, setting)) > _WORTH]
        fits = _polished(_refits(best, candidates, setting, _REFITTED[number], self._last))
        self._rounds.append((best, fits))
        return fits


def _taken(way: _Way, fits: Fits) -> _Way | None:
    """Return the way with the lowest of these fits that is possible; None where none is worth it."""
    best, setting = way.best, setting_of(way.best)
    found = [(cause, fit) for cause, fit in fits if _is_possible(cause, fit, setting)]
    if not found or not is_significant(best, found[0][1]):
        return None
    cause, fit = found[0]
    rivals: Fits = []
    if way.chosen:
        if 1.0 - excess(fit) / max(excess(best), 1.0e-9) < _SECOND_SHARE and misfit(best) > _DONE_MISFIT:
            return None
    else:
        near = NEAR * noise_factor(fit)
        rivals = [pair for pair in found[1:] if pair[1].cost - fit.cost < near and is_significant(best, pair[1])]
    return _Way(fit, (*way.chosen, cause), tuple(rivals), is_settled(best, fit))


def _share(fit: Fit) -> float:
    """Return the share of all work that a choice may take on these recordings."""
    is_coarse = fit.model.observed.motions[0].samples.period_s > _COARSE_PERIOD_S
    return _COARSE_SHARE if is_coarse else 1.0


def _refits(best: Fit, candidates: list[Candidate], setting: Setting, most: int, last: float) -> Fits:
    """Return the fits of the most promising causes and of the hard ones, the lowest first.

    Once one leaves noise alone, only those are tried that promise about as much: its rivals. No fit is begun after
    ``last`` work.
    """
    ordinary = [one for one in candidates if not one.cause.is_hard and not one.cause.is_shy][:most]
    ordinary += [one for one in candidates if one.cause.is_shy]
    hard = [one for one in candidates if one.cause.is_hard]
    fits: Fits = []
    lowest, explained, promise, early = math.inf, False, 0.0, _REFINED_EARLY
    for one in [*ordinary, *hard]:
        if explained and (
            one.cause.is_hard or one.cause.is_slow or (one.promise < _RIVAL_SHARE * promise and not one.cause.is_shy)
        ):
            continue
        if best.model.tally.work > last:
            break
        fit = refit(best, one, setting, lowest, _share(best) * _CAUSE_WORK)
        if not fit.is_followed:
            continue
        if early > 0 and not is_settled(best, fit) and excess(fit) < _NEARLY_ALL * excess(best):
            # it is likely the one: if it leaves noise alone, the others need no fit
            fit, early = refined(fit), early - 1
        fits.append((one.cause, fit))
        if fit.cost < lowest:
            lowest, explained, promise = fit.cost, is_settled(best, fit), one.promise
    return sorted(fits, key=lambda pair: pair[1].cost)


def _is_promising(candidate: Candidate, best: Fit) -> bool:
    """Whether a cause is worth a fit; what one step of a hard cause promises says nothing."""
    cause = candidate.cause
    return cause.is_hard or cause.is_shy or candidate.promise * best.cost > _LEAST_PROMISE


def _polished(fits: Fits) -> Fits:
    polished = [(cause, descend(fit, most_steps=_POLISH)) for cause, fit in fits[:_POLISHED]]
    return sorted([*polished, *fits[_POLISHED:]], key=lambda pair: pair[1].cost)


def _closer(best: Fit, fits: Fits, last: float) -> Fits:
    """Return the fits with the lowest and the hard ones followed further, until one leaves noise alone.

    None is refined after ``last`` work; what does not come lower stays the fit it was.
    """
    closer: Fits = []
    for number, (cause, fit) in enumerate(fits):
        is_worth = number < _REFINED or cause.is_hard
        explained = any(is_settled(best, found) for _, found in closer) or best.model.tally.work > last
        if is_worth and not is_settled(best, fit) and not explained:
            further = refined(fit)
            closer.append((cause, further if further.cost < _LOWER * fit.cost else fit))
            continue
        closer.append((cause, fit))
    return sorted(closer, key=lambda pair: pair[1].cost)


def is_noise(fit: Fit) -> bool:
    """Whether noise alone may well explain what a fit leaves."""
    return misfit(fit) < _DONE_MISFIT and noise_factor(fit) < _DONE_MISFIT


def is_settled(before: Fit, fit: Fit) -> bool:
    """Whether a fit leaves noise, or so little beside what it took away that what is left is its own."""
    if is_noise(fit):
        return True
    is_small = misfit(fit) < _DONE_MISFIT and noise_factor(fit) < _SETTLED_FACTOR
    return is_small and excess(before) > _FOLLOWED_FURTHER


def excess(fit: Fit) -> float:
    """Return the misfit beyond noise, in shares of the noise's own variance."""
    return max(misfit(fit) - 1.0, 0.0)


def _is_possible(cause: Cause, fit: Fit, setting: Setting) -> bool:
    found = [(unknown, fit.values[unknown.name]) for unknown in cause.unknowns(setting)]
    return not any(is_at_bound(unknown, value) or is_trifle(cause, unknown, value) for unknown, value in found)


def _pruned(baseline: Fit, best: Fit, chosen: list[Cause]) -> tuple[Fit, list[Cause]]:
    """Drop the causes without which the rest does as well, once it has found its place."""
    for cause in list(chosen):
        others = [other for other in chosen if other is not cause]
        model, setting = baseline.model, setting_of(best)
        for other in others:
            model = extended_model(model, other, setting)
        fit = start_fit(replace(model, held={**model.held, **_held(best, others)}), model.unknowns.point(best.values))
        fit = descend(fit, most_steps=_PRUNING_STEPS)
        if fit.is_followed and not is_significant(fit, best) and misfit(fit) < _LOOK_CLOSER * misfit(best):
            best, chosen = fit, others
        elif fit.is_followed and misfit(fit) < _LOOK_CLOSER * misfit(best):
            fit = refined(fit)
            if not is_significant(fit, best):
                best, chosen = fit, others
    return best, chosen


def _held(fit: Fit, causes: list[Cause]) -> dict[str, float]:
    """Parameters of these causes that a fit holds, as it holds them."""
    own = tuple(cause.own("") for cause in causes)
    return {name: value for name, value in fit.model.held.items() if name.startswith(own)}
