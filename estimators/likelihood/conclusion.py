"""How a fit is concluded: values with intervals, what is not known and why, status, message and diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from estimators.base import (
    ONE_WAY,
    Estimate,
    Outcome,
    ParameterEstimate,
    Status,
    absent,
    in_order,
    measured,
    offset_estimate,
)
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.all_rows import EXACT, certified
from estimators.likelihood.arrival import arrived, led_to
from estimators.likelihood.dead_time import about_middle_dead_time
from estimators.likelihood.delay import DELAY, Weighed, delayed, says_nothing, weigh
from estimators.likelihood.doubts import doubt_of
from estimators.likelihood.far_places import is_lowest_tooth
from estimators.likelihood.gauge_lag import hidden_lateness_s, known_lateness_s, least_errors
from estimators.likelihood.intervals import CHECKED, Flatness, flat_errors, inflation, known, natural_values
from estimators.likelihood.jump_lengths import coulomb_error_n, of_jumps
from estimators.likelihood.micro_jumps import hidden_micro_jumps_n
from estimators.likelihood.model import StemModel
from estimators.likelihood.optima import others_apart, with_others
from estimators.likelihood.problem import Problem
from estimators.likelihood.ramps import ramps_of
from estimators.likelihood.search import Found
from estimators.likelihood.staircase import tells_spring
from estimators.likelihood.stand_ins import (
    leaves_spring_open,
    without_limit_of_late_pressure,
    without_lone_coulomb,
    without_lone_limit,
    without_mass_at_bound,
    without_mass_that_rings,
)
from estimators.likelihood.valley_of_jumps import is_charted
from estimators.motion.balance import heaviest_believed_kg
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from valve.parameters import PARAMETER_SYMBOLS

_SURE_OF_DELAY: Final = 0.99
_SLOW_SAMPLING_S: Final = 2.0e-3
_IN_THE_VALLEY: Final = ("m", "F_v", "F_c", "F_s", "DV")
_LED: Final = 2  # times to what a walk along the valley finds lower
_LED_OF_JUMPS: Final = 3  # whose valley is long and bent


def conclude(method: str, motion: RecordedMotion, problem: Problem, found: Found) -> Estimate:
    """Return the estimate: ok where the fit explains the recording and all but DV and a hidden m is known."""
    assessed, is_comb = _assessed(motion, problem, found), False
    for _ in range(_LED_OF_JUMPS if problem.jumps else _LED):
        if assessed.flatness.is_lowest or assessed.found.certificate.ratio < EXACT:
            break
        led = led_to(assessed.found, assessed.flatness.lowest, jumps=problem.jumps)
        if led is None:
            break
        assessed = _assessed(motion, problem, led)
        is_comb = assessed.creeps or (problem.jumps and not is_charted(led.model, led.point))
        if is_comb:
            break
    found, weighed, factor, flatness = assessed.found, assessed.weighed, assessed.factor, assessed.flatness
    knows = assessed.knows
    # of a comb of minima one that was left for a lower one may have a lower one still
    is_bottom = assessed.is_bottom and not is_comb
    model, point = weighed.model, weighed.point
    period_s, ramps = motion.samples.period_s, ramps_of(motion)
    noise_m = problem.noise_m * found.noise_factor
    residual = _residuals(model, point)
    values = natural_values(model, point)
    if knows is not None:
        values = dict(zip(knows.symbols, knows.values, strict=True))
    rms_m = float(np.sqrt(np.mean(((residual / model.weight)[model.weight > 0.0]) ** 2)))
    explained = found.certificate.is_good or (problem.is_noise_free and rms_m < 1.0e-6 * model.range_m)
    if not explained and not found.certificate.is_near and not problem.is_noise_free:
        knows = None
    least = flatness.least
    hidden_n = 0.0 if problem.jumps else hidden_micro_jumps_n(model, point, motion)
    if hidden_n > 0.0:
        least = least | {"F_0": hidden_n, "k": hidden_n / model.range_m}
    if problem.jumps:
        apart = others_apart(model, point, found)
        least = {symbol: max(least.get(symbol, 0.0), apart.get(symbol, 0.0)) for symbol in CHECKED}
        least = of_jumps(least, values, ramps.rates_n_per_s)
    is_delayed = weighed.weight > _SURE_OF_DELAY
    is_silent = says_nothing(problem.model, period_s) and not (is_delayed or problem.is_noise_free)
    hidden_s = hidden_lateness_s(values, ramps) if is_silent and not motion.command_only else 0.0
    late_s = max(hidden_s, known_lateness_s(values, period_s, is_delayed=is_delayed))
    of_lateness = least_errors(late_s, min(ramps.rates_n_per_s, default=0.0))
    least = least | {symbol: max(least.get(symbol, 0.0), error) for symbol, error in of_lateness.items()}
    parameters = {symbol: _parameter(symbol, values, knows, least.get(symbol, 0.0)) for symbol in PARAMETER_SYMBOLS}
    if problem.jumps and knows is not None and not parameters["F_v"].identifiable:
        viscous_error = max(knows.std_error("F_v"), least["F_v"])
        beyond_n = coulomb_error_n(values, viscous_error if parameters["m"].identifiable else math.inf)
        parameters["F_c"] = _parameter("F_c", values, knows, max(least["F_c"], beyond_n))
    # a nameplate may have too small a mass
    heaviest_kg = heaviest_believed_kg(motion.moving_mass_kg, float(np.ptp(motion.samples.force_n)))
    is_too_heavy = parameters["m"].identifiable and values["m"] > heaviest_kg
    # without noise the cost itself tells them apart
    slowest = math.inf if problem.is_noise_free else min(ramps.rates_n_per_s, default=math.inf) / values["k"]
    parameters = without_lone_limit(without_mass_at_bound(parameters, model, point), values["DV"], slowest)
    # jumps are far larger than noise
    if not (problem.is_noise_free or problem.jumps):
        parameters = without_mass_that_rings(
            parameters, model, point, period_s=period_s, ramps=ramps, noise_factor=factor
        )
    if hidden_s > 0.0:
        parameters = without_limit_of_late_pressure(parameters)
    if not (problem.jumps or motion.command_only):
        parameters = without_lone_coulomb(parameters, model, point, ramps, factor)
    # without noise the blocks are coarser than the fit, and the bottom is beyond what is computed
    is_bottom &= flatness.is_lowest or found.certificate.ratio < EXACT
    is_bottom |= problem.is_noise_free and found.certificate.ratio < 1.0
    strained, tells = strain(model, point), tells_spring(motion)
    doubt = doubt_of(
        is_bottom=is_bottom,
        is_spring_open=not tells and leaves_spring_open(model, point, _farthest_rests(motion), factor),
        hides=hidden_n > 0.0,
        is_confirmed=found.is_confirmed,
        strain=strained,
        is_too_heavy=is_too_heavy,
    )
    if doubt:
        open_too = _IN_THE_VALLEY if tells else (*_IN_THE_VALLEY, "k", "F_0")
        parameters |= {symbol: absent(doubt) for symbol in open_too if parameters[symbol].identifiable}
    complete = in_order(parameters)
    outcomes = _outcomes(motion, complete, values)
    missing = [symbol for symbol, entry in complete.items() if entry.value is None and symbol != "DV"]
    sentences = [str(outcome) for outcome in outcomes]
    if not explained:
        sentences.append(_misfit(rms_m, noise_m, problem.is_noise_free, found, gives=knows is not None))
    if doubt:
        sentences.append(f"{doubt[0].upper()}{doubt[1:]}.")
    if missing:
        sentences += [f"Not given: {', '.join(missing)}.", *weighed.unsaid(missing)]
    if is_delayed:
        late = "later" if values[DELAY] > 0.0 else "earlier"
        sentences.append(f"The force acts {1.0e3 * abs(values[DELAY]):.3g} ms {late} than its samples' times say.")
    hidden = {"m"} if Outcome.MASS_HIDDEN in outcomes else set()
    poor = (ONE_WAY | {Outcome.COMMAND_ONLY}) & set(outcomes)
    status = Status.OK if explained and not doubt and not set(missing) - hidden and not poor else Status.POOR
    if complete["k"].value is None and complete["F_c"].value is None:
        status = Status.FAILED
    diagnostics: dict[str, Any] = {
        "outcomes": [outcome.name for outcome in outcomes],
        "fitted": values,
        "noise_m": noise_m,
        "misfit_over_noise": found.certificate.ratio,
        "largest_piece": found.certificate.piece,
        "strain_of_input": strained,
        "kinship_of_neighbours": found.certificate.kinship,
        "unevenness": found.certificate.unevenness,
        "std_error_factor": factor,
        "weight_of_delay": weighed.weight,
        "corners": [column.tolist() for column in model.corners(model.coordinates.values(point))],
        "cost": found.cost,
        "starts": found.starts,
        "simulations": found.simulations,
        "stops_m": None if motion.stops is None else [values.get("low", -math.inf), values.get("high", math.inf)],
        "stand_ins": {symbol: values[symbol] for symbol, entry in complete.items() if entry.value is None},
    }
    return Estimate(method, status, " ".join(sentences), rms_m, complete, diagnostics)


def _farthest_rests(motion: RecordedMotion) -> tuple[float, float]:
    """Return the two places farthest apart from which the stem broke away, m."""
    rests_m = [breakaway.rest_m for breakaway in motion.phases.breakaways]
    return min(rests_m, default=0.0), max(rests_m, default=0.0)


def strain(model: StemModel, point: FloatArray) -> float:
    """Return the largest error of the measured input that the fit asks for, in standard deviations of its noise."""
    count = len(model.deviations)
    return float(np.abs(point[point.size - count :]).max(initial=0.0)) if count else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Assessed:
    """A fit, what is known at it, and whether it is where its cost is lowest."""

    found: Found
    is_bottom: bool
    factor: float
    weighed: Weighed
    knows: Knowledge | None
    flatness: Flatness
    creeps: bool


def _assessed(motion: RecordedMotion, problem: Problem, found: Found) -> _Assessed:
    """Go down from the fit if it is on a slope, weigh a delay and the other places, and walk along its valley."""
    period_s = motion.samples.period_s
    before = found
    found, is_bottom = arrived(found, jumps=problem.jumps)
    searched = found.model
    if found.cost < before.cost:
        found = replace(found, certificate=certified(searched, found.point))
    factor, ramps = inflation(_residuals(searched, found.point), searched.weight), ramps_of(motion)
    if says_nothing(problem.model, period_s) and found.certificate.ratio >= EXACT:
        weighed = weigh(delayed(searched, problem.model), searched, found.point, ramps, factor)
        if weighed.weight > _SURE_OF_DELAY:
            # the fit that is given is the delayed one: the other may misfit wherever the stem accelerates
            found = replace(found, certificate=certified(weighed.model, weighed.point))
    else:
        weighed = Weighed(searched, found.point, known(searched, found.point, ramps, noise_factor=factor), 0.0)
    knows = weighed.knows
    if knows is not None:
        knows = with_others(weighed.model, knows, found, ramps, factor)
    model, point = weighed.model, weighed.point
    values = model.coordinates.values(point)
    # a ramp slower than DV is followed in jumps, however small
    slowest = min(ramps.rates_n_per_s, default=math.inf) / values["k"]
    creeps = values["DV"] > slowest
    # thousands of jumps too small to see make teeth of the cost that are closer than any search tells apart
    is_bottom &= not creeps or replace(model, most_events=problem.model.most_events).simulate(point) is not None
    is_bottom &= not creeps or problem.is_noise_free or is_lowest_tooth(model, point)
    # of several places the mean is given already
    about_middle = knows is not None and knows is weighed.knows and weighed.weight == 0.0
    # without noise a DV is where the cost is lowest, however flat it looks beside what is computed
    about_middle &= found.certificate.ratio >= EXACT and not problem.is_noise_free
    flatness = flat_errors(
        model,
        point,
        noise_factor=factor,
        jumps=problem.jumps,
        creeps=creeps,
        about_middle=about_middle,
        slowest_m_per_s=slowest,
        doubted=() if knows is None or problem.jumps or problem.is_noise_free else _doubted(knows),
    )
    if flatness.to_middle is not None:
        knows = known(model, point + flatness.to_middle, ramps, noise_factor=factor) or knows
    if knows is not None:
        knows = about_middle_dead_time(knows, model, point, factor)
    return _Assessed(found, is_bottom, factor, weighed, knows, flatness, creeps)


def _doubted(knows: Knowledge) -> tuple[str, ...]:
    """Return the unknowns that the slopes may say more of than the cost: DV, and m where F_v is not known."""
    doubted = ["DV"] if knows.identifiable("DV") else []
    if knows.identifiable("m") and not knows.identifiable("F_v"):
        doubted.append("m")
    return tuple(doubted)


def _residuals(model: StemModel, point: FloatArray) -> FloatArray:
    residual = model.residuals(point)
    if residual is None:
        raise RuntimeError("the fitted valve cannot be followed any more")  # it was, in the search
    return residual


def _parameter(symbol: str, values: dict[str, float], knows: Knowledge | None, least_error: float) -> ParameterEstimate:
    if knows is None:
        return absent("the model does not explain the recording, so that no value of it can be trusted")
    value, error, reason = values[symbol], max(knows.std_error(symbol), least_error), knows.note(symbol)
    if symbol == "F_0":
        return offset_estimate(value, error, values["F_c"], reason=reason)
    return measured(value, error, reason=reason)


def _outcomes(
    motion: RecordedMotion, complete: dict[str, ParameterEstimate], values: dict[str, float]
) -> list[Outcome]:
    found = []
    if motion.one_direction:
        found.append(motion.one_way_outcome)
    if motion.stops is not None:
        found.append(Outcome.STOP_INSIDE_SWEEP)
    if complete["m"].value is None and complete["k"].value is not None:
        is_overdamped = values["F_v"] ** 2 > 4.0 * values["k"] * values["m"]
        if is_overdamped and complete["F_v"].value is not None:
            found.append(Outcome.MASS_HIDDEN)
        elif motion.samples.period_s > _SLOW_SAMPLING_S:
            found.append(Outcome.TRANSIENTS_NOT_RESOLVED)
    if motion.command_only:
        found.append(Outcome.COMMAND_ONLY)
    return found


def _misfit(rms_m: float, noise_m: float, is_noise_free: bool, found: Found, *, gives: bool) -> str:
    if is_noise_free:
        return (
            f"The model leaves {1.0e6 * rms_m:.3g} um of a position without noise unexplained: "
            "the valve does something else besides, or the force is not what moved it."
        )
    return (
        f"The model does not explain the recording: its misfit is {found.certificate.ratio:.3g} times the position's "
        f"noise of {1.0e6 * noise_m:.3g} um, and {found.certificate.piece:.3g} standard deviations at its "
        f"worst place. {'The intervals are widened by that: t' if gives else 'T'}he valve does something else besides, "
        "a channel is wrong, or the position's noise is not white, as behind a filter."
    )
