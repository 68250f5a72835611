"""The way of starts to the lowest places of the cost: on blocks of rows, through all stages, alike for all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import without_outliers
from estimators.likelihood.hopping import LAST_SHARE, Hopping, hopped, with_scanned_friction
from estimators.likelihood.hops import hops
from estimators.likelihood.horizon import led_on
from estimators.likelihood.model import StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.pool import Place, distinct, halved

# Own choices.
_THROUGH_SHARE: Final = 0.5  # of the budget, for the whole motion of many jumps
_USUAL: Final = 2  # models, where there are few rests
_LED_ON: Final = 2  # places, from rest to rest
_ON_SHARE: Final = 1.0  # of the budget, more of it
_EXPLAINS: Final = 2.25  # the noise's square: the other way to the whole motion is not needed
_SLOWEST_S: Final = 2.0e-3  # from row to row


@dataclass(frozen=True, slots=True)
class Searching:
    """The models of a search: of all rows, on blocks of them, and begun anew at the rests."""

    model: StemModel
    small: StemModel
    stages: list[StemModel]
    rests: Restarts
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
            led = self._led_on(places, budget)
            if not led or led[0].cost > _EXPLAINS * small.time_s.size:
                led = distinct(small, [*led, *halved([*stages[3:], small], places, budget)])
            places = hopped(small, led, hopping, budget, whole)
        return places

    def _led_on(self, places: list[Place], budget: Budget) -> list[Place]:
        """Lead the best places from rest to rest to the whole motion, until one explains it; cheapest first.

        None where the rows are too slow to show the force between them: which of the teeth of its comb the whole motion
        of hundreds of jumps comes to then hangs on how the force is drawn, and all searches come to the same wrong one.
        """
        if float(np.median(np.diff(self.model.time_s))) > _SLOWEST_S:
            return []
        more = Budget.limited(_ON_SHARE * budget.whole)
        led: list[Place] = []
        for place in places[:_LED_ON]:
            led.append(led_on(self.model, self.small, self.rests, place, more))
            if led[-1].cost < _EXPLAINS * self.small.time_s.size:
                break
        budget.simulations += more.simulations
        return distinct(self.small, [place for place in led if math.isfinite(place.cost)])

    def from_rivals(self, best: Place, budget: Budget) -> list[Place]:
        """Follow what explains nearly the same as this place, itself left out; cheapest first.

        Through all stages, as trial values are: a hop on the whole motion falls out of step with the measured jumps.
        """
        own = self.stages[0]
        points = list(hops(self.small, best.point, self.hopping.speed_m_per_s, jumps=True))
        budget.spend(own, len(points))
        starts = [Place(point, own.cost(point)) for point in points]
        return self.lowest(sorted(starts, key=lambda place: place.cost), budget)
