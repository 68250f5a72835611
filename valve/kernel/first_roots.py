"""The first time at which something happens in a mode: each root is the first by a bound, not by luck."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

import math
from typing import Final

from valve.kernel.compiled import kernel
from valve.kernel.response import impulse_response

MOST_ROOT_STEPS: Final = 1_000_000


@kernel
def band_reach(gain, alpha, beta, w2):
    """Time in which the band's velocity, from acceleration alpha and jerk beta, gains ``gain``; inf if never."""
    inside = alpha * alpha + gain * (2.0 * beta - gain * w2)
    if inside < 0.0:
        return math.inf
    below = alpha + math.sqrt(inside)
    if below <= 0.0:
        return math.inf
    half_tangent = gain / below
    w = math.sqrt(w2)
    return 2.0 * math.atan(w * half_tangent) / w if w > 0.0 else 2.0 * half_tangent


@kernel
def band_capture(y, y_rate, w2):
    """Time in which the excess force y >= 0 of the undamped band falls to 0; inf if never."""
    if w2 > 0.0:
        w = math.sqrt(w2)
        return math.atan2(y * w, -y_rate) / w
    return -y / y_rate if y_rate < 0.0 else math.inf


@kernel
def slip_end(c, w2, DV, s, v, a, push, horizon):
    """First time before ``horizon`` at which s v falls to DV, inf if there is none, NaN if it was not found.

    ``push`` is (force rate)/m. Each step h = 2g/(sqrt(g'^2 + 2 M g) - g') is short enough to hold no root,
    because M bounds |g''| from here on: the energy of any derivative of the homogeneous motion only falls.
    """
    r = push - w2 * v
    gap = 0.25 * c * c - w2
    real = gap > 1.0e-6 * c * c
    fast = 0.5 * c + math.sqrt(gap) if real else 0.0
    slow = w2 / fast if real else 0.0
    tol = 1.0e-13 * DV + 2.0e-16 * abs(v)
    tau, v_now, a_now = 0.0, v, a
    for _ in range(MOST_ROOT_STEPS):
        j_now = push - w2 * v_now - c * a_now
        g, g1, g2 = s * v_now - DV, s * a_now, s * j_now
        # |v''| <= M and |v'''| <= M3 for all later times
        M = math.sqrt(j_now * j_now + w2 * a_now * a_now)
        k_now = -c * j_now - w2 * a_now
        M3 = math.sqrt(k_now * k_now + w2 * j_now * j_now)
        swing = math.inf
        if w2 > 0.0:
            u_now = v_now - push / w2
            swing = math.sqrt(u_now * u_now + a_now * a_now / w2)
        if real:
            # tighter where the motion is a sum of two decays
            weak = abs(j_now + fast * a_now) / (fast - slow)
            strong = abs(j_now + slow * a_now) / (fast - slow)
            M = min(M, slow * weak + fast * strong)
            M3 = min(M3, slow * slow * weak + fast * fast * strong)
            if slow > 0.0:
                swing = min(swing, weak / slow + strong / fast)
        if w2 > 0.0 and s * push / w2 - swing > DV:
            return math.inf
        if tau > 0.0 and g <= tol and g1 <= 0.0:
            return tau
        g = max(g, 0.0)
        if M > 0.0:
            root = math.sqrt(g1 * g1 + 2.0 * M * g)
            h = (g1 + root) / M if g1 > 0.0 else (2.0 * g / (root - g1) if g > 0.0 else 0.0)
        else:
            h = math.inf if g1 >= 0.0 else -g / g1
        if g1 >= 0.0 and g2 > 0.0:
            h = max(h, 3.0 * g2 / M3) if M3 > 0.0 else math.inf
        if tau + h >= horizon:
            return math.inf
        if tau + h == tau:
            return tau
        tau += h
        S_rate, S, S1, _unused = impulse_response(tau, c, w2)
        v_now = v + a * S + r * S1
        a_now = a * S_rate + r * S
    return math.nan


@kernel
def newton_step(tau, above, slope, lo, hi):
    """Return (next time, bracket) of a search in [lo, hi] for where a quantity falls through zero; it is ``above``.

    Newton's step, ``slope`` being the quantity's rate, or half the bracket where that leaves it.
    """
    if above > 0.0:
        lo = tau
    else:
        hi = tau
    guess = tau - above / slope if slope != 0.0 else math.inf
    if not lo <= guess <= hi:
        guess = 0.5 * (lo + hi)
    return guess, lo, hi


@kernel
def stop_time(c, w2, x, v, a, r, stop, heading, early, late):
    """Time in [early, late], over which the stem moves towards ``heading``, at which it is at ``stop``."""
    lo, hi, tau = early, late, early
    for _ in range(200):
        _rate, S, S1, S2 = impulse_response(tau, c, w2)
        miss = stop - (x + v * tau + a * S1 + r * S2)
        guess, lo, hi = newton_step(tau, heading * miss, -heading * (v + a * S + r * S1), lo, hi)
        if abs(guess - tau) <= 4.0e-16 * late:
            return guess
        tau = guess
    return tau


@kernel
def stop_between(c, w2, x, v, a, r, low, high, heading, early, late):
    """Time in [early, late], moving towards ``heading`` all the while, at which a stop is met; inf if none is."""
    _rate, _S, S1, S2 = impulse_response(late, c, w2)
    stop = high if heading > 0.0 else low
    if heading * (x + v * late + a * S1 + r * S2 - stop) < 0.0:
        return math.inf
    return stop_time(c, w2, x, v, a, r, stop, heading, early, late)
