"""Whether the channels of a file are delayed to each other: two hypotheses, weighed, and what is known under both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from estimators.identifiability.bound import Knowledge
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.descent import descend
from estimators.likelihood.intervals import Ramps, known
from estimators.likelihood.mixture import mixed, reaching
from estimators.likelihood.model import StemModel
from estimators.samples import FloatArray

DELAY: Final = "delay_s"
# A file has one time a row, so that a delay is the exception: it has one chance in twenty beforehand.
_FREE_BEFOREHAND: Final = 0.05
_ONE_INSTANT: Final = 0.005  # of a period: what remains where both channels are read at one instant
_DECIDED: Final = 0.01
_STEPS: Final = 15
_LAST_STEPS: Final = 4
_WORTH_A_SEARCH: Final = 10.0
_SHOWN: Final = 3.84  # of the cost: one value in twenty is as far off by chance
_TRIED: Final = (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0)  # prior widths


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """The model and point (p,) of the likelier hypothesis, what is known under both, and the weight of a delay."""

    model: StemModel
    point: FloatArray
    knows: Knowledge | None
    weight: float


def at_one_instant(model: StemModel, period_s: float) -> StemModel:
    """Return the model in which the channels are read at one instant."""
    entries = tuple(
        replace(entry, prior_sd=_ONE_INSTANT * period_s / entry.unit) if entry.name == DELAY else entry
        for entry in model.coordinates.entries
    )
    return replace(model, coordinates=Coordinates(entries))


def delayed(model: StemModel, free: StemModel) -> StemModel:
    """Return the model with the delay as free as it is in ``free``."""
    own = {entry.name: entry for entry in free.coordinates.entries}
    entries = tuple(own[DELAY] if entry.name == DELAY else entry for entry in model.coordinates.entries)
    return replace(model, coordinates=Coordinates(entries))


def says_nothing(model: StemModel, period_s: float) -> bool:
    """Whether the recording does not say how its channels were read: the delay's prior is a period wide or more."""
    return any(
        entry.name == DELAY and entry.prior_sd * entry.unit > 0.9 * period_s for entry in model.coordinates.entries
    )


def weigh(free: StemModel, narrow: StemModel, point: FloatArray, ramps: Ramps, noise_factor: float) -> Weighed:
    """Weigh a delay against none, from the fit ``point`` (p,) without one, by Laplace's approximation.

    log odds of a delay = log(0.05/0.95) + (cost without - cost with)/2 + log(posterior over prior width). Between 1 and
    99 % what is known is the mixture of both: its mean and covariance. Where the cost itself shows a delay and only
    the odds beforehand speak against it, the intervals hold both hypotheses: DV or F_v may have taken its place.
    """
    width_s = next(entry.prior_sd * entry.unit for entry in free.coordinates.entries if entry.name == DELAY)
    alone = known(narrow, point, ramps, noise_factor=noise_factor)
    small = compressed(free)
    held = tuple(name for name in free.coordinates.names if name.startswith("input_"))
    found = descend(small, point, most_steps=_STEPS, held=held, one_sided=True)
    if small.cost(point) - found.cost > _WORTH_A_SEARCH * noise_factor**2:
        # a delay there is: friction took its place where it is not small, so that both have to move together
        for start in _other_starts(free, point, width_s, ramps):
            elsewhere = descend(small, start, most_steps=_STEPS, held=held, one_sided=True)
            found = elsewhere if elsewhere.cost < found.cost else found
        found = descend(small, found.point, most_steps=2 * _STEPS, held=held)
        found = descend(free, found.point, most_steps=4 * _STEPS)
    else:
        found = descend(free, found.point, most_steps=_LAST_STEPS)
    if not found.arrived and narrow.cost(point) - found.cost > _SHOWN * noise_factor**2:
        found = descend(free, found.point, most_steps=4 * _STEPS)
    shifted = known(free, found.point, ramps, noise_factor=noise_factor)
    if alone is None or shifted is None:
        return Weighed(narrow, point, alone, 0.0)
    fall = (narrow.cost(point) - found.cost) / noise_factor**2
    odds = math.log(_FREE_BEFOREHAND / (1.0 - _FREE_BEFOREHAND)) + 0.5 * fall
    odds += math.log(max(shifted.std_error(DELAY), 1.0e-300) / width_s)
    weight = 1.0 / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
    if weight > 1.0 - _DECIDED:
        return Weighed(free, found.point, shifted, 1.0)
    if fall < _SHOWN and weight < _DECIDED:
        return Weighed(narrow, point, alone, 0.0)
    mixture = mixed([1.0 - weight, weight], [alone, shifted])
    if fall > _SHOWN:
        mixture = reaching(mixture, alone if weight > 0.5 else shifted)
    likelier = (free, found.point) if weight > 0.5 else (narrow, point)
    return Weighed(*likelier, mixture, weight)


def _other_starts(model: StemModel, point: FloatArray, width_s: float, ramps: Ramps) -> list[FloatArray]:
    """Points with other delays, the frictions changed by the force that the slowest ramp makes in each."""
    values = model.coordinates.values(point)
    rate = min(ramps.rates_n_per_s, default=0.0)
    usual = next(entry.value(entry.prior) for entry in model.coordinates.entries if entry.name == "DV")
    starts = []
    for widths in _TRIED:
        delay_s = widths * width_s
        static_n = values["F_c"] * (1.0 + values["d"])
        coulomb_n = values["F_c"] - rate * delay_s
        if coulomb_n > 0.0:
            ratio = max(0.0, (static_n - rate * delay_s) / coulomb_n - 1.0)
            changed = values | {DELAY: delay_s, "F_c": coulomb_n, "d": ratio}
            starts.append(model.coordinates.point(changed))
            # without the delay DV may have taken its place too
            starts.append(model.coordinates.point(changed | {"DV": usual}))
    return starts
