"""The way to the fit of a friction that falls with speed: its cost has a narrow, bent valley.

The Stribeck speed v_s, F_c, F_v and F_s go together: friction at the speeds that occur is known well, and which law it
follows much worse. Steps of all unknowns leave such a valley; steps of v_s beside the same friction follow it.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from discrepancy.baseline import DYNAMIC, LIMIT_MEDIAN, STATIC_SCAN, scanned
from discrepancy.causes.base import Setting, Values
from discrepancy.causes.friction import STRIBECK
from discrepancy.growing import Pace, as_good, fewest_blocks_s, grown
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.setting import setting_of
from discrepancy.sliding import sliding_rows, steady_valve
from discrepancy.walking import walked

SPEED: Final = STRIBECK.own(STRIBECK.strength)
# Own choices.
_FACTORS: Final = (1.15, 1.0 / 1.15, 1.04, 1.0 / 1.04)  # of v_s: first the wide valley, then its bottom
_STEPS: Final = 6
_SPEEDS: Final = 41
_SLOWEST: Final = 1.0e-3  # of the fastest
_RAMPS: Final = 3.0  # times their speed: the stem is as fast as that when it breaks away
_WIDE: Final = 0.2  # of the ramps' speed, above which DV stands in for something: valves have a tenth or less
# v_s, times DV, half an octave apart where it usually is: a start an octave away keeps its slips out of phase.
_SPEEDS_OF_LIMIT: Final = (0.7, 1.0, 0.5, 1.4, 2.0, 4.0)
_BLUR_S: Final = 0.1
_BLURRED_STEPS: Final = 6
_SHARP_STEPS: Final = 8
_FOLLOWED: Final = 2
_SHARES_OF_SPEED: Final = (0.7, 1.5, 0.3)  # v_s, of the usual speed
_DROPS: Final = (0.25, 0.1, 0.5)  # of F_s to F_c
_LEAST_VISCOUS: Final = 0.02  # of the friction at the usual speed
_SLIPS_SEEN_S: Final = 8.0e-3  # between rows, below which a slip far above critical damping shows its course
# Of slips that damping makes slow: how many times critical, and starts from the graphite valves of 9409 and 9262.
_SLOW: Final = 10.0
_SHARES_OF_SLOW: Final = (0.7, 1.4)
_DROPS_OF_SLOW: Final = (0.5, 1.0)
_VISCOUS_OF_SLOW: Final = (0.4, 1.0)  # of the plain valve's F_v
_RELAXATIONS: Final = 2.4  # F_v/k of the plain valve, that the first part is long
_SLOW_GROWTH: Final = 1.6
_RINGING: Final = 0.05  # of critical: with less damping a stem rings from one slip to the next
_SHARES_OF_SLOWEST: Final = (0.15, 0.3, 0.6, 1.2)  # v_s, of the slowest steady motion
_MOST_WORK: Final = 1.5e7  # passes, after which no other start is tried: many small steps take ten times as much


def has_wide_limit(fit: Fit, setting: Setting) -> bool:
    """Whether the plain valve's DV is so wide that it stands in for another law, as a falling friction's."""
    return fit.values["DV"] > _WIDE * setting.sliding_m_per_s


def may_ring(fit: Fit, setting: Setting) -> bool:
    """Whether the plain valve has next to no damping, or a DV so wide, as stands in for a friction that falls."""
    values = fit.values
    is_free = values["F_v"] < 2.0 * _RINGING * math.sqrt(values["m"] * values["k"])
    return is_free or has_wide_limit(fit, setting)


def from_wide_limit(fit: Fit, model: Model, setting: Setting) -> Fit | None:
    """Return the lowest fit of a ``model`` with the falling friction that begins where the plain valve's DV is.

    Friction is F_s up to DV in a Karnopp valve: where it falls with speed, the best DV is near v_s, and all forces are
    those of the valve already. Only DV, v_s and the mass, which takes up what a step of friction does to a slip, begin
    anew. None where no start can be followed.
    """
    last = model.tally.work + _MOST_WORK
    own = fit.values
    masses_kg = {own["m"], setting.observed.motions[0].moving_mass_kg or own["m"]}
    limit = min(LIMIT_MEDIAN * setting.sliding_m_per_s, own["DV"])
    begun: list[Fit] = []
    for factor, mass_kg in product(_SPEEDS_OF_LIMIT, sorted(masses_kg)):
        if begun and model.tally.work > last:
            break
        start = start_fit(model, model.unknowns.point({**own, SPEED: factor * own["DV"], "DV": limit, "m": mass_kg}))
        held = DYNAMIC | {SPEED}
        found = scanned(descend(start, most_steps=_BLURRED_STEPS, span_s=_BLUR_S, held=held), "d", STATIC_SCAN)
        found = descend(found, most_steps=_SHARP_STEPS, held=frozenset({SPEED, "m", "DV"}))
        if found.is_followed:
            begun.append(found)
    begun.sort(key=lambda one: one.cost)
    return min(
        (descend(one, most_steps=_SHARP_STEPS, held=frozenset({"DV"})) for one in begun[:_FOLLOWED]),
        key=lambda one: one.cost,
        default=None,
    )


def from_steady_motion(fit: Fit, model: Model) -> Fit | None:
    """Return the lowest start of a ``model`` with the falling friction by the balance of forces in steady motion.

    Where friction has fallen before the stem slides at its ramps' speeds, those tell k, F_0, F_c and F_v whatever a
    plain valve had to take for the fall, and the breakaways tell F_s: v_s alone is looked for. None where the balance
    does not tell the valve.
    """
    rows = sliding_rows(fit)
    valve = None if rows is None else steady_valve(rows, fit)
    if rows is None or valve is None:
        return None
    slowest = float(np.quantile(np.abs(rows.velocity), 0.1))
    begun = [
        scanned(
            start_fit(model, model.unknowns.point({**fit.values, **valve, SPEED: share * slowest})), "d", STATIC_SCAN
        )
        for share in _SHARES_OF_SLOWEST
    ]
    return min(begun, key=lambda one: one.cost)


def from_first_slips(fit: Fit, model: Model, setting: Setting) -> Fit | None:
    """Return the fit of a ``model`` with the falling friction that begins with the first slips after a ``fit`` without.

    Where the friction's fall takes up its damping a stem rings or slips all the way, and the plain valve has the mass
    and the damping that mimic the period. So the mass begins at the nameplate's, F_s as it was, v_s and the fall on a
    grid, and F_v is what the friction at the usual speed leaves. None where the first slips are not explained.
    """
    own, speed = fit.values, setting.sliding_m_per_s
    static_n, total_n = own["F_c"] * (1.0 + own["d"]), own["F_c"] + own["F_v"] * speed
    mass_kg = setting.observed.motions[0].moving_mass_kg or own["m"]
    starts = []
    for share, drop in product(_SHARES_OF_SPEED, _DROPS):
        coulomb_n = static_n / (1.0 + drop)
        viscous_n = total_n - coulomb_n - (static_n - coulomb_n) * math.exp(-1.0 / share**2)
        own_speed = {SPEED: share * speed, "DV": LIMIT_MEDIAN * speed}
        shape = {"F_c": coulomb_n, "d": drop, "F_v": max(viscous_n, _LEAST_VISCOUS * total_n) / speed}
        starts.append({**own, **own_speed, **shape, "m": mass_kg, "first_rise": 0.0})
    return grown(model, starts, ("m", SPEED), frozenset({"m", "DV"}))


def from_slow_slips(fit: Fit, model: Model, setting: Setting) -> Fit | None:
    """Return the fit of a ``model`` with the falling friction that begins with slips that damping makes slow.

    Far above critical damping a slip lasts some F_v/k, a rest is no rest, and no speed is steady: neither the balance
    of forces nor the usual speed tells the friction in motion. F_s is what the plain valve has; the rest begins on a
    grid, and is walked to its place before the record grows by small steps. None where damping is not so large, and of
    fast rows: those show the slips themselves, and the grid would take the work of all other causes (10091).
    """
    own, speed = fit.values, setting.sliding_m_per_s
    mass_kg = setting.observed.motions[0].moving_mass_kg or own["m"]
    is_fast = setting.observed.motions[0].samples.period_s < _SLIPS_SEEN_S
    if is_fast or own["F_v"] < _SLOW * 2.0 * math.sqrt(mass_kg * own["k"]):
        return None
    static_n = own["F_c"] * (1.0 + own["d"])
    starts = []
    for share, drop, viscous in product(_SHARES_OF_SLOW, _DROPS_OF_SLOW, _VISCOUS_OF_SLOW):
        own_speed = {SPEED: share * speed, "DV": LIMIT_MEDIAN * speed}
        shape = {"F_c": static_n / (1.0 + drop), "d": drop, "F_v": viscous * own["F_v"]}
        starts.append({**own, **own_speed, **shape, "m": mass_kg, "first_rise": 0.0})
    least_s = max(_RELAXATIONS * own["F_v"] / own["k"], 1.01 * fewest_blocks_s(model))
    pace = Pace(least_s, _SLOW_GROWTH, promising=math.inf, followed=3, is_patient=True)
    return grown(model, starts, ("m", SPEED), frozenset({"m", "DV"}), pace)


def as_good_speeds(fit: Fit) -> tuple[float, float] | None:
    """Return the ends of the v_s with which the first slips fit as well; None where the stem does not ring.

    It rings where the friction's fall takes up its damping, and then the curvature of the misfit says nothing: it is
    that of one of many minima.
    """
    values, speed = fit.values, setting_of(fit).sliding_m_per_s
    share = speed / values[SPEED]
    fall = 2.0 * values["F_c"] * values["d"] / values[SPEED] * share * math.exp(-(share**2))
    if values["F_v"] - fall > 2.0 * _RINGING * math.sqrt(values["m"] * values["k"]):
        return None
    return as_good(fit, SPEED)


def along_valley(fit: Fit) -> Fit:
    """Return the lowest fit on walks along v_s, each step beginning with the friction that the last one had."""
    fastest = _fastest(fit)

    def step(here: Fit, factor: float) -> Fit | None:
        values = _same_friction(here.values, here.values[SPEED] * factor, fastest)
        if values is None:
            return None
        begun = start_fit(here.model, here.model.unknowns.point(values))
        return descend(begun, most_steps=_STEPS, held=frozenset({SPEED}))

    for factor in _FACTORS:
        fit = walked(fit, partial(step, factor=factor))
    return fit


def _fastest(fit: Fit) -> float:
    reached = max(float(np.abs(motion.phases.velocity).max()) for motion in fit.model.observed.motions)
    return max(reached, _RAMPS * setting_of(fit).sliding_m_per_s)


def _same_friction(values: Values, speed: float, fastest: float) -> Values | None:
    """Return the values with another v_s and the F_c and F_v that leave the friction up to ``fastest`` nearest.

    F_s stays. None where they are no valve's.
    """
    at = np.geomspace(_SLOWEST * fastest, fastest, _SPEEDS)
    static_n = values["F_c"] * (1.0 + values["d"])
    fallen = 1.0 - np.exp(-((at / values[SPEED]) ** 2))
    friction_n = static_n + (values["F_c"] - static_n) * fallen + values["F_v"] * at
    share = 1.0 - np.exp(-((at / speed) ** 2))
    solved = np.linalg.lstsq(np.column_stack([share, at]), friction_n - static_n * (1.0 - share), rcond=None)[0]
    coulomb_n, viscous = float(solved[0]), float(solved[1])
    if not (0.0 < coulomb_n <= static_n and viscous > 0.0):
        return None
    return {**values, SPEED: speed, "F_c": coulomb_n, "F_v": viscous, "d": static_n / coulomb_n - 1.0}
