"""Whether the lowest place found of a stem that jumps is the bottom: searches apart come to it too."""

from __future__ import annotations

from typing import Final

from estimators.likelihood.all_rows import certified, on_all_rows
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.hopping import led_along_jumps
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place, distinct
from estimators.likelihood.searching import Searching

# Own choices.
CONFIRMING_SHARE: Final = 0.3  # of the budget, more of it, for a search that did not come as far as the other
SECOND_SHARE: Final = 0.6  # of the budget, more of it, for starts that are followed apart
_MORE_SEARCHES: Final = 3  # where two do not agree
_AS_LOW: Final = 9.0  # of the cost, times the misfit's square
_LOWER: Final = 1.0  # of the cost


def led_down_apart(small: StemModel, apart: list[Place], budget: Budget) -> list[Place]:
    """Return the places of searches apart, those that are not as low as the lowest led down their valley.

    A search may end on the slope for want of work, which says nothing about another bottom.
    """
    lowest = min((place.cost for place in apart), default=0.0)
    return [led_along_jumps(small, place, budget, 0.0) if place.cost > lowest + _AS_LOW else place for place in apart]


def at_one_bottom(
    model: StemModel, ended: list[Place], apart: list[Place], searching: Searching, budget: Budget
) -> tuple[list[Place], bool]:
    """Lead the best and the places of searches apart to one bottom; where they do not come to it, search once more.

    Of two searches apart one often ends on the slope. The third one begins at what explains nearly the same as the
    best: it comes back to it, which confirms it, or to a lower place, which then is to be confirmed itself.
    """
    whole = budget.whole
    each = CONFIRMING_SHARE * whole
    # the lower of the searches apart is where the best on all rows comes from
    is_one = False
    if apart:
        others = distinct(searching.small, apart)[1:]
        ended, is_one = _led_to_one_bottom(model, ended, others, each, budget)
    for _ in range(_MORE_SEARCHES):
        if is_one:
            break
        before = ended[0]
        rivals = searching.from_rivals(before, Budget.limited(SECOND_SHARE * whole))[:1]
        if not rivals:
            break
        ended, is_one = _led_to_one_bottom(model, ended, rivals, each, budget)
        if not ended[0].cost < before.cost - _LOWER:
            break
    return ended, is_one


def _led_to_one_bottom(
    model: StemModel, ended: list[Place], apart: list[Place], each: float, budget: Budget
) -> tuple[list[Place], bool]:
    """Lead the best and the places of searches apart down, and tell whether they come to one bottom.

    On blocks that tell what all rows tell at the best, with so much work ``each``: few rows of a jump each, which
    coarser blocks leave out, tell of DV and F_v. Where that leads lower, the places of all rows are those from there.
    """
    fine = compressed(model, keeping=ended[0].point)
    points = [ended[0].point, *(place.point for place in apart)]
    led = [led_along_jumps(fine, Place(point, fine.cost(point)), Budget.limited(each), 0.0) for point in points]
    lowest = min(led, key=lambda place: place.cost)
    if lowest.cost < fine.cost(ended[0].point) - _LOWER:
        budget.left = max(budget.left, 0.0)
        ended = distinct(model, [*on_all_rows(model, [lowest], budget), *ended])
    return ended, are_as_low(fine, ended[0], led, certified(model, ended[0].point).ratio)


def are_as_low(small: StemModel, best: Place, apart: list[Place], ratio: float) -> bool:
    """Whether each search of its own came to a place as low as the best, within what the noise leaves open."""
    rise = _AS_LOW * max(1.0, ratio**2)
    lowest = small.cost(best.point)
    return bool(apart) and all(small.cost(place.point) < lowest + rise for place in apart)
