"""Which causes explain a misfit: forward, one at a time, each beyond chance and away from its bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

from discrepancy.another_form import one_of_another_form
from discrepancy.by_forces import way_by_forces
from discrepancy.causes.base import Cause
from discrepancy.choice import Choice, Way
from discrepancy.finishing import finished
from discrepancy.glancing import glance
from discrepancy.kin_friction import other_kind
from discrepancy.least_squares import Fit, descend
from discrepancy.pruning import pruned, with_causes
from discrepancy.refining import refined
from discrepancy.rivals import is_near, rivals_of
from discrepancy.rounds import (
    CLOSER_WORK,
    CLOSING_WORK,
    KIN,
    MOST_WORK,
    NEARLY_ALL,
    WHOLE_WORK,
    Fits,
    closer,
    is_all_but_own_error,
    is_possible,
    is_promising,
    own_error,
    polished,
    refits,
    share_of_work,
)
from discrepancy.running_on import running_on
from discrepancy.screening import refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import (
    DONE_MISFIT,
    LARGE_MISFIT,
    excess,
    gain,
    is_noise,
    is_settled,
    is_significant,
    misfit,
)

MOST_CAUSES: Final = 3
_LAST_STEPS: Final = 15
_EXCHANGED: Final = 2  # causes in the valve, from which on the first is tried again beside the other
_REFITTED: Final = (9, 6, 5)  # in the first, second and third round
# Work of a round that has a cause beside it, whatever the rounds before took: a second cause needs its turn.
_FURTHER_WORK: Final = 3.0e7
_FURTHER_IN_ALL: Final = 6.0e7  # given to such rounds together: what no pair explains must come to its end, too
# Of what a cause left, from which on a falling friction is worth its grid beside it.
_LITTLE_LEFT: Final = 0.02
# A second cause must win this share of what the first left, for a wrong first one drags others along.
_SECOND_SHARE: Final = 0.3
_WORTH_KIN: Final = 2.0  # misfit of several causes, below which kin may make the difference
_WORTH: Final = 12.0  # gain of a short fit, from which on a long one is made


def choose(baseline: Fit, causes: Iterable[Cause], tell: Callable[[float, str], None]) -> Choice:
    """Return the causes that explain the misfit of the baseline, none where noise does.

    First by short fits; only where those leave more than noise are the lowest followed further, for of two causes
    neither comes to its place without the other. All of it takes a bounded work, the same on every machine.
    """
    tally, share = baseline.model.tally, share_of_work(baseline)
    tally.most = tally.work + share * WHOLE_WORK
    try:
        return _chosen(baseline, list(causes), tell, share)
    finally:
        tally.most = math.inf


def _chosen(
    baseline: Fit, known: list[Cause], tell: Callable[[float, str], None], share: float, *, by_forces: bool = True
) -> Choice:
    tally = baseline.model.tally
    if is_noise(baseline):
        # what a fit's last steps win is no cause's
        baseline = descend(baseline, most_steps=_LAST_STEPS)
    elif misfit(baseline) < LARGE_MISFIT:
        # a small misfit may be the fit's own: a cause that only helps it down is none
        baseline = refined(baseline)
        # measured rests may be all that hangs together: then no cause is looked for in them
        free = running_on(baseline)
        baseline = free if is_noise(free) else baseline
    told = way_by_forces(baseline, known) if by_forces else None
    search = _Search(known, Way(baseline) if told is None else told, tally.work + share * MOST_WORK, tell)
    way = search.followed(is_closer=False)
    if not (way.is_done or is_noise(way.best)):
        other = search.followed(is_closer=True)
        way = other if other.is_done or other.best.cost < way.best.cost else way
    is_cut = search.is_cut
    tally.most = max(tally.work, tally.most) + share * CLOSING_WORK
    best, chosen = pruned(baseline, way.best, list(way.chosen))
    if told is not None and len(chosen) == 1:
        # the forces told of one too many: what explains alone is chosen among its rivals
        return _chosen(baseline, known, tell, share, by_forces=False)
    if len(chosen) == len(way.chosen) and (len(chosen) == 1 or misfit(best) < _WORTH_KIN):
        before = chosen
        best, chosen, way = _beside_kin(baseline, best, chosen, way, search)
        if set(chosen) != set(before):
            # what made up for a kin's other shape is needless beside the right one
            best, chosen = pruned(baseline, best, chosen, fades=True)
    tried = tuple((cause.name, gain(baseline, fit)) for cause, fit in search.tried)
    if len(chosen) > 1 or misfit(best) >= DONE_MISFIT:
        one = one_of_another_form(baseline, best, known, search.tried, share)
        if one is not None:
            return replace(one, tried=tried, is_cut=is_cut)
    if not chosen:
        # what looked like a cause only showed the baseline a better place
        return Choice(best, best, (), (), (), tried, is_cut)
    rivals = rivals_of(best, chosen, way, None if len(way.chosen) == len(chosen) else baseline)
    best = finished(best)
    # those that were near are led as far
    rivals = [(cause, fit) for cause, fit in ((one, finished(fit)) for one, fit in rivals) if is_near(fit, best)]
    known_rivals = {cause.name for cause, _ in rivals}
    kin = other_kind(baseline, best, chosen)
    rivals += [(one, fit) for one, fit in kin if one.name not in known_rivals and is_near(fit, best)]
    return Choice(
        baseline,
        best,
        # the one that has rivals is told first
        (chosen[-1], *chosen[:-1]) if rivals else tuple(chosen),
        tuple(cause.name for cause, _ in rivals),
        tuple(fit for _, fit in rivals),
        tried,
        is_cut,
    )


def _beside_kin(
    baseline: Fit, best: Fit, chosen: list[Cause], way: Way, search: _Search
) -> tuple[Fit, list[Cause], Way]:
    """Return the lowest fit with each cause or one of its kin in its place, and what does as well as its rivals.

    Far from the valve's own values the balance of forces promises little of a cause, and it may not have been tried;
    of the first of two causes it was tried without the second. Kin are fitted from where the causes led.
    """
    for cause in tuple(chosen):
        fitted = way.fitted if cause is way.chosen[-1] else frozenset[str]()
        group = next((group for group in KIN if cause.name in group), frozenset[str]()) - fitted
        kin = [other for other in search.known if other.name in group and other not in chosen]
        if not kin:
            continue
        others = [other for other in chosen if other is not cause]
        start = with_causes(baseline, best, others, most_steps=0)
        setting = setting_of(start)
        fits: Fits = [(cause, best)]
        for candidate in screen(start, kin, setting):
            fit = refit(start, candidate, setting)
            if fit.is_followed and is_possible(candidate.cause, fit, setting) and is_significant(baseline, fit):
                fits.append((candidate.cause, fit))
        fits.sort(key=lambda pair: pair[1].cost)
        (lowest, fit), near = fits[0], [pair for pair in fits[1:] if is_near(pair[1], fits[0][1])]
        if cause is way.chosen[-1]:
            near += [pair for pair in way.rivals if pair[0] is not lowest]
        elif lowest is cause and not near:
            continue
        # the one that has rivals is the last
        best, chosen = fit, [*others, lowest]
        way = replace(way, best=fit, chosen=tuple(chosen), rivals=tuple(near), fitted=frozenset())
    return best, chosen, way


class _Search:
    """The forward choices from one baseline: what each round tried is kept for the next that comes by."""

    def __init__(self, known: list[Cause], begun: Way, last: float, tell: Callable[[float, str], None]) -> None:
        self.known, self._begun, self._last, self._tell = known, begun, last, tell
        self._to_give = share_of_work(begun.best) * _FURTHER_IN_ALL
        self._rounds: list[tuple[Fit, Fits]] = []
        self._exchanges: dict[tuple[str, str], Way | None] = {}

    @property
    def tried(self) -> Fits:
        """The fits of the first round."""
        return self._rounds[0][1] if self._rounds else []

    @property
    def is_cut(self) -> bool:
        """Whether what was to be tried yet had no work left."""
        tally = self._begun.best.model.tally
        return tally.is_spent or tally.work > self._last

    def followed(self, *, is_closer: bool) -> Way:
        """Return where a forward choice ends; ``is_closer``: each round's lowest fits are followed further first."""
        way, tally = self._begun, self._begun.best.model.tally
        while len(way.chosen) < MOST_CAUSES and not (way.is_done or tally.is_spent):
            number = len(way.chosen)
            if number and excess(way.best) < NEARLY_ALL * excess(self._begun.best):
                self._give_work()
            if tally.work > self._last and not (is_closer and number == 0 and self._has_nearly_all(way.best)):
                break
            self._tell(number / MOST_CAUSES, "trying further causes" if number else "trying one cause after the other")
            fits = self._round(way)
            if is_closer:
                # what ends at a bound is no name, and must not keep the others from being followed
                setting = setting_of(way.best)
                fits = sorted(fits, key=lambda pair: not is_possible(pair[0], pair[1], setting))
                until = tally.work + share_of_work(way.best) * CLOSER_WORK
                fits = closer(way.best, fits, min(until, self._last) if number else until)
            further = _taken(way, fits, self._begun.best)
            if further is None:
                break
            way = further
            if len(way.chosen) == _EXCHANGED and misfit(way.best) > DONE_MISFIT and self._to_give > 0.0:
                way = self._exchanged(way)
        return way

    def _exchanged(self, way: Way) -> Way:
        """Return the way with the first of two causes exchanged where that leads lower: it stood for its partner."""
        first, second = way.chosen
        without = [fit for cause, fit in self.tried if cause is second]
        without.append(with_causes(self._begun.best, way.best, [second]))
        alone = Way(min(without, key=lambda fit: fit.cost), (second,))
        if not alone.best.is_followed:
            return way
        if (first.name, second.name) not in self._exchanges:
            self._give_work()
            self._exchanges[first.name, second.name] = _taken(alone, self._round(alone), self._begun.best)
        other = self._exchanges[first.name, second.name]
        return way if other is None or other.best.cost >= way.best.cost else other

    def _give_work(self) -> None:
        """Let the next round have its own work, whatever the rounds before took, until all is given."""
        best = self._begun.best
        own = min(share_of_work(best) * _FURTHER_WORK, self._to_give)
        self._to_give -= own
        self._last = max(self._last, best.model.tally.work + own)

    def _has_nearly_all(self, best: Fit) -> bool:
        """Whether the first round has a cause that leaves next to nothing: it is followed whatever was spent."""
        return bool(self.tried) and excess(self.tried[0][1]) < NEARLY_ALL * excess(best)

    def _round(self, way: Way) -> Fits:
        for at, kept in self._rounds:
            if at is way.best:
                return kept
        best, number = way.best, len(way.chosen)
        setting = setting_of(best)
        # beside another cause the grid of a hard one is worth its work only where that took next to all
        may_be_hard = number == 0 or (number == 1 and excess(best) < _LITTLE_LEFT * excess(self._begun.best))
        left = [cause for cause in self.known if cause not in way.chosen and (may_be_hard or not cause.is_hard)]
        candidates = [one for one in screen(best, left, setting) if is_promising(one, best)]
        glanced: dict[str, Fit] = {}
        if is_noise(best):
            glanced = {one.cause.name: glance(best, one, setting) for one in candidates}
            candidates = [one for one in candidates if gain(best, glanced[one.cause.name]) > _WORTH]
        fits = refits(best, candidates, setting, _REFITTED[number], self._last)
        # beside noise the valve is at its place already, and a search from afar may end above the glance
        fits = [(cause, min(fit, glanced.get(cause.name, fit), key=lambda one: one.cost)) for cause, fit in fits]
        fits = polished(sorted(fits, key=lambda pair: pair[1].cost))
        self._rounds.append((best, fits))
        return fits


def _taken(way: Way, fits: Fits, plain: Fit) -> Way | None:
    """Return the way with the lowest of these fits that is possible; None where none is worth it."""
    best, setting = way.best, setting_of(way.best)
    found = [(cause, fit) for cause, fit in fits if is_possible(cause, fit, setting)]
    if not found or not is_significant(best, found[0][1]):
        return None
    if best.cost - found[0][1].cost < own_error(way.chosen, plain, best):
        return None
    (cause, fit), others = found[0], found[1:]
    if not is_settled(best, fit):
        # what it leaves of itself is no second cause's, nor does a rival end where its search did
        near = [(other, finished(one)) for other, one in others if is_near(one, fit)]
        fit, others = finished(fit), near
    if way.chosen and 1.0 - excess(fit) / max(excess(best), 1.0e-9) < _SECOND_SHARE and misfit(best) > DONE_MISFIT:
        return None
    rivals = [pair for pair in others if is_near(pair[1], fit) and is_significant(best, pair[1])]
    chosen = (*way.chosen, cause)
    is_all = is_settled(best, fit) or is_all_but_own_error(chosen, plain, fit)
    return Way(fit, chosen, tuple(rivals), is_all, frozenset(one.name for one, _ in fits))
