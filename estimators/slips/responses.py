"""The impulse response of a slip with its derivatives to damping and stiffness, compiled."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
from __future__ import annotations

import math
from typing import Final

from estimators.compiled import kernel_of
from valve.kernel.response import INVERSE_FACTORIAL, impulse_response

_TERMS: Final = 9  # of the power series: to rounding

kernel = kernel_of(__file__)


@kernel
def folded(tau, c, w2, rate, value):
    """Return S * S and S * S', convolutions of the impulse response S: the derivatives of S to w2 and c, negative.

    S * S = (tau (S' + c S / 2) - S) / (2 g) with g = c^2 / 4 - w2, whose power series is taken where it cancels.
    """
    half = 0.5 * c
    gap = half * half - w2
    z = gap * tau * tau
    if abs(z) > 1.0:
        return (
            (tau * (rate + half * value) - value) / (2.0 * gap),
            (half * value - tau * (half * rate + w2 * value)) / (2.0 * gap),
        )
    once = twice = 0.0
    for n in range(_TERMS - 1, -1, -1):
        once = once * z + INVERSE_FACTORIAL[2 * n + 1]  # sinh(sqrt z) / sqrt z
        twice = twice * z + (2 * n + 2) * INVERSE_FACTORIAL[2 * n + 3]
    decayed = 0.5 * tau * tau * math.exp(-half * tau)
    return decayed * tau * twice, decayed * (once - half * tau * twice)


@kernel
def responses(tau, c, w2, out):
    """Put S', S, H = S' + c S and the derivatives of each to c and w2 into ``out``, shape (3, 3)."""
    rate, value, _, _ = impulse_response(tau, c, w2)
    twice, mixed = folded(tau, c, w2, rate, value)
    out[0, 0], out[0, 1], out[0, 2] = rate, value, rate + c * value
    out[1, 0], out[1, 1], out[1, 2] = c * mixed + w2 * twice - value, -mixed, w2 * twice
    out[2, 0], out[2, 1], out[2, 2] = -mixed, -twice, -(mixed + c * twice)
