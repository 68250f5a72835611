"""Values that only stand in for others that the test does not show: they are not given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from estimators.base import ParameterEstimate, absent
from estimators.likelihood.compression import compressed
from estimators.likelihood.coordinates import Coordinates
from estimators.likelihood.descent import descend
from estimators.likelihood.model import StemModel
from estimators.likelihood.ramps import Ramps
from estimators.samples import FloatArray

_LIMIT_ALONE: Final = (
    "below DV the stem is accelerated undamped, above it F_v damps it: where neither m nor F_v shows, a DV near the "
    "speed of the ramps only stands in for them"
)
_LIMIT_WITH_STATIC: Final = (
    "it shows beside F_s at the breakaways, and F_s is not known; where the stem comes to rest it shows within "
    "micrometres, where the lines that the pressure is drawn with count as much"
)
_MAY_CREEP: Final = (
    "the stem may have crept below DV, where F_s alone is felt, and only what valves usually are speaks against that: "
    "repeat with a faster ramp"
)
_AT_AN_END: Final = "the fit takes it to the end of all masses that there are: it does not show"
_RINGS: Final = (
    "the stem that was fitted rings undamped with fewer than four rows a swing, and so does noise: "
    "capture in the device at 1 ms"
)
_LATE_PRESSURE: Final = (
    "near the speed of the ramps it does what a pressure does that was read late, and the file does not say how its "
    "channels were read: use ramps at several rates (sequence multi_rate)"
)
_OTHER_SPRINGS: Final = (0.75, 1.3)
_SPRING_STEPS: Final = 30
_AS_WELL: Final = 3.84  # of the cost: one value in twenty is as far off by chance
NEAR_SPEED: Final = 0.5  # of the ramp's
_QUARTER_TURN: Final = 0.5 * math.pi
_OF_MASS: Final = (0.5, 0.1)
_HARDLY_SWINGS: Final = 1.4  # F_v over the root of k m
_FEWEST_COULOMB: Final = 0.1
_AT_BOUND: Final = 0.01  # of a logarithm
# DV, of the slowest ramp's speed, and m, kg: the small jumps are as the root of it
_TRIED: Final = ((1.05, 3.0), (1.4, 3.0), (1.05, 0.2))
_VISCOUS_SHARE: Final = 0.2  # of the friction in motion; a stem below DV does not feel it
_MOST_EVENTS: Final = 12_000  # of small jumps
_NO_JUMP: Final = 0.01  # F_s beside the friction in motion, by that
_STEPS: Final = 10
_HOPELESS: Final = 4.0  # times what is asked: a start so far off does not come there
_NEARLY: Final = 25.0  # of the cost: small jumps that are out of step cost something too


def without_lone_limit(
    parameters: dict[str, ParameterEstimate], limit_m_per_s: float, slowest_m_per_s: float
) -> dict[str, ParameterEstimate]:
    """Return the parameters without a DV that only stands in for m and F_v, of which neither shows, or without F_s.

    Where F_v does not show, a DV near the speed of the slowest ramp, and the mass that goes with it, stand in for it.
    """
    stands_in = not parameters["F_v"].identifiable and limit_m_per_s > NEAR_SPEED * slowest_m_per_s
    if stands_in:
        parameters = parameters | {s: absent(_LIMIT_ALONE) for s in ("m", "DV") if parameters[s].identifiable}
    if parameters["DV"].identifiable and not parameters["F_s"].identifiable:
        return parameters | {"DV": absent(_LIMIT_WITH_STATIC)}
    if parameters["m"].identifiable or parameters["F_v"].identifiable or not parameters["DV"].identifiable:
        return parameters
    return parameters | {"DV": absent(_LIMIT_ALONE)}


def leaves_spring_open(model: StemModel, point: FloatArray, rests_m: tuple[float, float], noise_factor: float) -> bool:
    """Whether another spring rate explains jumps between these two places as well as that of this point (p,).

    F_s and F_0 keep the forces of both breakaways, and m, F_v and F_s - F_c go with k, so that every jump is the same:
    nothing tells k, though rounding makes its slopes look as if something did.
    """
    here, low_m, high_m = model.coordinates.values(point), *rests_m
    small = compressed(model, keeping=point)
    most = small.cost(point) + _AS_WELL * noise_factor**2
    for factor in _OTHER_SPRINGS:
        more = (factor - 1.0) * here["k"]
        static_n = here["F_c"] * (1.0 + here["d"]) + 0.5 * more * (high_m - low_m)
        coulomb_n = static_n - factor * here["F_c"] * here["d"]
        if coulomb_n <= 0.0:
            continue
        scaled = {name: factor * here[name] for name in ("m", "k", "F_v")}
        other = scaled | {"F_c": coulomb_n, "d": static_n / coulomb_n - 1.0}
        other["F_0"] = here["F_0"] - 0.5 * more * (low_m + high_m)
        start = small.coordinates.point(here | other)
        if descend(small, start, most_steps=_SPRING_STEPS, held=("k",)).cost < most:
            return True
    return False


def without_limit_of_late_pressure(parameters: dict[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """Return the parameters without a DV that a pressure which was read late may have made."""
    return parameters | ({"DV": absent(_LATE_PRESSURE)} if parameters["DV"].identifiable else {})


def without_mass_at_bound(
    parameters: dict[str, ParameterEstimate], model: StemModel, point: FloatArray
) -> dict[str, ParameterEstimate]:
    """Return the parameters without an m that went to the end of what it may be, at ``point`` (p,).

    The cost falls on to there, so that its bend at that place says nothing about how well m is known.
    """
    own = model.coordinates
    number = own.names.index("m")
    is_inside = own.lower[number] + _AT_BOUND < point[number] < own.upper[number] - _AT_BOUND
    return parameters if is_inside or not parameters["m"].identifiable else parameters | {"m": absent(_AT_AN_END)}


def without_mass_that_rings(
    parameters: dict[str, ParameterEstimate],
    model: StemModel,
    point: FloatArray,
    *,
    period_s: float,
    ramps: Ramps,
    noise_factor: float,
) -> dict[str, ParameterEstimate]:
    """Return the parameters without an m that only noise may show, in rows every ``period_s`` s.

    Of many masses whose swings have fewer than four rows, some fit a noise by chance better than the true one by 10 of
    the cost. It may be so where what damps the swing does not show, and a stem that hardly swings does nearly as well.
    """
    values = model.coordinates.values(point)
    rings = parameters["m"].identifiable and not parameters["F_v"].identifiable
    if not rings or period_s * math.sqrt(values["k"] / values["m"]) < _QUARTER_TURN:
        return parameters
    small = compressed(model)
    least = small.cost(point) + _NEARLY * noise_factor**2
    speed = min(ramps.rates_n_per_s, default=0.0) / values["k"]
    for share in _OF_MASS:
        mass_kg = share * values["m"]
        viscous = _HARDLY_SWINGS * math.sqrt(values["k"] * mass_kg)
        coulomb_n = max(values["F_c"] - (viscous - values["F_v"]) * speed, _FEWEST_COULOMB * values["F_c"])
        ratio = max(0.0, values["F_c"] * (1.0 + values["d"]) / coulomb_n - 1.0)
        start = small.coordinates.point(values | {"m": mass_kg, "F_v": viscous, "F_c": coulomb_n, "d": ratio})
        if descend(small, start, most_steps=_STEPS, held=("m",), one_sided=True).cost < least:
            return parameters | {"m": absent(_RINGS)}
    return parameters


def without_lone_coulomb(
    parameters: dict[str, ParameterEstimate], model: StemModel, point: FloatArray, ramps: Ramps, noise_factor: float
) -> dict[str, ParameterEstimate]:
    """Return the parameters without an F_c that may be F_s: of a stem that shows neither F_v nor DV at one speed."""
    asked = parameters["F_c"].identifiable and len(ramps.rates_n_per_s) == 1
    if not asked or parameters["F_v"].identifiable or parameters["DV"].identifiable:
        return parameters
    rate_n_per_s = ramps.rates_n_per_s[0]
    is_open = _is_static(parameters["F_s"], model.coordinates.values(point), rate_n_per_s)
    is_open = is_open or may_creep(model, point, rate_n_per_s, noise_factor)
    return parameters | {"F_c": absent(_MAY_CREEP)} if is_open else parameters


def _is_static(static: ParameterEstimate, values: Mapping[str, float], rate_n_per_s: float) -> bool:
    """Whether the friction in motion is F_s, as that of a stem slower than DV is; one with no slip jump may be one."""
    if static.value is None:
        return False
    friction_n = values["F_c"] + values["F_v"] * rate_n_per_s / values["k"]
    return abs(static.value - friction_n) < _NO_JUMP * friction_n


def may_creep(model: StemModel, point: FloatArray, rate_n_per_s: float, noise_factor: float) -> bool:
    """Whether a stem slower than DV explains the rows nearly as well as ``point`` (p,), beliefs about DV aside.

    It feels F_s in motion, so that F_s is what F_c + F_v v was, at the speed v of a ramp with this rate of the force.
    """
    small = with_any_limit(compressed(replace(model, most_events=max(model.most_events, _MOST_EVENTS))))
    values = model.coordinates.values(point)
    speed = rate_n_per_s / values["k"]
    friction_n = values["F_c"] + values["F_v"] * speed
    least = _without_belief(small, point, small.cost(point)) + _NEARLY * noise_factor**2
    for limit, mass_kg in _TRIED:
        coulomb_n = (1.0 - _VISCOUS_SHARE) * friction_n
        rival = {
            "m": mass_kg,
            "DV": limit * speed,
            "F_v": _VISCOUS_SHARE * friction_n / speed,
            "F_c": coulomb_n,
            "d": friction_n / coulomb_n - 1.0,
        }
        start = small.coordinates.point(values | rival)
        if not small.cost(start) < _HOPELESS * least:
            continue
        found = descend(small, start, most_steps=_STEPS, held=("DV",), one_sided=True)
        if _without_belief(small, found.point, found.cost) < least:
            return True
    return False


def with_any_limit(model: StemModel) -> StemModel:
    """Return the model in which DV may be above the speed of every ramp."""
    entries = tuple(
        replace(entry, upper=math.inf) if entry.name == "DV" else entry for entry in model.coordinates.entries
    )
    return replace(model, coordinates=Coordinates(entries))


def _without_belief(model: StemModel, point: FloatArray, cost: float) -> float:
    """The cost without what is believed of DV beforehand."""
    own = model.coordinates
    number = own.names.index("DV")
    return cost - float(own.prior_weight[number] * (point[number] - own.prior[number]) ** 2)
