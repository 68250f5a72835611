"""Whether the channels of a file are delayed to each other: two hypotheses, weighed, and what is known under both."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.budget import Budget
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.descent import descend
from estimators.likelihood.elimination import descend_with_errors
from estimators.likelihood.intervals import known, natural_values
from estimators.likelihood.mixture import mixed, reaching
from estimators.likelihood.model import StemModel
from estimators.likelihood.problem import Problem
from estimators.likelihood.ramps import Ramps
from estimators.motion.channels import ONE_INSTANT
from estimators.samples import FloatArray

DELAY: Final = "delay_s"
# A file has one time a row, so that a delay is the exception: it has one chance in twenty beforehand.
_FREE_BEFOREHAND: Final = 0.05
_BELIEVED: Final = 5.0  # standard deviations: by chance one in two million is further off
_DECIDED: Final = 0.01
_STEPS: Final = 15
_LAST_STEPS: Final = 4
_WORTH_A_SEARCH: Final = 10.0
_AT_ONCE: Final = 1.0  # of a search's budget, for one descent on all rows
_SHOWN: Final = 3.84  # of the cost: one value in twenty is as far off by chance
_FAST_S: Final = 2.0e-3
_EVEN: Final = 1.0e-3  # of a period
_NEAREST_ROW: Final = 0.5  # of a period: what is read later stands in the next row
_PROFILED: Final = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)  # of the delay's prior width
_FEW_INPUTS: Final = 15  # errors of the input that follow too
_OF_INERTIA: Final = ("m", "DV")
_UNSAID: Final = (
    "The file does not say how its channels were read, and a delay between them leaves {} open: "
    "give the columns sent_s and received_s, or Parquet with acquisition = captured in its provenance."
)
_TRIED: Final = (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0)  # prior widths


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """The model and point (p,) of the likelier hypothesis, what is known under both, and the weight of a delay.

    ``opened``: the symbols that only what some delay explains as well leaves unknown.
    """

    model: StemModel
    point: FloatArray
    knows: Knowledge | None
    weight: float
    opened: tuple[str, ...] = ()

    def unsaid(self, missing: list[str]) -> list[str]:
        """Return what the file does not say, where that is why some of the ``missing`` symbols are not given."""
        named = [symbol for symbol in missing if symbol in self.opened]
        return [_UNSAID.format(", ".join(named))] if named else []


def searched_model(problem: Problem, period_s: float) -> StemModel:
    """Return the model that is searched: without a delay first, where the recording does not tell of one."""
    if says_nothing(problem.model, period_s):
        return at_one_instant(problem.model, period_s)
    return within_belief(problem.model) if problem.jumps else problem.model


def at_one_instant(model: StemModel, period_s: float) -> StemModel:
    """Return the model in which the channels are read at one instant."""
    entries = tuple(
        replace(entry, prior_sd=ONE_INSTANT * period_s / entry.unit) if entry.name == DELAY else entry
        for entry in model.coordinates.entries
    )
    return replace(model, coordinates=Coordinates(entries))


def delayed(model: StemModel, free: StemModel) -> StemModel:
    """Return the model with the delay as free as it is in ``free``."""
    own = {entry.name: entry for entry in free.coordinates.entries}
    entries = tuple(own[DELAY] if entry.name == DELAY else entry for entry in model.coordinates.entries)
    return replace(model, coordinates=Coordinates(entries))


def within_belief(model: StemModel) -> StemModel:
    """Return the model whose delay is no further off than 5 standard deviations of what the recording says of it.

    A wrong trial falls out of step with the measured jumps, and a delay of a period puts it beside the next ones: that
    gains more than the delay's prior costs, so that both searches may end there.
    """
    entries = tuple(
        replace(
            entry,
            lower=max(entry.lower, entry.prior - _BELIEVED * entry.prior_sd),
            upper=min(entry.upper, entry.prior + _BELIEVED * entry.prior_sd),
        )
        if entry.name == DELAY
        else entry
        for entry in model.coordinates.entries
    )
    return replace(model, coordinates=Coordinates(entries))


def says_nothing(model: StemModel, period_s: float) -> bool:
    """Whether the recording does not say how its channels were read: the delay's prior is a period wide or more."""
    return any(
        entry.name == DELAY and entry.prior_sd * entry.unit > 0.9 * period_s for entry in model.coordinates.entries
    )


def weigh(free: StemModel, narrow: StemModel, point: FloatArray, ramps: Ramps, noise_factor: float) -> Weighed:
    """Weigh a delay against none, from the fit ``point`` (p,) without one, by Laplace's approximation.

    log odds of a delay = log(0.05/0.95) + (cost without - cost with)/2 + log(posterior over prior width). Between 1 and
    99 % what is known is the mixture of both: its mean and covariance. Where it is only the odds beforehand that speak
    against a delay (even ones would leave it 5 % or more), the intervals reach all that some delay explains as well:
    F_v, m or DV may stand in its place. Of rows that one fast clock took that is a delay to the nearest row at most,
    unless the cost itself shows one.
    """
    width_s = next(entry.prior_sd * entry.unit for entry in free.coordinates.entries if entry.name == DELAY)
    alone = known(narrow, point, ramps, noise_factor=noise_factor)
    small, most = compressed(free), Budget.of(free).most_at_once(free, _AT_ONCE)
    held = tuple(name for name in free.coordinates.names if name.startswith("input_"))
    found = descend(small, point, most_steps=_STEPS, held=held, one_sided=True)
    if small.cost(point) - found.cost > _WORTH_A_SEARCH * noise_factor**2:
        # a delay there is: friction took its place where it is not small, so that both have to move together
        for start in _other_starts(free, point, width_s, ramps):
            elsewhere = descend(small, start, most_steps=_STEPS, held=held, one_sided=True)
            found = elsewhere if elsewhere.cost < found.cost else found
        found = descend(small, found.point, most_steps=2 * _STEPS, held=held)
        found = descend_with_errors(free, found.point, most_steps=4 * _STEPS, most_simulations=most)
    else:
        found = descend_with_errors(free, found.point, most_steps=_LAST_STEPS, most_simulations=most)
    if not found.arrived and narrow.cost(point) - found.cost > _SHOWN * noise_factor**2:
        found = descend_with_errors(free, found.point, most_steps=4 * _STEPS, most_simulations=most)
    shifted = known(free, found.point, ramps, noise_factor=noise_factor)
    if alone is None or shifted is None:
        return Weighed(narrow, point, alone, 0.0)
    fall = (narrow.cost(point) - found.cost) / noise_factor**2
    is_near = fall <= _SHOWN and _is_of_one_clock(free.time_s)
    ends = _ends(small, found.point, held, noise_factor, _NEAREST_ROW * width_s if is_near else math.inf)
    widths = max([shifted.std_error(DELAY), *(abs(end[DELAY]) / NORMAL_95 for end in ends)]) / width_s
    evidence = 0.5 * fall + math.log(min(max(widths, 1.0e-300), 1.0))
    weight = _share(evidence + math.log(_FREE_BEFOREHAND / (1.0 - _FREE_BEFOREHAND)))
    if weight > 1.0 - _DECIDED:
        return Weighed(free, found.point, shifted, 1.0)
    undelayed, alone = alone, _with_inertia_as_open(alone, shifted)
    # what is no fast clock's reads one channel after the other: there is some delay, and the odds only say how small
    is_open = _share(evidence) > _FREE_BEFOREHAND or not _is_of_one_clock(free.time_s)
    if weight < _DECIDED and not is_open:
        return Weighed(narrow, point, alone, 0.0, _opened(undelayed, alone))
    knows = mixed([1.0 - weight, weight], [alone, shifted])
    if is_open:
        others = [dict(zip(one.symbols, one.values, strict=True)) for one in (alone, shifted)]
        knows = reaching(knows, [*others, *ends])
    likelier = (free, found.point) if weight > 0.5 else (narrow, point)
    return Weighed(*likelier, knows, weight, _opened(undelayed, knows))


def _opened(before: Knowledge, after: Knowledge) -> tuple[str, ...]:
    return tuple(s for s in after.symbols if before.identifiable(s) and not after.identifiable(s))


def _with_inertia_as_open(alone: Knowledge, shifted: Knowledge) -> Knowledge:
    """Return what is known without a delay, but no more of m and DV than with one, where that leaves them open.

    Of a stem whose m/F_v is shorter than a period the inertia is a delay of m/F_v and nothing else.
    """
    factor = np.ones(len(alone.symbols))
    for symbol in _OF_INERTIA:
        if alone.identifiable(symbol) and not shifted.identifiable(symbol):
            factor[alone.symbols.index(symbol)] = shifted.std_error(symbol) / alone.std_error(symbol)
    return replace(alone, covariance=alone.covariance * np.outer(factor, factor), _ties={})


def _is_of_one_clock(time_s: FloatArray) -> bool:
    """Whether rows, (n,), are as fast and even as a card's clock makes them, which reads a row within its period.

    What is slower or uneven was read one channel after the other, whenever each was answered.
    """
    step_s = np.diff(time_s)
    usual_s = float(np.median(step_s))
    return usual_s <= _FAST_S and float(np.median(np.abs(step_s - usual_s))) <= _EVEN * usual_s


def _share(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(max(log_odds, -700.0), 700.0)))


def _ends(
    small: StemModel, point: FloatArray, held: tuple[str, ...], noise_factor: float, longest_s: float
) -> list[dict[str, float]]:
    """Values by symbol at the longest delays either way that cost less than 3.84 more, all others following.

    It is the profile likelihood: under a delay F_v may go to its bound, and the curvature at the point says nothing.
    No delay is longer than ``longest_s``.
    """
    held = held if len(held) > _FEW_INPUTS else ()
    near = descend(small, point, most_steps=_STEPS, held=held, one_sided=True)
    entry = next(entry for entry in small.coordinates.entries if entry.name == DELAY)
    begun, ends = small.coordinates.values(near.point), []
    for sense in (1.0, -1.0):
        last = near.point
        for share in _PROFILED:
            values = small.coordinates.values(last)
            late_s = begun[DELAY] + sense * share * entry.prior_sd * entry.unit
            if sense * late_s > longest_s:
                break
            # the force acts later: the damping that delayed the stem is less
            viscous = max(values["F_v"] - values["k"] * (late_s - values[DELAY]), 0.1 * values["F_v"])
            starts = [small.coordinates.point(values | {DELAY: late_s, "F_v": own}) for own in (viscous, values["F_v"])]
            start = min(starts, key=small.cost)
            found = descend(small, start, most_steps=_STEPS, held=(DELAY, *held), one_sided=True)
            if found.cost > near.cost + _SHOWN * noise_factor**2:
                break
            last = found.point
        ends.append(natural_values(small, last))
    return ends


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
