"""The compiled jump of a stem on a ramp: its breakaway below DV and its slip until it is as slow as DV again."""

# mypy: allow-untyped-defs
# numba types each kernel from its arguments, as in valve.kernel
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve.kernel.compiled import kernel
from valve.kernel.mode_steps import band_step, slip_step

_SWINGS: Final = 3.0  # of the stem and of its settling: a slip that lasts longer is no jump
_ROUNDS: Final = 60
_SETTLED: Final = 1.0e-14  # of the jump's length


@kernel
def breakaway(m, k, DV, rate):
    """Return by how much the force has risen above F_s, N, and the way, m, where the stem reaches DV; NaN if never."""
    dwell, _ended, x, v = band_step(
        m, k / m, 0.0, DV, -math.inf, math.inf, 1.0, 0.0, 0.0, 0.0, rate / m, 0.0, rate, math.inf
    )
    return (rate * dwell, x) if v == DV else (math.nan, math.nan)


@kernel
def jump_length(m, k, F_v, DV, rate, before, excess):
    """Return the length, m, of a jump whose breakaway, ``before`` m long, ends ``excess`` N above F_c; or NaN."""
    net = excess - k * before - F_v * DV
    if not net > 0.0:
        return math.nan
    w2, c, longest = k / m, F_v / m, _SWINGS * (2.0 * math.pi * math.sqrt(m / k) + F_v / k)
    _dwell, ended, x, _v = slip_step(
        c, w2, DV, -math.inf, math.inf, 1.0, 0.0, DV, net / m, rate / m - w2 * DV, rate / m, longest,
        np.full(5, math.nan),
    )  # fmt: skip
    return before + x if ended else math.nan


@kernel
def jump_excess(m, k, F_v, DV, rate, before, length):
    """Return the force above F_c, N, with which a jump gets this length; NaN where none does.

    The stem goes beyond its balance, so that it is at most k times the length.
    """
    low, high = k * before + F_v * DV, k * length + F_v * DV
    miss_low, miss_high = before - length, jump_length(m, k, F_v, DV, rate, before, high) - length
    if not miss_high >= 0.0 or not miss_low < 0.0:
        return math.nan
    for n in range(_ROUNDS):
        trial = low + (high - low) * miss_low / (miss_low - miss_high) if n % 3 < 2 else 0.5 * (low + high)
        miss = jump_length(m, k, F_v, DV, rate, before, trial) - length
        if abs(miss) <= _SETTLED * length or high - low <= _SETTLED * high:
            return trial
        if miss >= 0.0:
            high, miss_high = trial, miss
        else:  # too short, or one that does not end: the force has to be larger
            low = trial
            if miss < 0.0:
                miss_low = miss
    return 0.5 * (low + high)
