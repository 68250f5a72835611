"""The baseline: the Karnopp valve fitted as well as it can be, with what every real record has besides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

import numpy as np

from discrepancy.commanded import from_estimate, with_commanded
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed
from discrepancy.thinning import thinned
from discrepancy.unknowns import Unknown, Unknowns
from estimators.base import Estimate
from estimators.likelihood.start import first_guesses
from estimators.motion.recorded_motion import RecordedMotion

# Own choices: starts, as shares of the friction in motion, of the sliding speed and of F_c, and how many are followed.
_VISCOUS_SHARES: Final = (0.9, 0.5, 0.2, 0.06, 0.02, 0.003)
_STATIC_SHARES: Final = (0.0, 0.2)
_MASSES_KG: Final = (0.3, 1.5, 8.0, 40.0)
_FOLLOWED: Final = 3
_BLURS_S: Final = (1.0, 0.1, 0.0)
_STEPS: Final = (8, 6, 12)
STATIC_SCAN: Final = np.concatenate([np.linspace(-0.03, 0.03, 13), np.linspace(-0.3, 0.6, 16)])
FIRST_RISES: Final = (-0.1, -0.03, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3)  # of the friction
_MASS_RANGE_KG: Final = (1.0e-2, 1.0e3)
# DV as the likelihood has it: lognormal about 1.5 % of the sliding speed.
LIMIT_MEDIAN: Final = 0.015
_LIMIT_SD: Final = 1.5
_FIRST_RISE_SD: Final = 0.3  # of F_s
# F_v as a share of the friction in motion: from a dry packing's to that of a stem in grease.
_VISCOUS_MEDIAN: Final = 0.1
_VISCOUS_SD: Final = 2.0
_VELOCITY_ERRORS: Final = 5.0  # by which the velocity of a beginning may be off at most
DYNAMIC: Final = frozenset({"m", "DV", "first_rise"})  # which wait until the rest has found its place
EXPLAINED: Final = 1.2  # rms residual over noise, from which on no other start is tried


def baseline_unknowns(observed: Observed, fastest_m_per_s: float, friction_n: float) -> Unknowns:
    """Return the unknowns of a Karnopp valve in these recordings, and its nuisances."""
    motion = observed.motions[0]
    range_n = float(np.ptp(motion.samples.force_n))
    range_m = float(np.ptp(motion.samples.position_m))
    mass_kg = motion.moving_mass_kg or 2.0
    entries = [
        # the nameplate's mass is known to a factor or so: a heavier stem is no name for a misfit
        Unknown("m", *_MASS_RANGE_KG, step=1.0e-3, prior=math.log(mass_kg), prior_sd=1.5),
        Unknown("k", 1.0e-3, 1.0e12, step=3.0e-6),
        Unknown(
            "F_v",
            1.0e-7 * range_n / fastest_m_per_s,
            1.0e3 * range_n / fastest_m_per_s,
            step=1.0e-4,
            prior=math.log(_VISCOUS_MEDIAN * friction_n / fastest_m_per_s),
            prior_sd=_VISCOUS_SD,
        ),
        Unknown("F_c", 1.0e-6 * range_n, 2.0 * range_n, step=1.0e-5),
        Unknown("d", 0.0, 10.0, unit=1.0, step=1.0e-5),
        Unknown("F_0", -20.0 * range_n, 20.0 * range_n, unit=range_n, step=3.0e-6),
        Unknown(
            "DV",
            1.0e-5 * fastest_m_per_s,
            fastest_m_per_s,
            step=1.0e-3,
            prior=math.log(LIMIT_MEDIAN * fastest_m_per_s),
            prior_sd=_LIMIT_SD,
        ),
        Unknown(
            "first_rise",
            -0.5 * friction_n,
            3.0 * friction_n,
            unit=friction_n,
            step=1.0e-5,
            prior=0.0,
            prior_sd=_FIRST_RISE_SD,
        ),
    ]
    for number, segment in enumerate(observed.segments):
        entries.append(
            Unknown(
                f"x_{number}",
                segment.start_m - range_m,
                segment.start_m + range_m,
                unit=range_m,
                step=1.0e-6,
                prior=segment.start_m / range_m,
                prior_sd=segment.start_error_m / range_m,
            )
        )
        if segment.start_velocity_error > 0.0:
            off = _VELOCITY_ERRORS * segment.start_velocity_error
            entries.append(
                Unknown(
                    f"v_{number}",
                    segment.start_velocity - off,
                    segment.start_velocity + off,
                    unit=segment.start_velocity_error,
                    step=1.0e-4,
                    prior=segment.start_velocity / segment.start_velocity_error,
                    prior_sd=1.0,
                )
            )
    delay = observed.delay
    if delay is not None:
        entries.append(
            Unknown(
                "delay_s",
                delay.lower,
                delay.upper,
                unit=delay.scale,
                step=1.0e-2,
                prior=delay.start / delay.scale,
                prior_sd=delay.prior_sd / delay.scale,
            )
        )
    return Unknowns(tuple(entries))


def fit_baseline(observed: Observed, estimate: Estimate | None = None) -> Fit | None:
    """Return the best fit of the Karnopp valve; None where no balance of forces gives a start.

    ``estimate``: the maximum-likelihood one, from whose ``diagnostics["fitted"]`` the fit starts too.
    """
    fitted = {} if estimate is None else estimate.diagnostics.get("fitted", {})
    observed = with_commanded(observed, fitted)
    guesses = _guessed(observed)
    if "k" in fitted:
        guesses.insert(0, from_estimate(fitted, guesses[0] if guesses else {}))
    if not guesses:
        return None
    motion = observed.motions[0]
    fastest = _fastest(motion)
    # an estimate that misses a cause may hold hardly any friction, and the sizes of the unknowns go by it
    friction_n = max(guess["F_c"] for guess in guesses)
    model = Model(observed, baseline_unknowns(observed, fastest, friction_n), thin=thinned(observed))
    nuisances = {f"x_{number}": segment.start_m for number, segment in enumerate(observed.segments)}
    nuisances |= {f"v_{number}": segment.start_velocity for number, segment in enumerate(observed.segments)}
    nuisances |= {"delay_s": 0.0, "first_rise": 0.0}
    points = [model.unknowns.point({**nuisances, **guess}) for guess in guesses]
    fits = [start_fit(model, point) for point in points]
    first = fits[:1] if "k" in fitted else []
    ranked = sorted(fits[len(first) :], key=lambda fit: fit.cost)
    best: Fit | None = None
    for fit in [*first, *ranked[:_FOLLOWED]]:
        found = _followed(fit)
        if found.is_followed and (best is None or found.cost < best.cost):
            best = found
        if best is not None and best.cost < EXPLAINED**2 * observed.count:
            break
    return best


def _followed(fit: Fit) -> Fit:
    found = fit
    for span_s, steps in zip(_BLURS_S, _STEPS, strict=True):
        found = descend(found, most_steps=steps, span_s=span_s, held=DYNAMIC if span_s > 0.0 else frozenset())
        if span_s == _BLURS_S[-2] and found.is_followed:
            found = scanned(scanned(found, "d", STATIC_SCAN), "first_rise", FIRST_RISES)
    return found


def scanned(fit: Fit, name: str, shares: Sequence[float] | np.ndarray[Any, Any]) -> Fit:
    """Return the best of fits with another value of one unknown, not descended; of F_s for ``d``."""
    place = fit.model.unknowns.names.index(name)
    lower, upper = fit.model.unknowns.lower, fit.model.unknowns.upper
    best = fit
    for share in shares:
        if fit.model.tally.is_spent:
            break
        point = fit.point.copy()
        moved = (1.0 + point[place]) * (1.0 + share) - 1.0 if name == "d" else point[place] + share
        point[place] = min(max(float(moved), float(lower[place])), float(upper[place]))
        tried = start_fit(fit.model, point)
        if tried.cost < best.cost:
            best = tried
    return best


def _fastest(motion: RecordedMotion) -> float:
    moving = np.concatenate([np.abs(motion.phases.velocity[stretch.rows]) for stretch in motion.phases.stretches])
    return float(np.quantile(moving, 0.9))


def _guessed(observed: Observed) -> list[dict[str, float]]:
    """Values by name to start from: a balance of forces, with masses, dampings and static frictions to try."""
    motion = observed.motions[0]
    guesses = first_guesses(motion)
    found: list[dict[str, float]] = []
    mass_kg = motion.moving_mass_kg
    masses_kg = _MASSES_KG if mass_kg is None else (mass_kg,)
    for guess in guesses:
        for viscous, static, mass in product(_VISCOUS_SHARES, _STATIC_SHARES, masses_kg):
            coulomb_n = (1.0 - viscous) * guess.friction_n
            static_n = guess.static_n if static == 0.0 else (1.0 + static) * coulomb_n
            found.append(
                {
                    "m": mass,
                    "k": guess.spring_n_per_m,
                    "F_v": viscous * guess.friction_n / guess.speed,
                    "F_c": coulomb_n,
                    "d": max(0.0, static_n / coulomb_n - 1.0),
                    "F_0": guess.preload_n,
                    "DV": LIMIT_MEDIAN * guess.speed,
                }
            )
    return found


def held_fit(fit: Fit, **values: float) -> Fit:
    """Return the fit with these values held and no longer unknown, as it stands."""
    model = fit.model
    kept = tuple(entry for entry in model.unknowns.entries if entry.name not in values)
    inner = replace(model, unknowns=Unknowns(kept), held={**model.held, **values})
    return start_fit(inner, inner.unknowns.point(fit.values))
