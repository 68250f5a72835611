"""A rest on bristles: presliding by Dahl (1968), exponent 1, until the bristles carry F_s."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.loads import extra_static, load, static_level, vibration_rate, zone
from valve.kernel.slots import F_S, F_V, PRESLIDING, VISCOUS_ASYMMETRY

BREAK_MARGIN: Final = 0.02  # the bristles' asymptote lies so far above F_s that F_s is met at a finite deflection


@kernel
def bristle_force(asymptote, stiffness, side, loaded, d):
    """Dahl's force after a way d >= 0 towards ``side`` from where it was ``loaded``."""
    return side * (asymptote - (asymptote - side * loaded) * math.exp(-stiffness * d / asymptote))


@kernel
def bristle_way(q, curves, x, loaded, side, t, force, asymptote, stiffness, weight, drive):
    """Way d >= 0 towards ``side`` with F_v d = drive + weight (net - Dahl's force), and what drives there."""
    viscous, d, excess = q[F_V] * (1.0 + side * q[VISCOUS_ASYMMETRY]), 0.0, 0.0
    for _ in range(60):
        held = bristle_force(asymptote, stiffness, side, loaded, d)
        net, _more, _area = load(q, curves, x + side * d, t, force)
        excess = side * (net - held)
        rate, _edge = zone(q, x + side * d, side)
        missing = drive + weight * excess - viscous * d
        # concave and rising from below: Newton never leaps over the balance
        step = missing / (viscous + weight * (rate + stiffness * max(1.0 - side * held / asymptote, 0.0)))
        step = max(step, -d)
        d += step
        # squared by the convergence, what is left is below rounding
        if abs(step) <= 1.0e-15 + 1.0e-7 * d:
            break
    return d, excess


@kernel
def bristle_step(q, curves, x, loaded, t, force, slope, rested, never_moved, h):
    """Return (side, way, way at which the bristles give way, asymptote, drive at the end) of an elastic rest after h.

    F_v x' = net - Dahl's force, without inertia; the two-stage, L-stable SDIRK of order 2.
    """
    stiffness, part = max(q[F_S], 1.0e-6) / q[PRESLIDING], 1.0 - math.sqrt(0.5)
    last = force + slope * h
    net, more, _area = load(q, curves, x, t + h, last)
    side = 1.0 if net > loaded else -1.0
    static = max(static_level(q, side, more, extra_static(q, rested + h, never_moved)), 1.0e-9)
    asymptote = static / (1.0 - BREAK_MARGIN)
    until = asymptote / stiffness * math.log(max(asymptote - side * loaded, 1.0e-300) / (asymptote - static))
    _d, early = bristle_way(
        q, curves, x, loaded, side, t + part * h, force + slope * part * h, asymptote, stiffness, part * h, 0.0
    )
    early = max(early, 0.0) if q[F_V] > 0.0 else 0.0
    weight = part * h if h > 0.0 else 1.0
    d, excess = bristle_way(
        q, curves, x, loaded, side, t + h, last, asymptote, stiffness, weight, (1.0 - part) * h * early
    )
    return side, d, max(until, 0.0), asymptote, excess


@kernel
def bristle_rest(q, curves, x, loaded, t, force, slope, rested, never_moved, left):
    """Return (time, whether it gave way, position, velocity, bristle force) of an elastic rest within ``left``.

    The bristles (Dahl 1968, exponent 1) and the viscous friction carry what spring and actuator do not, until the
    bristles carry F_s.
    """
    stiffness = max(q[F_S], 1.0e-6) / q[PRESLIDING]
    side, d, until, asymptote, excess = bristle_step(q, curves, x, loaded, t, force, slope, rested, never_moved, left)
    if d < until or (d - until <= 1.0e-12 and excess <= 1.0e-9 * asymptote):
        return left, False, x + side * d, 0.0, bristle_force(asymptote, stiffness, side, loaded, d)
    lo, hi, under, over, tau = 0.0, left, -until, d - until, left
    for _ in range(60):
        tau = lo - under * (hi - lo) / (over - under) if over > under else 0.5 * (lo + hi)
        if not lo < tau < hi:
            tau = 0.5 * (lo + hi)
        side, d, until, asymptote, excess = bristle_step(
            q, curves, x, loaded, t, force, slope, rested, never_moved, tau
        )
        if abs(d - until) <= 1.0e-13 or hi - lo <= 1.0e-13:
            break
        # Illinois: the value at the end that stays is halved, so that both ends move
        if d >= until:
            hi, over, under = tau, d - until, 0.5 * under
        else:
            lo, under, over = tau, d - until, 0.5 * over
    at, viscous = x + side * until, q[F_V] * (1.0 + side * q[VISCOUS_ASYMMETRY])
    rate, _edge = zone(q, at, side)
    _net, _more, area = load(q, curves, at, t + tau, force + slope * tau)
    speed = side * (slope * area + vibration_rate(q, t + tau)) / (rate + stiffness * BREAK_MARGIN)
    if viscous > 0.0:
        speed = excess / viscous
    return tau, True, at, side * max(speed, 0.0), math.nan
