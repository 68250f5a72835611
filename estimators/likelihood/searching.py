"""The way of starts to the lowest places of the cost: on blocks of rows, through all stages, alike for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import without_outliers
from estimators.likelihood.hopping import LAST_SHARE, Hopping, hopped, with_scanned_friction
from estimators.likelihood.hops import hops
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place, distinct, halved

# Own choices.
_THROUGH_SHARE: Final = 0.5  # of the budget, for the whole motion of many jumps
_USUAL: Final = 2  # models, where there are few rests


@dataclass(frozen=True, slots=True)
class Searching:
    """The models of a search on blocks of rows."""

    small: StemModel
    stages: list[StemModel]
    hopping: Hopping

    def lowest(self, first: list[Place], budget: Budget) -> list[Place]:
        """Follow these starts, and hop from the best; cheapest first."""
        small, stages, hopping, whole = self.small, self.stages, self.hopping, budget.whole
        # hops where a simulation is cheapest: many jumps need not be in step with the measured ones for that
        begins_anew = hopping.jumps and len(stages) > _USUAL
        begun = stages[:3] if begins_anew else [*stages, small]
        places = halved(begun, first, budget)
        if not begins_anew:
            places += [with_scanned_friction(small, place, budget) for place in places[:2]]
        reserve = _THROUGH_SHARE if begins_anew else LAST_SHARE
        last = without_outliers(begun[-1], places[0].point) if places else begun[-1]
        places = [Place(place.point, last.cost(place.point)) for place in places]
        places = hopped(last, distinct(small, places), hopping, budget, whole, reserve=reserve)
        if begins_anew:
            places = hopped(small, halved([*stages[3:], small], places, budget), hopping, budget, whole)
        return places

    def from_rivals(self, best: Place, budget: Budget) -> list[Place]:
        """Follow what explains nearly the same as this place, itself left out; cheapest first.

        Through all stages, as trial values are: a hop on the whole motion falls out of step with the measured jumps.
        """
        own = self.stages[0]
        points = list(hops(self.small, best.point, self.hopping.speed_m_per_s, jumps=True))
        budget.spend(own, len(points))
        starts = [Place(point, own.cost(point)) for point in points]
        return self.lowest(sorted(starts, key=lambda place: place.cost), budget)
