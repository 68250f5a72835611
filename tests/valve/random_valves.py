"""Random valves with random forces: every regime that the motion must follow, from explicit seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.parameters import TravelStops, ValveParameters

KINDS: Final = (
    "plain",
    "no_stiction",
    "critically_damped",
    "heavily_overdamped",
    "preloaded",
    "without_spring",
    "stopped",
    "undamped",
    "without_coulomb_friction",
    "stepped",
    "without_spring_or_damping",
)
DURATION_S: Final = 0.5
_CORNERS: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class RandomValve:
    """A valve, its stops, and the corners of a force of DURATION_S; it starts at rest at 0."""

    name: str
    parameters: ValveParameters
    stops: TravelStops
    force_time_s: npt.NDArray[np.float64]
    force_n: npt.NDArray[np.float64]


def _damping_ratio(kind: str, rng: np.random.Generator) -> float:
    fixed = {"critically_damped": 1.0, "undamped": 0.0, "heavily_overdamped": rng.uniform(10.0, 60.0)}
    return fixed.get(kind, rng.uniform(0.2, 3.0))


def random_valve(kind: str, seed: int) -> RandomValve:
    """One valve of this kind, with a force of five legs over most of a travel of 20 to 100 mm."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    m, k = rng.uniform(0.5, 5.0), 10.0 ** rng.uniform(4.0, 5.3)
    F_v = _damping_ratio(kind, rng) * 2.0 * math.sqrt(k * m)
    F_c = 0.0 if kind == "without_coulomb_friction" else rng.uniform(20.0, 1500.0)
    F_s = F_c if kind == "no_stiction" else max(F_c, 200.0) * rng.uniform(1.02, 1.4)
    F_0 = rng.uniform(-500.0, 3000.0) if kind == "preloaded" else 0.0
    travel_m = rng.uniform(0.02, 0.1)
    force_n = F_0 + F_c + k * travel_m * rng.uniform(-0.2, 1.0, _CORNERS)
    if kind.startswith("without_spring"):
        k, force_n = 0.0, rng.uniform(-3.0, 3.0, _CORNERS) * F_s
    if kind == "without_spring_or_damping":
        F_v, force_n = 0.0, 0.5 * force_n
    force_n[0] = F_0 + rng.uniform(-1.0, 1.0) * F_s  # in balance at the start
    inner_s = np.sort(rng.uniform(0.1, 0.9, _CORNERS - 2)) * DURATION_S
    force_time_s = np.concatenate(([0.0], inner_s, [DURATION_S]))
    if kind == "stepped":
        force_time_s, force_n = np.repeat(force_time_s, 2)[1:], np.repeat(force_n, 2)[:-1]
    stops = TravelStops(-0.1 * travel_m, 0.5 * travel_m) if kind == "stopped" else TravelStops()
    limit_velocity_m_per_s = 10.0 ** rng.uniform(-3.5, -2.0)
    parameters = ValveParameters(m, k, F_v, F_c, F_s, limit_velocity_m_per_s, F_0)
    return RandomValve(f"{kind}-{seed}", parameters, stops, force_time_s, force_n)


def random_valves(each: int, *, first_seed: int = 1) -> list[RandomValve]:
    """``each`` valves of every kind."""
    return [random_valve(kind, seed) for kind in KINDS for seed in range(first_seed, first_seed + each)]
