"""What is in no catalogue: a Karnopp stem by fixed steps with friction and preload that change in time, and a sensor
that is not true. None of it may be given a name.

Semi-implicit Euler as in tests/support/extended_reference.py, with a slow creep of the stem at rest besides.
"""

# mypy: allow-untyped-defs
# numba types the loop from its arguments.
# ruff: noqa: PLR0917 - a compiled loop over flat numbers
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numba import njit

from valve.parameters import ValveParameters
from valve.recording import FloatArray

compiled: Any = njit(cache=True)
TABLE_STEP_S: Final = 0.01


@compiled
def integrate_odd(p, time, force, level, wander, table_step, creep, step, count, stride):
    """Return the position every ``stride`` of ``count`` steps, m, from rest at 0.

    ``p``: m, k, F_v, F_c, F_s, DV, F_0. ``level`` times friction and ``wander`` more preload, N, are straight in time
    between table steps. At rest the stem creeps at ``creep`` (net/F_s) m/s.
    """
    m, k, F_v, F_c, F_s, DV, F_0 = p
    positions = np.zeros(count // stride + 1)
    x, v, leg = 0.0, 0.0, 0
    for i in range(count + 1):
        if i % stride == 0:
            positions[i // stride] = x
        t = i * step
        while leg + 2 < time.size and time[leg + 1] <= t:
            leg += 1
        share = min((t - time[leg]) / (time[leg + 1] - time[leg]), 1.0)
        place = t / table_step
        row = min(int(place), level.size - 2)
        part = min(place - row, 1.0)
        times = level[row] + part * (level[row + 1] - level[row])
        net = force[leg] + share * (force[leg + 1] - force[leg]) - k * x - F_0
        net -= wander[row] + part * (wander[row + 1] - wander[row])
        side = 1.0 if net > 0.0 else -1.0
        held = abs(net) <= times * F_s
        if abs(v) < DV:
            v = 0.0 if held else v + step / m * (net - side * times * F_s)
            if held:
                x += step * creep * net / F_s
        else:
            sign = 1.0 if v > 0.0 else -1.0
            after = (v + step / m * (net - sign * times * F_c)) / (1.0 + step * F_v / m)
            v = 0.0 if held and (after * v < 0.0 or abs(after) < DV) else after
        x += step * v
    return positions


@dataclass(frozen=True, slots=True, eq=False)
class Oddity:
    """One drawn oddity: tables over time every TABLE_STEP_S, and what the sensor makes of a position."""

    name: str
    level: FloatArray
    wander_n: FloatArray
    zero_m: FloatArray  # added to the reading
    creep_m_per_s: float = 0.0
    hangs_s: tuple[tuple[float, float], ...] = field(default=())  # from when to when the reading stands still

    def position_m(
        self, parameters: ValveParameters, corners: tuple[FloatArray, FloatArray], duration_s: float, steps: Steps
    ) -> FloatArray:
        """Clean position of the stem every ``steps.output_s``, m, from rest at 0."""
        count, stride = round(duration_s / steps.step_s), round(steps.output_s / steps.step_s)
        values = tuple(parameters.by_symbol().values())
        found: FloatArray = integrate_odd(
            values, *corners, self.level, self.wander_n, TABLE_STEP_S, self.creep_m_per_s, steps.step_s, count, stride
        )
        return found

    def sensed_m(self, time_s: FloatArray, position_m: FloatArray) -> FloatArray:
        """What the sensor shows of positions at these times, m."""
        shown = position_m + np.interp(time_s, np.arange(self.zero_m.size) * TABLE_STEP_S, self.zero_m)
        for from_s, to_s in self.hangs_s:
            hanging = (time_s >= from_s) & (time_s < to_s)
            if hanging.any():
                shown[hanging] = shown[int(hanging.argmax())]
        return shown


@dataclass(frozen=True, slots=True)
class Steps:
    """How finely a motion is integrated and put out, s."""

    step_s: float
    output_s: float


ODDITIES: Final = (
    "bursts_of_sticking",
    "wandering_spring",
    "slipping_bracket",
    "creeping_stem",
    "wandering_zero",
    "hanging_sensor",
)


def wander(rng: np.random.Generator, count: int, correlation_s: float) -> FloatArray:
    """A smooth random walk about 0 with unit standard deviation, every TABLE_STEP_S."""
    width = correlation_s / TABLE_STEP_S
    reach = np.arange(-int(3 * width), int(3 * width) + 1) / width
    kernel = np.exp(-0.5 * reach**2)
    white = rng.standard_normal(count + reach.size - 1)
    smooth = np.convolve(white, kernel, mode="valid")
    return np.asarray(smooth / np.sqrt(np.sum(kernel**2)))


def drawn_oddity(
    name: str, rng: np.random.Generator, duration_s: float, travel_m: float, full_force_n: float
) -> Oddity:
    """The oddity of this name, its size drawn; all of it lies within ``duration_s``."""
    count = int(duration_s / TABLE_STEP_S) + 2
    one, none = np.ones(count), np.zeros(count)
    walk = wander(rng, count, float(rng.uniform(2.0, 8.0)))
    starts_s = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(4, 8)))) * duration_s
    if name == "bursts_of_sticking":
        level = one.copy()
        for start_s in starts_s:
            first, last = start_s / TABLE_STEP_S, (start_s + float(rng.uniform(0.3, 2.0))) / TABLE_STEP_S
            level[int(first) : int(last)] = float(rng.uniform(1.5, 3.0))
        return Oddity(name, level, none, none)
    if name == "wandering_spring":
        return Oddity(name, one, float(rng.uniform(0.005, 0.03)) * full_force_n * walk, none)
    if name == "creeping_stem":
        return Oddity(name, one, none, none, creep_m_per_s=float(rng.uniform(0.002, 0.01)) * travel_m)
    if name == "slipping_bracket":
        zero_m = none.copy()
        for start_s in starts_s:
            zero_m[int(start_s / TABLE_STEP_S) :] += float(rng.uniform(-0.03, 0.03)) * travel_m
        return Oddity(name, one, none, zero_m)
    if name == "wandering_zero":
        return Oddity(name, one, none, float(rng.uniform(0.003, 0.02)) * travel_m * walk)
    if name == "hanging_sensor":
        hangs_s = tuple((float(at), float(at + rng.uniform(0.3, 2.0))) for at in starts_s)
        return Oddity(name, one, none, none, hangs_s=hangs_s)
    raise KeyError(name)
