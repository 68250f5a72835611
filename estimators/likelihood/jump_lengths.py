"""What the jumps of a stem that sticks and slips tell of its friction, and what not."""

from __future__ import annotations

import math
from typing import Final

from estimators.base import NORMAL_95

_UNSURE: Final = 0.5  # of F_s - F_c: the jumps are between one and two times (F_s - F_c)/k long


def beyond_balance(damping: float) -> float:
    """How far a jump goes beyond its balance, as a share of the way to it."""
    return math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)) if damping < 1.0 else 0.0


def coulomb_error_n(values: dict[str, float], viscous_error: float) -> float:
    """Return the least standard error of F_c, N, of jumps whose damping is known as far as F_v is, in N s/m.

    A jump is (F_s - F_c)/k (1 + exp(-pi z/sqrt(1 - z^2))) long, z = F_v/(2 sqrt(k m)): of one length, a jump of
    another damping has another F_s - F_c. An F_v that is not known, ``inf``, leaves half of it open.
    """
    stiction_n, unit = values["F_s"] - values["F_c"], 2.0 * math.sqrt(values["k"] * values["m"])
    length = 1.0 + beyond_balance(values["F_v"] / unit)
    ends = (max(0.0, values["F_v"] + sense * NORMAL_95 * viscous_error) / unit for sense in (-1.0, 1.0))
    farthest = max(abs(length / (1.0 + beyond_balance(end)) - 1.0) for end in ends) / NORMAL_95
    return stiction_n * (min(farthest, _UNSURE) if math.isfinite(viscous_error) else _UNSURE)


def of_jumps(least: dict[str, float], values: dict[str, float], rates_n_per_s: tuple[float, ...]) -> dict[str, float]:
    """Return the least standard errors of a stem that jumps: ramps of one rate show F_s + sqrt(2 m DV rate) alone.

    Which DV it is only the count of jumps seems to tell.
    """
    if len(rates_n_per_s) != 1:
        return least
    raised_n = math.sqrt(2.0 * values["m"] * values["DV"] * rates_n_per_s[0])
    return least | {"DV": values["DV"], "F_s": math.hypot(least["F_s"], raised_n / NORMAL_95)}
