"""The modes of the Karnopp stem, and in which of them it goes on (Filippov at |v| = DV)."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.
# ruff: noqa: PLR0917 - kernels take flat numbers in order, so that other compiled code can call them
from __future__ import annotations

from typing import Final

from valve.kernel.compiled import kernel

STUCK: Final = 0  # at rest, held by static friction
BAND: Final = 1  # |v| < DV, accelerated by what exceeds F_s
SLIP: Final = 2  # |v| >= DV, Coulomb and viscous friction
SLIDE: Final = 3  # v = +-DV, between F_s and F_c + F_v DV
STOPPED: Final = 4  # at rest on a travel stop
FOLLOWED: Final = 0
TOO_MANY_EVENTS: Final = 1
ROOT_NOT_FOUND: Final = 2
TOO_MANY_STEPS: Final = 3


@kernel
def regime(k, F_v, F_c, F_s, DV, low, high, x, v, net, slope, rounding):
    """Return the mode in which the stem goes on, and its direction (the sign of v, in the band of the force)."""
    tol = 1.0e-11 * F_s + rounding
    if (x >= high and v >= 0.0) or (x <= low and v <= 0.0):
        away = -1.0 if x >= high else 1.0
        y = away * net - F_s
        leaves = y > tol or (y >= -tol and away * slope > 0.0)
        return (BAND if leaves else STOPPED), away
    if abs(v) > DV * (1.0 + 1.0e-12):
        return SLIP, (1.0 if v > 0.0 else -1.0)
    if abs(v) < DV * (1.0 - 1.0e-12):
        if F_s <= tol and abs(net) <= tol:
            # no static friction: as with very little of it, the stem is caught where the force passes zero
            return (BAND if v == 0.0 and slope != 0.0 else STUCK), (1.0 if slope > 0.0 else -1.0)
        s = 1.0 if net > 0.0 else -1.0
        y = s * net - F_s
        grows = s * (slope - k * v) > 0.0
        return (BAND if y > tol or (y >= -tol and grows) else STUCK), s
    # |v| = DV: the fields on both sides decide (Filippov)
    s = 1.0 if v > 0.0 else -1.0
    y, moving = s * net, F_c + F_v * DV
    rate = s * slope - k * DV
    flat = 1.0e-12 * (abs(slope) + k * DV)
    if y > moving + tol or (y >= moving - tol and rate > flat):
        return SLIP, s
    if y > F_s + tol or (y >= F_s - tol and moving >= F_s - tol and rate >= -flat):
        return SLIDE, s
    if y < -F_s - tol or (y <= -F_s + tol and rate < -flat and F_s > tol):
        return BAND, -s
    return STUCK, s
