"""Where else the cost may be low, seen from a low place: along what a test hardly tells apart."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Final

from estimators.likelihood.inputs.transducer_path import LAG
from estimators.likelihood.jump_lengths import beyond_balance
from estimators.likelihood.model import StemModel
from estimators.samples import FloatArray

# Own choices: factors of one parameter, the others changed so that what the test shows best stays as it is.
_LIMITS: Final = (0.1, 10.0, 0.3, 3.0)
_LIMIT_SPEEDS: Final = (0.4, 1.0, 1.5)  # of the sliding speed
_VISCOUS: Final = (0.3, 3.0, 0.03)
_MASSES: Final = (0.33, 3.0, 0.1, 10.0)
_DAMPINGS: Final = (0.03, 0.1, 0.3, 0.8)
_NEAR_DAMPINGS: Final = (0.6, 0.8, 1.25, 1.6)  # of the own: what a walk along the valley cannot pass a sill for
_LIMITS_OF_JUMPS: Final = (0.02, 0.15, 1.0, 5.0)
_RATIOS: Final = (0.8, 1.25, 0.6)
_LAG_SHARES: Final = (0.98, 0.5, 0.02)  # of lag + F_v/k
_LAG_RATIOS: Final = (0.02, 0.1)  # F_s/F_c - 1, beside the own: a lag's corners look like stiction
_OFF_SIGMAS: Final = 4.0  # of the first row of a section at rest: it was not at rest there
_MOST_SECTIONS: Final = 4  # begun anew, each alone


def ratio_kept(here: dict[str, float], other: dict[str, float], rate_n_per_s: float) -> float:
    """F_s/F_c - 1 with which ``other`` values break away as these do on a ramp of this rate: F_s + sqrt(2 m DV r)."""
    effective_n = here["F_c"] * (1.0 + here["d"]) + math.sqrt(2.0 * here["m"] * here["DV"] * rate_n_per_s)
    static_n = effective_n - math.sqrt(2.0 * other["m"] * other["DV"] * rate_n_per_s)
    return max(0.0, static_n / other["F_c"] - 1.0)


def hops(model: StemModel, point: FloatArray, speed_m_per_s: float, *, jumps: bool) -> Iterator[FloatArray]:
    """Yield points (p,) far from this one that explain nearly the same.

    F_v against F_c at one F_c + F_v v and one F_s; DV, and DV at the speed of the ramps; m, alone and with F_v (one
    time constant m/F_v); F_s - F_c. Of a stem that ``jumps`` the length of the jumps is kept.
    """
    here = model.coordinates.values(point)
    static_n = here["F_c"] * (1.0 + here["d"])
    moving_n = here["F_c"] + here["F_v"] * speed_m_per_s

    def at(**changed: float) -> FloatArray:
        values = here | changed
        if "d" not in changed:
            values["d"] = ratio_kept(here, values, here["k"] * speed_m_per_s)
        return model.coordinates.point(values)

    def with_viscous(viscous: float, **changed: float) -> FloatArray:
        viscous = min(viscous, 0.98 * moving_n / speed_m_per_s)
        return at(F_v=viscous, F_c=moving_n - viscous * speed_m_per_s, **changed)

    def jumping(damping: float, **changed: float) -> FloatArray:
        stiction_n = here["F_c"] * here["d"] * (1.0 + beyond_balance(own)) / (1.0 + beyond_balance(damping))
        coulomb_n = max(static_n - stiction_n, 0.02 * static_n)
        return at(F_v=2.0 * damping * math.sqrt(here["k"] * here["m"]), F_c=coulomb_n, **changed)

    yield from _begun_anew(model, here)
    own = 0.5 * here["F_v"] / math.sqrt(here["k"] * here["m"])
    if jumps:
        for damping, factor in product(_DAMPINGS, _LIMITS_OF_JUMPS):
            yield jumping(damping, DV=factor * here["DV"])
        for factor in _NEAR_DAMPINGS:
            yield jumping(factor * own)
        for factor in _LIMITS_OF_JUMPS:
            yield jumping(own, DV=factor * here["DV"])
        for factor in _MASSES:
            yield at(m=factor * here["m"])
        return
    for factor in _VISCOUS:
        yield with_viscous(factor * here["F_v"])
    for factor in _LIMITS:
        yield at(DV=factor * here["DV"])
    for factor in _MASSES:
        yield at(m=factor * here["m"])
    yield with_viscous(0.5 * moving_n / speed_m_per_s)
    for share in _LIMIT_SPEEDS:
        yield at(DV=share * speed_m_per_s)
    for factor in _MASSES[:2]:
        yield with_viscous(factor * here["F_v"], m=factor * here["m"])
    for factor in _RATIOS:
        yield at(d=factor * here["d"] if here["d"] > 0.0 else factor - 0.5)
    if LAG in here:
        # two lags in series, that of the I/P and F_v/k of an overdamped stem, may change places but for friction
        both_s = here[LAG] + here["F_v"] / here["k"]
        for share, ratio in product(_LAG_SHARES, (here["d"], *_LAG_RATIOS)):
            yield at(F_v=(1.0 - share) * both_s * here["k"], d=ratio, **{LAG: share * both_s})
    # small DV and large DV change places with F_v
    for factor in (0.1, 10.0):
        yield with_viscous(here["F_v"] / 3.0, DV=factor * here["DV"])
        yield with_viscous(here["F_v"] * 3.0, DV=factor * here["DV"])


def _begun_anew(model: StemModel, here: dict[str, float]) -> Iterator[FloatArray]:
    """Yield points with the sections in motion begun as they were measured: all of them, and each alone.

    Between two rows a stem that rings may turn once more or once less, so that a section's first speed has many places.
    """
    own = model.coordinates
    begun: list[dict[str, float]] = []
    for number, row in enumerate(model.section_row):
        entry = next((entry for entry in own.entries if entry.name == f"v_{number}"), None)
        at_m = float(model.position_m[row])
        if entry is not None:
            begun.append({f"x_{number}": at_m, entry.name: entry.value(entry.prior)})
        elif abs(here[f"x_{number}"] - at_m) * model.weight[row] > _OFF_SIGMAS:
            begun.append({f"x_{number}": at_m})
    if len(begun) > 1:
        yield own.point(here | {name: value for section in begun for name, value in section.items()})
    for section in begun[:_MOST_SECTIONS]:
        yield own.point(here | section)
