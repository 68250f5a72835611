"""The bench set: whether the fitted preload is the nameplate's, or a friction that differs by direction hides in it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from discrepancy.baseline import DYNAMIC, held_fit
from discrepancy.causes.base import Cause, Fitted, Setting, is_at_bound, with_interval
from discrepancy.causes.channels import BOW
from discrepancy.causes.forces import AREA
from discrepancy.causes.friction import ASYMMETRY, DRIFT
from discrepancy.intervals import standard_errors
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.screening import Candidate, extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import NEAR, noise_factor
from estimators.base import NORMAL_95

# Of the full force: no bench set is known, and no pressure channel set to zero, better than this.
TOLERANCE: Final = 2.0e-3
_SURE: Final = 4.0  # standard errors
_STEPS: Final = 15
_BLUR_S: Final = 0.1
_EVENLY_S: Final = 3.0e3  # a time constant, that a minute shows a straight line of
# What bends the line of force over travel.
BENDING: Final = frozenset(
    {
        "spring_hardening",
        "dual_rate_spring",
        "diaphragm_area_change",
        "flow_force",
        "position_nonlinearity",
    }
)
_LARGEST: Final = 0.3  # of the full force (valve.effects.spring_preload)


def _sentence(values: Mapping[str, Fitted], setting: Setting) -> str:
    entry = values["offset_n"]
    sense = "higher" if entry.value > 0.0 else "lower"
    area_m2 = setting.observed.nameplate.actuator.diaphragm_area_m2
    pressure = "" if area_m2 is None else f", {abs(entry.value) / area_m2 / 1.0e3:.2f} kPa of bench set"
    return f"The spring's preload is {with_interval(entry, 1.0, 'N')} {sense} than the nameplate's{pressure}."


PRELOAD: Final = Cause(
    "spring_preload",
    "offset_n",
    (),
    lambda _setting: [],
    _sentence,
    "Set the bench set by the spring adjuster, or correct the nameplate; check the position's and the pressure's zero.",
)


def preload_offset(fit: Fit) -> Fitted | None:
    """Return by how much the fitted preload differs from the nameplate's; None where that is within tolerance.

    The tolerance holds what the references of other causes make of the preload (`conventional_preload`).
    """
    observed = fit.model.observed
    nominal_n = observed.nameplate.nominal_preload_n
    names = fit.model.unknowns.names
    if nominal_n is None or "F_0" not in names:
        return None
    place = names.index("F_0")
    entry = fit.model.unknowns.entries[place]
    error_n = float(standard_errors(fit)[place]) * entry.unit
    offset_n = fit.values["F_0"] - nominal_n
    tolerance_n = TOLERANCE * observed.full_force_n + conventional_preload(fit)
    if abs(offset_n) <= tolerance_n + _SURE * error_n or abs(offset_n) > _LARGEST * observed.full_force_n:
        return None
    half_n = NORMAL_95 * error_n + tolerance_n
    return Fitted(offset_n, offset_n - half_n, offset_n + half_n, "N")


def bent_instead(fit: Fit, known: Iterable[Cause]) -> list[tuple[Cause, Fit]]:
    """Return further causes that do as well with the nameplate's preload, each with its fit, the lowest first.

    Where other causes bend the line of force over travel, a bend less and a preload more may be the same line.
    """
    nominal_n = fit.model.observed.nameplate.nominal_preload_n
    if nominal_n is None or not BENDING & set(fit.model.causes):
        return []
    held = descend(held_fit(fit, F_0=nominal_n), most_steps=_STEPS)
    if not held.is_followed:
        return []
    setting = setting_of(held)
    others = [cause for cause in known if cause.name in BENDING - set(fit.model.causes)]
    found = []
    for candidate in screen(held, others, setting):
        instead = descend(refit(held, candidate, setting), most_steps=_STEPS)
        at_bound = any(
            is_at_bound(candidate.cause, one, instead.values[one.name]) for one in candidate.cause.unknowns(setting)
        )
        if instead.is_followed and not at_bound and instead.cost - fit.cost < NEAR * noise_factor(fit):
            found.append((candidate.cause, instead))
    return sorted(found, key=lambda pair: pair[1].cost)


def conventional_preload(fit: Fit) -> float:
    """Return by how much the preload may be another only because a cause counts from another place, N.

    A bowed reading q (x - l)(h - x) that is right at the ends l, h of the travel that was swept, and not at those of
    the rated travel, 0 and L, is the same bow beside another straight line: k q l h of preload. An area that is the
    nameplate's at an end of the travel and not in the middle of what was swept scales all forces, the preload's too.
    """
    values, setting = fit.values, setting_of(fit)
    found_n = 0.0
    if BOW.name in fit.model.causes:
        curvature = 4.0 * values[BOW.own("bow_m")] / values[BOW.own("span_m")] ** 2
        found_n += abs(values["k"] * curvature * setting.low_m * setting.high_m)
    if AREA.name in fit.model.causes:
        reference_m = values[AREA.own("reference_m")]
        away_m = max(reference_m, setting.scale.travel_m - reference_m)
        found_n += abs(values["F_0"] * values[AREA.own("slope_per_m")]) * away_m
    return found_n


def friction_instead(fit: Fit) -> list[tuple[Cause, Fit]]:
    """Return an asymmetry and a drift of friction, each with its fit, where that does as well as another preload."""
    nominal_n = fit.model.observed.nameplate.nominal_preload_n
    if nominal_n is None:
        return []
    held = held_fit(fit, F_0=nominal_n)
    offset_n = fit.values["F_0"] - nominal_n
    found = []
    for cause, instead in ((ASYMMETRY, _asymmetry), (DRIFT, _drift)):
        other = None if cause.name in fit.model.causes else instead(held, offset_n)
        if other is None or not other.is_followed or other.cost - fit.cost > NEAR * noise_factor(fit):
            continue
        if not any(is_at_bound(cause, one, other.values[one.name]) for one in cause.unknowns(setting_of(fit))):
            found.append((cause, other))
    return found


def _asymmetry(held: Fit, offset_n: float) -> Fit:
    start = {"asymmetry": offset_n / max(held.values["F_c"], 1.0e-9)}
    return refit(held, Candidate(ASYMMETRY, (start,), 1.0), setting_of(held))


def _drift(held: Fit, offset_n: float) -> Fit:
    """Return the fit with a friction that changes evenly: once open and back, that is another spring and preload.

    With h half the change, F_0 - h, F_c + h, F_s + h and k + h over the swept travel stand for it.
    """
    setting, own, half_n = setting_of(held), held.values, -offset_n
    model = extended_model(held.model, DRIFT, setting)
    coulomb_n = max(own["F_c"] - half_n, 1.0e-9)
    values = {
        **own,
        **DRIFT.full({"change_n": 2.0 * half_n, "time_constant_s": _EVENLY_S}),
        "F_c": coulomb_n,
        "d": max((own["F_c"] * (1.0 + own["d"]) - half_n) / coulomb_n - 1.0, 0.0),
        "k": own["k"] - half_n / setting.swept_m,
    }
    start = descend(start_fit(model, model.unknowns.point(values)), most_steps=_STEPS, span_s=_BLUR_S, held=DYNAMIC)
    return descend(start, most_steps=2 * _STEPS)
