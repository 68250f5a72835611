"""The impulse response that every mode's motion is made of.

In each mode the stem obeys m x'' + F_v x' + k x = affine force, so with c = F_v/m and w2 = k/m and from
position x, velocity v, acceleration a and r = (force rate - k v)/m it is after a time tau at

    x + v tau + a S1 + r S2,    v + a S + r S1,    a S' + r S,

where S is the impulse response of y'' + c y' + w2 y = 0, and S1 and S2 are its integrals. This one form
holds for every damping and for k = 0. Times are in s, lengths in m, forces in N, the mass in kg.
"""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve.kernel.compiled import kernel

SETTLED: Final = 50.0  # time constants: exp(-50) is 2e-22
INVERSE_FACTORIAL: Final = np.array([1.0 / math.factorial(n) for n in range(24)])


@kernel
def impulse_response(tau, c, w2):
    """Return S', S, S1 and S2 after tau, each to rounding at any damping, critical included."""
    b, d = c * tau, w2 * tau * tau
    if b < 1.0 and d < 0.25:
        # Taylor: the closed forms of S1 and S2 cancel here
        p, before = 1.0, 0.0
        rate = value = once = twice = 0.0
        for n in range(20):
            rate += p * INVERSE_FACTORIAL[n]
            value += p * INVERSE_FACTORIAL[n + 1]
            once += p * INVERSE_FACTORIAL[n + 2]
            twice += p * INVERSE_FACTORIAL[n + 3]
            p, before = -b * p - d * before, p
        return rate, value * tau, once * tau * tau, twice * tau * tau * tau
    half = 0.5 * c
    gap = half * half - w2
    if gap < 0.0:
        omega = math.sqrt(-gap)
        decay = math.exp(-half * tau)
        value = decay * math.sin(omega * tau) / omega
        rate = decay * math.cos(omega * tau) - half * value
        once = (1.0 - rate - c * value) / w2
        return rate, value, once, (tau - value - c * once) / w2
    # roots -slow and -fast; slow by Vieta, so that it keeps its digits when heavily overdamped
    spread = 2.0 * math.sqrt(gap)
    fast = half + 0.5 * spread
    slow = w2 / fast
    decay = math.exp(-slow * tau)
    u = slow * tau
    if u < 0.5:
        phi, p = 0.0, 1.0
        for n in range(16):
            phi += p * INVERSE_FACTORIAL[n + 2]
            p *= -u
        first = tau * (1.0 - u * phi)
        second = tau * tau * phi
    else:
        first = (1.0 - decay) / slow
        second = (tau - first) / slow
    u = spread * tau
    if u > 1.0:
        decay_fast = math.exp(-u)
        value = decay * (1.0 - decay_fast) / spread
        rate = decay * (fast * decay_fast - slow) / spread
    else:
        value = decay * (-math.expm1(-u) / spread if u > 0.0 else tau)
        rate = decay - fast * value
    once = (first - value) / fast
    return rate, value, once, (second - once) / fast


@kernel
def settling_time(c, w2):
    """Time after which S' and S are below rounding, 1e-20 of their largest: S1 is 1/w2 then; inf where they stay."""
    half = 0.5 * c
    gap = half * half - w2
    rate = half if gap < 0.0 else w2 / (half + math.sqrt(gap))
    return SETTLED / rate if rate > 0.0 else math.inf
