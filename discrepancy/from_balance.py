"""The plain valve begun anew at its balance of forces, where a scan of the damping finds what a descent cannot.

Steady motion tells k, F_0 and the friction in motion to a thousandth, and ramps of one rate next to nothing of how much
of that is damping. Yet the damping decides whether a stem that slips comes to rest behind it or slides on: 8 % too much
of it once left a thousand times what the valve itself does, and on neither side does the slope say so.
"""

from __future__ import annotations

from itertools import product
from typing import Final

import numpy as np

from discrepancy.baseline import scanned
from discrepancy.causes.base import Values
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.observed import Observed
from discrepancy.significance import is_noise
from discrepancy.sliding import needed_friction, plain_balance, sliding_rows, usual_values

# Own choices, from valves with and without hidden effects (docs/diagnosis.md).
_VISCOUS_SHARES: Final = np.geomspace(5.0e-4, 0.5, 73)  # of the friction in motion: steps of a tenth
_STATIC_SCAN: Final = np.linspace(-0.01, 0.01, 11)  # a breakaway is seen by a row or two late
_RISE_SCAN: Final = np.linspace(-0.015, 0.015, 11)  # of the friction
_FEWEST_BREAKAWAYS: Final = 3
_DEPARTED: Final = 6.0  # noises
_STEPS: Final = 30


def from_balance(fit: Fit) -> Fit:
    """Return the fit that begins at the balance of forces, where that is lower than a ``fit`` that noise is not."""
    rows = None if is_noise(fit) or fit.model.causes else sliding_rows(fit)
    balance = None if rows is None else plain_balance(rows)
    if balance is None:
        return fit
    spring, preload_n, kinetic_n, speed = balance
    needed_n, _ = needed_friction(fit, (), spring, preload_n)
    if needed_n.size < _FEWEST_BREAKAWAYS:
        return fit
    static_n = float(np.median(needed_n))
    first_n = _first_force(fit.model.observed) - spring * fit.model.observed.segments[0].start_m - preload_n
    values = {**fit.values, **usual_values(fit), "k": spring, "F_0": preload_n}
    starts = [
        {**values, **_frictions(kinetic_n, static_n, float(share), speed), "first_rise": rise_n}
        for share, rise_n in product(_VISCOUS_SHARES, {0.0, max(first_n - static_n, 0.0)})
    ]
    model = fit.model
    best = min((start_fit(model, model.unknowns.point(one)) for one in starts), key=lambda one: one.cost)
    best = scanned(scanned(best, "d", _STATIC_SCAN), "first_rise", _RISE_SCAN)
    if best.cost < fit.cost:
        found = descend(best, most_steps=_STEPS)
        return found if found.is_followed and found.cost < fit.cost else fit
    return fit


def _frictions(kinetic_n: float, static_n: float, viscous_share: float, speed: float) -> Values:
    coulomb_n = (1.0 - viscous_share) * kinetic_n
    return {"F_c": coulomb_n, "F_v": viscous_share * kinetic_n / speed, "d": max(static_n / coulomb_n - 1.0, 0.0)}


def _first_force(observed: Observed) -> float:
    """Return the force at which the stem first leaves its place, N: phases may not hold a slip of a row or two."""
    samples, start_m = observed.motions[0].samples, observed.segments[0].start_m
    off = int(np.argmax(np.abs(samples.position_m - start_m) > _DEPARTED * observed.noise_m))
    return float(samples.force_n[max(off - 1, 0) : off + 1].mean())
