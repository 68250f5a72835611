"""Which causes explain a misfit: forward, one at a time, each beyond chance and away from its bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from discrepancy.causes.base import Cause, Setting, is_at_bound
from discrepancy.least_squares import Fit, descend
from discrepancy.screening import Candidate, glance, refined, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import NEAR, gain, is_significant, misfit, noise_factor

MOST_CAUSES: Final = 3
_REFITTED: Final = (9, 6, 5)  # in the first, second and third round
_POLISHED: Final = 3
_POLISH: Final = 8
_LEAST_PROMISE: Final = 25.0  # of the cost: with less a cause is not worth a fit
# A second cause must win this share of what the first left, for a wrong first one drags others along.
_SECOND_SHARE: Final = 0.3
_DONE_MISFIT: Final = 1.15
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


def choose(baseline: Fit, causes: Iterable[Cause], tell: Callable[[float, str], None]) -> Choice:
    """Return the causes that explain the misfit of the baseline, none where noise does."""
    known = list(causes)
    best, chosen = baseline, list[Cause]()
    rivals: tuple[str, ...] = ()
    rival_fits: tuple[Fit, ...] = ()
    tried: tuple[tuple[str, float], ...] = ()
    for number in range(MOST_CAUSES):
        tell(number / MOST_CAUSES, "trying one cause after the other" if number == 0 else "trying further causes")
        setting = setting_of(best)
        left = [cause for cause in known if cause not in chosen]
        candidates = [one for one in screen(best, left, setting) if one.promise * best.cost > _LEAST_PROMISE]
        if is_noise(best):
            candidates = [one for one in candidates if gain(best, glance(best, one, setting)) > _WORTH]
        fits = [(one.cause, refit(best, one, setting)) for one in candidates[: _REFITTED[number]]]
        fits = sorted((pair for pair in fits if pair[1].is_followed), key=lambda pair: pair[1].cost)
        polished = [(cause, descend(fit, most_steps=_POLISH)) for cause, fit in fits[:_POLISHED]]
        fits = sorted([*polished, *fits[_POLISHED:]], key=lambda pair: pair[1].cost)
        if number == 0:
            tried = tuple((cause.name, gain(baseline, fit)) for cause, fit in fits)
        found = [(cause, fit) for cause, fit in fits if _is_possible(cause, fit, setting)]
        if not found or not is_significant(best, found[0][1]):
            break
        cause, fit = found[0]
        if not is_noise(fit):
            fit = refined(fit)
        if number > 0 and 1.0 - excess(fit) / max(excess(best), 1.0e-9) < _SECOND_SHARE and misfit(best) > _DONE_MISFIT:
            break
        if number == 0:
            near = NEAR * noise_factor(fit)
            close = [pair for pair in found[1:] if pair[1].cost - fit.cost < near and is_significant(best, pair[1])]
            rivals, rival_fits = tuple(one.name for one, _ in close), tuple(one for _, one in close)
        else:
            rivals, rival_fits = (), ()
        best, chosen = fit, [*chosen, cause]
        if is_noise(best):
            break
    if len(chosen) > 1:
        best, chosen = _pruned(baseline, best, chosen)
    return Choice(baseline, best, tuple(chosen), rivals, rival_fits, tried)


def is_noise(fit: Fit) -> bool:
    """Whether noise alone may well explain what a fit leaves."""
    return misfit(fit) < _DONE_MISFIT and noise_factor(fit) < _DONE_MISFIT


def excess(fit: Fit) -> float:
    """Return the misfit beyond noise, in shares of the noise's own variance."""
    return max(misfit(fit) - 1.0, 0.0)


def _is_possible(cause: Cause, fit: Fit, setting: Setting) -> bool:
    values = fit.values
    return not any(is_at_bound(unknown, values[unknown.name]) for unknown in cause.unknowns(setting))


def _pruned(baseline: Fit, best: Fit, chosen: list[Cause]) -> tuple[Fit, list[Cause]]:
    """Drop a cause that a later one has made needless."""
    for cause in list(chosen[:-1]):
        setting = setting_of(best)
        fit = baseline
        for other in chosen:
            if other is not cause:
                start = {part.name: best.values[other.own(part.name)] for part in other.parts}
                fit = refit(fit, Candidate(other, (start,), 1.0), setting)
        fit = descend(fit, most_steps=8)
        if fit.is_followed and not is_significant(fit, best):
            best, chosen = fit, [other for other in chosen if other is not cause]
    return best, chosen
