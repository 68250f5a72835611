"""From the force balance in uniform motion to k, F_c, F_s and F_0 with their errors (either method's last step)."""

from __future__ import annotations

import math
from typing import Final

from estimators.base import (
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
from valve.nameplate import Action

AT_BREAKAWAY: Final = "no slip jump is seen; this is the friction at breakaway"
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
        tied = f"one direction shows it only together with the preload{_one_way_note(balance, sense)}"
        outcomes.append(one_way)
        parameters |= {symbol: absent(f"{tied}: {one_way}") for symbol in ("F_c", "F_s", "F_0")}
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
        parameters["F_s"] = absent(str(Outcome.NO_BREAKAWAY))
    elif slip_free:
        parameters["F_s"] = _without_stiction(balance, coulomb, coulomb_error, forces)
    else:
        error = math.hypot(forces.std_error, 0.0 if balance.preload is None else balance.preload[1])
        parameters["F_s"] = measured(forces.value, error, reason="the breakaways scatter")
    parameters["F_0"] = _preload(balance)
    return parameters, outcomes


def _one_way_note(balance: Balance, sense: int) -> str:
    """What is known of a motion in one direction: s (F - k x) is F_c + F_v v + s F_0 there.

    Nothing of a drive without a spring, whose speed a force that holds does not keep.
    """
    if balance.action is Action.DOUBLE:
        return ""
    friction_n, error_n = balance.friction[0], NORMAL_95 * balance.friction[1]
    digits = digits_within(error_n, friction_n)
    moving = f" + {balance.speed:.3g} m/s * F_v" if balance.speed > 0.0 else ""
    return f", F_c{moving} {'+' if sense > 0 else '-'} F_0 = {friction_n:.{digits}g} N is known to +-{error_n:.2g} N"


def _spring(balance: Balance) -> ParameterEstimate:
    if balance.action is Action.DOUBLE:
        return ParameterEstimate(0.0, note="taken as 0: the nameplate says that no spring opposes the stem")
    return measured(*balance.spring, reason="the stem moved too little in uniform motion")


def _preload(balance: Balance) -> ParameterEstimate:
    if balance.preload is None:
        return absent("the published form assumes that there is none: the corrected form fits it")
    return offset_estimate(*balance.preload, abs(balance.friction[0]), reason="the stem moved too little")


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
    known = f"F_c + {balance.speed:.{digits}g} m/s * F_v = {friction_n:.{more}g} N is known to +-{error_n:.2g} N"
    if transients.viscous.value is None:
        return f"{known}; at one speed of the ramps it is tied to F_v, which is not known"
    return f"{known}; without a slip jump F_c is told from F_v by the ends of the ramps alone"


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
    note = "no slip jump is seen, so it is taken equal to F_c (a valve without stiction)"
    return measured(coulomb, error, note=note, reason=_SLIP_FREE)


_SLIP_FREE: Final = "no slip jump is seen, and between F_c and the friction in motion it cannot be told"
