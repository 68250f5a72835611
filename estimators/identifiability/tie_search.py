"""The search for what keeps a parameter from being identifiable: a tie to others, or too little of it in the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from estimators.base import LARGEST_RELATIVE_HALF_WIDTH, MOVED_TOO_LITTLE, NORMAL_95, NOT_BETTER, Outcome
from estimators.identifiability.known_ties import KNOWN_TIES, MEASURE, effective_breakaway
from estimators.identifiability.ties import INPUT_TIMES, Quantities, Tie
from valve.messages import say
from valve.parameters import PARAMETER_SYMBOLS

TIED: Final = 0.99  # correlation beyond which two parameters are one to the data (a 1/7 of the error is left)
_MOST_PARTNERS: Final = 3
# Damped so much beyond critical (F_v^2 = 4 k m) that inertia is over before anything moves.
_MASS_HIDDEN: Final = 100.0
_MOVE: Final = say("move_in_more_ways", "sequence multi_rate moves the stem in more ways")
_MEASURE_AND_MOVE: Final = say("measure_and_use_multi_rate", "{measure}, and use sequence multi_rate", measure=MEASURE)
_LAG_HIDES: Final = say(
    "unknown_lag_hides",
    "the unknown lag of the transducer hides it; {measure}, or use ramps at several rates",
    measure=MEASURE,
)


def find_tie(symbol: str, known: Quantities) -> Tie | None:
    """Return the tie that keeps ``symbol`` from being identifiable; None where no tie does."""
    if _hides(symbol, known):
        return None
    others = sorted(
        (other for other in known.symbols if other != symbol),
        key=lambda other: abs(known.correlation(symbol, other)),
        reverse=True,
    )
    tied = [other for other in others if abs(known.correlation(symbol, other)) > TIED]
    for other in sorted(tied, key=lambda one: KNOWN_TIES.get(frozenset((symbol, one))) is None):
        if _explains(symbol, [other], known):
            return _pair(symbol, other, known)
    partners: list[str] = []
    while len(partners) < min(_MOST_PARTNERS, len(others)):
        rest = [other for other in others if other not in partners]
        partners.append(max(rest, key=lambda other: known.best(symbol, [*partners, other])[2]))
        if len(partners) > 1 and known.best(symbol, partners)[2] > TIED and _explains(symbol, partners, known):
            breakaway = {symbol, *partners} == {"F_s", "DV", "m"}
            tie = effective_breakaway(symbol, "F_s" if symbol == "DV" else "DV", known) if breakaway else None
            return _several(symbol, partners, known) if tie is None else tie
    return None


def _explains(symbol: str, partners: Sequence[str], known: Quantities) -> bool:
    """Whether the symbol would be identifiable if its partners were known."""
    error = known.best(symbol, partners)[1]
    return NORMAL_95 * error <= LARGEST_RELATIVE_HALF_WIDTH * abs(known.value(symbol))


def _pair(symbol: str, other: str, known: Quantities) -> Tie:
    kind = KNOWN_TIES.get(frozenset((symbol, other)))
    tie = None if kind is None else kind(symbol, other, known)
    return _several(symbol, [other], known) if tie is None else tie


def _several(symbol: str, partners: Sequence[str], known: Quantities) -> Tie:
    """The best known linear combination."""
    weights, error, correlation = known.best(symbol, partners)
    if len(partners) == 1:
        correlation = known.correlation(symbol, partners[0])
    value = known.value(symbol) + float(weights @ np.array([known.value(partner) for partner in partners]))
    terms = "".join(_term(float(weight), partner) for weight, partner in zip(weights, partners, strict=True))
    times = [partner for partner in (symbol, *partners) if partner in INPUT_TIMES]
    remedy = _MEASURE_AND_MOVE if times else _MOVE
    return Tie((symbol, *partners), correlation, symbol + terms, value, error, _unit(symbol), remedy)


def _term(weight: float, symbol: str) -> str:
    size = f"{abs(weight):.4g}"
    return f" {'+' if weight >= 0.0 else '-'} {symbol if size == '1' else f'{size} {symbol}'}"


def _unit(symbol: str) -> str:
    if symbol in PARAMETER_SYMBOLS:
        return PARAMETER_SYMBOLS[symbol].unit
    return "m" if symbol == "x_0" else "s"


_REASONS: Final = {
    "m": say(
        "accelerates_too_briefly", "the stem accelerates too briefly for it to show at this noise and sampling rate"
    ),
    "F_v": say("slides_too_slowly", "the stem slides too slowly for it to show"),
    "F_c": say("slides_too_little", "the stem slides too little for it to show"),
    "F_s": say("breakaways_show_little", "the breakaways show too little of it at this noise and sampling rate"),
    "DV": say("less_than_noise", "it moves the stem less than the noise"),
    "k": MOVED_TOO_LITTLE,
    "F_0": MOVED_TOO_LITTLE,
}


def lone_reason(symbol: str, known: Quantities) -> str:
    """Return why a symbol that is tied to no other is not identifiable, and what would help."""
    if _hides(symbol, known):
        return Outcome.MASS_HIDDEN.message.formed("clause")
    if symbol in {"F_v", "F_c", "F_s"} and "transducer_lag_s" in known.symbols:
        return _LAG_HIDES
    reason = _REASONS.get(symbol, NOT_BETTER)
    if symbol in {"k", "F_0", "F_c"}:
        return say("use_larger_amplitude", "{why}; use a larger amplitude", why=reason)
    if len(known.ramp_rates_n_per_s) == 1:
        return say("use_several_rates", "{why}; use ramps at several rates (sequence multi_rate)", why=reason)
    return say("sample_faster", "{why}; sample faster, or use a quieter position sensor", why=reason)


def _hides(symbol: str, known: Quantities) -> bool:
    """Whether this is the mass of a stem damped so strongly that only its balance of forces can be seen."""
    if symbol != "m" or not {"k", "F_v"} <= set(known.symbols):
        return False
    return known.value("F_v") ** 2 > 4.0 * _MASS_HIDDEN * known.value("k") * known.value("m")
