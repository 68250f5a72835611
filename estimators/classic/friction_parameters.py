"""From the force balance in uniform motion to k, F_c, F_s and F_0 with their errors (either method's last step)."""

from __future__ import annotations

import math
from typing import Final

from estimators.base import (
    MOVED_TOO_LITTLE,
    NO_SPRING,
    NORMAL_95,
    Form,
    Outcome,
    ParameterEstimate,
    absent,
    digits_within,
    measured,
    offset_estimate,
)
from estimators.classic.transients import Transients
from estimators.motion.balance import Balance
from estimators.motion.static_friction import BreakawayForces
from valve.messages import Message, say
from valve.nameplate import Action

AT_BREAKAWAY: Final = say("at_breakaway", "no slip jump is seen; this is the friction at breakaway")
_SLIP_FREE: Final = say(
    "slip_free", "no slip jump is seen, and between F_c and the friction in motion it cannot be told"
)
_WITHOUT_STICTION: Final = say(
    "without_stiction", "no slip jump is seen, so it is taken equal to F_c (a valve without stiction)"
)
_SCATTER: Final = say("breakaways_scatter", "the breakaways scatter")
_MOVED_TOO_LITTLE_UNIFORMLY: Final = say("moved_too_little_uniformly", "the stem moved too little in uniform motion")
_NO_PRELOAD: Final = say(
    "published_without_preload", "the published form assumes that there is none: the corrected form fits it"
)
_SURE: Final = 3.0  # standard errors by which F_s must exceed the friction in motion to be called stiction


def friction_parameters(
    balance: Balance,
    transients: Transients,
    forces: BreakawayForces | None,
    one_way: Outcome = Outcome.ONE_DIRECTION_ONLY,
    sense: int = 1,
) -> tuple[dict[str, ParameterEstimate], list[Outcome]]:
    """Return k, F_c, F_s and F_0 by symbol, and what stands against any of them; ``one_way``: why only one was seen.

    ``sense`` is its direction: there F_c and F_0 are known together.
    """
    outcomes: list[Outcome] = []
    coulomb, coulomb_error = _coulomb(balance, transients)
    parameters = {"k": _spring(balance)}
    if balance.one_direction and balance.form is not Form.PUBLISHED:
        outcomes.append(one_way)
        tied = say("tied_to_preload", "{tied}: {why}", tied=_one_way_note(balance, sense), why=one_way.message)
        parameters |= {symbol: absent(tied) for symbol in ("F_c", "F_s", "F_0")}
        return parameters, outcomes
    if balance.one_direction:
        outcomes.append(one_way)
    slip_free = forces is None or not has_stiction(balance, forces)
    parameters["F_c"] = measured(
        coulomb,
        coulomb_error,
        note=_tied_note(balance, transients) if slip_free or transients.viscous.value is None else "",
        reason=_tied_note(balance, transients),
    )
    if forces is None:
        outcomes.append(Outcome.NO_BREAKAWAY)
        parameters["F_s"] = absent(Outcome.NO_BREAKAWAY.message)
    elif slip_free:
        parameters["F_s"] = _without_stiction(balance, coulomb, coulomb_error, forces)
    else:
        error = math.hypot(forces.std_error, 0.0 if balance.preload is None else balance.preload[1])
        parameters["F_s"] = measured(forces.value, error, reason=_SCATTER)
    parameters["F_0"] = _preload(balance)
    return parameters, outcomes


def _one_way_note(balance: Balance, sense: int) -> Message:
    """What is known of a motion in one direction: s (F - k x) is F_c + F_v v + s F_0 there.

    Nothing of a drive without a spring, whose speed a force that holds does not keep.
    """
    if balance.action is Action.DOUBLE:
        return say("one_direction_ties", "one direction shows it only together with the preload")
    friction_n, error_n = balance.friction[0], NORMAL_95 * balance.friction[1]
    digits = digits_within(error_n, friction_n)
    sign = "+" if sense > 0 else "-"
    if not balance.speed > 0.0:
        return say(
            "one_direction_knows",
            "one direction shows it only together with the preload, F_c {sign} F_0 = {force:.{digits}g N} is known "
            "to +-{half:.2g N}",
            sign=sign,
            force=friction_n,
            digits=digits,
            half=error_n,
        )
    return say(
        "one_direction_knows_at_speed",
        "one direction shows it only together with the preload, F_c + {speed:.3g m/s} * F_v {sign} F_0 = "
        "{force:.{digits}g N} is known to +-{half:.2g N}",
        speed=balance.speed,
        sign=sign,
        force=friction_n,
        digits=digits,
        half=error_n,
    )


def _spring(balance: Balance) -> ParameterEstimate:
    if balance.action is Action.DOUBLE:
        return ParameterEstimate(0.0, note=NO_SPRING)
    return measured(*balance.spring, reason=_MOVED_TOO_LITTLE_UNIFORMLY)


def _preload(balance: Balance) -> ParameterEstimate:
    if balance.preload is None:
        return absent(_NO_PRELOAD)
    return offset_estimate(*balance.preload, abs(balance.friction[0]), reason=MOVED_TOO_LITTLE)


def _coulomb(balance: Balance, transients: Transients) -> tuple[float, float]:
    viscous, viscous_error = transients.viscous_used
    value = balance.friction[0] - balance.speed * viscous
    return value, math.hypot(balance.friction[1], balance.speed * viscous_error)


def _tied_note(balance: Balance, transients: Transients) -> str:
    """What is known where F_c is told from F_v badly; nothing for a drive without a spring, which has other speeds."""
    if balance.action is Action.DOUBLE:
        return ""
    friction_n, error_n = balance.friction[0], NORMAL_95 * balance.friction[1]
    viscous_n = balance.speed * transients.viscous_used[0]
    digits = digits_within(error_n, viscous_n or friction_n)
    more = digits_within(error_n, friction_n)
    known = say(
        "known_at_speed",
        "F_c + {speed:.{digits}g m/s} * F_v = {force:.{more}g N} is known to +-{half:.2g N}",
        speed=balance.speed,
        digits=digits,
        force=friction_n,
        more=more,
        half=error_n,
    )
    if transients.viscous.value is None:
        return say(
            "tied_to_viscous", "{known}; at one speed of the ramps it is tied to F_v, which is not known", known=known
        )
    return say(
        "told_by_ramps_ends",
        "{known}; without a slip jump F_c is told from F_v by the ends of the ramps alone",
        known=known,
    )


def has_stiction(balance: Balance, forces: BreakawayForces) -> bool:
    """Whether the friction at breakaway surely exceeds that in motion, so that the stem jumps."""
    error = math.hypot(forces.std_error, balance.friction[1])
    return forces.value - balance.friction[0] > max(_SURE * error, 1.0e-3 * abs(balance.friction[0]))


def _without_stiction(
    balance: Balance, coulomb: float, coulomb_error: float, forces: BreakawayForces
) -> ParameterEstimate:
    """F_s = F_c for a valve without stiction, or the friction at breakaway where that is known better."""
    most = forces.value + forces.std_error
    error = math.hypot(coulomb_error, max(0.0, most - coulomb) / math.sqrt(3.0))
    direct = math.hypot(forces.std_error, 0.0 if balance.preload is None else balance.preload[1])
    if direct < error:
        return measured(forces.value, direct, note=AT_BREAKAWAY, reason=_SLIP_FREE)
    return measured(coulomb, error, note=_WITHOUT_STICTION, reason=_SLIP_FREE)
