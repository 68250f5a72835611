"""The ties that physics explains: each says in a technician's words what is known instead."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from estimators.base import digits_within
from estimators.identifiability.ties import INPUT_TIMES, Quantities, Tie
from valve.messages import say

SEVERAL_RATES: Final = say("several_rates", "ramps at several rates tell them apart (sequence multi_rate)")
BOTH_WAYS: Final = say("both_ways", "a stroke and its way back tell them apart (sequence triangle)")
MEASURE: Final = say("measure_pressure", "measure the pressure at the actuator")
_RATES_OR_PRESSURE: Final = say("rates_or_pressure", "{rates}, or {pressure}", rates=SEVERAL_RATES, pressure=MEASURE)
_ALIKE: Final = 0.3  # a speed or rate that a tie implies, against those of the test
_LEFT: Final = 0.3  # of a friction's error, where a sum of forces is what is known


def _sliding_friction(symbol: str, other: str, known: Quantities) -> Tie | None:
    """F_c + v F_v: all that sliding at one speed v shows."""
    weights, error, _ = known.best("F_c", ["F_v"])
    speed = float(weights[0])
    if not _among(speed, known.sliding_speeds_m_per_s):
        return None
    digits = digits_within(error, speed * known.value("F_v"))
    return Tie(
        (symbol, other),
        known.correlation("F_c", "F_v"),
        "F_c + v F_v",
        known.value("F_c") + speed * known.value("F_v"),
        error,
        "N",
        SEVERAL_RATES,
        say(
            "sliding_friction",
            "the friction while the stem slides at {speed:.{digits}g mm/s}",
            speed=speed,
            digits=digits,
        ),
    )


def effective_breakaway(symbol: str, other: str, known: Quantities) -> Tie | None:
    """F_s + sqrt(2 m DV r): the force at which the stem leaves the band when it rises by r.

    In the band m v' = r t, so v = r t^2 / (2 m) reaches DV when the force has grown by r t = sqrt(2 m DV r).
    """
    if "m" not in known.symbols:
        return None
    mass_kg, limit_m_per_s = known.value("m"), known.value("DV")
    rates = known.ramp_rates_n_per_s
    if not rates:
        # the weight of DV is the square root's derivative
        rates = (2.0 * limit_m_per_s * float(known.best("F_s", ["DV"])[0][0]) ** 2 / mass_kg,)

    def error_n(rate: float) -> float:
        root = math.sqrt(2.0 * mass_kg * limit_m_per_s * rate)
        return known.error({"F_s": 1.0, "DV": 0.5 * root / limit_m_per_s, "m": 0.5 * root / mass_kg})

    rate = min(rates, key=error_n)
    correlation = known.correlation("F_s", "DV")
    if correlation > 0.0 or error_n(rate) > _LEFT * known.error({"F_s": 1.0}):
        return None
    return Tie(
        (symbol, other),
        correlation,
        "F_s + sqrt(2 m DV r)",
        known.value("F_s") + math.sqrt(2.0 * mass_kg * limit_m_per_s * rate),
        error_n(rate),
        "N",
        SEVERAL_RATES,
        say(
            "breakaway_at_rate",
            "the force that breaks the stem away when it rises by {rate:.3g N/s}",
            rate=rate,
        ),
    )


def _friction_one_way(symbol: str, other: str, known: Quantities) -> Tie | None:
    """F + F_0 or F - F_0: friction and preload add up, or cancel, where the stem moves in one direction only."""
    force = other if symbol == "F_0" else symbol
    sense = math.copysign(1.0, float(known.best(force, ["F_0"])[0][0]))
    error = known.error({force: 1.0, "F_0": sense})
    if error > _LEFT * known.error({force: 1.0}):
        return None
    return Tie(
        (symbol, other),
        known.correlation(force, "F_0"),
        f"{force} {'+' if sense > 0.0 else '-'} F_0",
        known.value(force) + sense * known.value("F_0"),
        error,
        "N",
        BOTH_WAYS,
        say("friction_and_preload", "friction and preload in the one direction that shows")
        if sense > 0.0
        else say("friction_less_preload", "friction less preload in the one direction that shows"),
    )


def _lagging_friction(symbol: str, other: str, known: Quantities) -> Tie | None:
    """F + r T: an input that is late by T looks like friction on ramps of the force rate r."""
    force, late = (symbol, other) if other in INPUT_TIMES else (other, symbol)
    weights, error, _ = known.best(force, [late])
    rate = float(weights[0])
    if not _among(rate, known.ramp_rates_n_per_s):
        return None
    return Tie(
        (symbol, other),
        known.correlation(force, late),
        f"{force} + r T",
        known.value(force) + rate * known.value(late),
        error,
        "N",
        _RATES_OR_PRESSURE,
        say("friction_and_lateness", "friction and lateness T together on ramps of {rate:.3g N/s}", rate=rate),
    )


KNOWN_TIES: Final[dict[frozenset[str], Callable[[str, str, Quantities], Tie | None]]] = {
    frozenset(("F_c", "F_v")): _sliding_friction,
    frozenset(("F_s", "DV")): effective_breakaway,
    **{frozenset((force, "F_0")): _friction_one_way for force in ("F_c", "F_s")},
    **{frozenset((force, late)): _lagging_friction for force in ("F_c", "F_s") for late in INPUT_TIMES},
}


def _among(value: float, those: Sequence[float]) -> bool:
    """Whether ``value`` is one of those of the test, about; where none are told, whether it can be one."""
    if not those:
        return value > 0.0
    return any(abs(value - one) <= _ALIKE * one for one in those)
