"""Valves by fixed steps: the stem's motion under friction that scatters, and the packings that make it do so."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

ROW_S: Final = 1.0e-3  # of all arrays over time
SUBSTEPS: Final = 50  # of 0.02 ms
_CELLS: Final = 2001  # of the tables along the travel, 0.05 % of it each
_OUTSIDE: Final = 0.02  # of the travel, that the tables reach beyond both ends
_BRISTLE_SPEED_M_PER_S: Final = 5.0e-4  # at which a stem on bristles has left its static friction
_BRISTLE_DAMPING: Final = 0.3  # of the critical one


@dataclass(frozen=True, slots=True)
class Valve:
    """A valve's mean law in SI units: m x'' = S_a P - F_0 - k x - friction, Karnopp's friction (Eq. 1-2)."""

    name: str
    m: float
    k: float
    F_v: float
    F_c: float
    F_s: float
    DV: float
    F_0: float
    area_m2: float
    travel_m: float
    range_pa: tuple[float, float]

    @property
    def full_force_n(self) -> float:
        """Force of the whole range of the signal."""
        return self.area_m2 * (self.range_pa[1] - self.range_pa[0])


def _usual_range(name: str, m: float, travel_m: float, area_m2: float, shares: tuple[float, float, float]) -> Valve:
    """Return a valve of 20 to 100 kPa; ``shares``: F_c of the force, F_s of F_c, F_v of 2 sqrt(m k)."""
    k = area_m2 * 80.0e3 / travel_m
    F_c = shares[0] * k * travel_m
    F_v = 2.0 * shares[2] * float(np.sqrt(m * k))
    return Valve(name, m, k, F_v, F_c, shares[1] * F_c, 2.0e-4, area_m2 * 20.0e3, area_m2, travel_m, (20.0e3, 100.0e3))


VALVES: Final = {
    one.name: one
    for one in (
        Valve("vendor", 1.3608, 52538.0, 612.9, 44.48, 50.0, 1.5e-4, 0.0, 0.06452, 0.1016, (0.0, 82737.0)),
        Valve("nominal", 1.3608, 52538.0, 612.9, 1423.4, 1708.1, 1.5e-4, 0.0, 0.06452, 0.1016, (0.0, 82737.0)),
        Valve("rough", 1.3608, 52538.0, 1225.9, 2241.1, 2668.9, 1.5e-4, 0.0, 0.06452, 0.1016, (0.0, 110.0e3)),
        Valve("graphite", 1.6, 206941.0, 70501.0, 665.0, 942.0, 1.0e-4, 2571.0, 0.0445, 0.0286, (57.8e3, 190.8e3)),
        _usual_range("small", 0.8, 0.020, 0.012, (0.07, 1.22, 1.1)),
        _usual_range("large", 22.0, 0.060, 0.155, (0.09, 1.18, 1.15)),
    )
}


def drawn(name: str, rng: np.random.Generator) -> Valve:
    """Return a valve of the name with every value up to 15 % off, the spring by 5 %: no two are alike."""
    base = VALVES[name]

    def about(value: float, by: float = 0.15) -> float:
        return value * float(rng.uniform(1.0 - by, 1.0 + by))

    F_c = about(base.F_c)
    return replace(
        base,
        m=about(base.m),
        k=about(base.k, 0.05),
        F_v=about(base.F_v),
        F_c=F_c,
        F_s=F_c * (1.0 + about(base.F_s / base.F_c - 1.0, 0.2)),
        F_0=about(base.F_0, 0.03),
    )


@dataclass(frozen=True, slots=True)
class Grade:
    """How a packing and its instruments are; shares of F_s, F_c, travel and pressure range, and s."""

    scatter: float
    roughness: float
    wander: float
    white: float  # of the position
    coloured: float
    hum: float
    bits: int  # of the position's converter; 0: none
    filter_s: float
    gauge: float  # noise of the pressure behind its filter
    gauge_filter_s: float
    hunting: float  # of the true pressure


GRADES: Final = {
    "ideal": Grade(0.0, 0.0, 0.0, 2.0e-4, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0),
    "mild": Grade(0.01, 0.005, 0.002, 1.0e-4, 0.0, 0.0, 0, 0.002, 3.0e-4, 0.003, 0.0),
    "usual": Grade(0.025, 0.015, 0.006, 1.0e-4, 3.0e-5, 5.0e-5, 14, 0.005, 1.0e-3, 0.008, 3.0e-4),
    "hard": Grade(0.06, 0.04, 0.015, 1.5e-4, 8.0e-5, 1.0e-4, 13, 0.020, 3.0e-3, 0.020, 1.0e-3),
}


@dataclass(slots=True)
class Stem:
    """What moves a stem: tables of forces over travel, N, scalars in SI, and what changes with time.

    An effect changes these; as ``stem_of`` makes them they are the valve's mean law.
    """

    valve: Valve
    at_m: FloatArray
    spring_n: FloatArray
    area_m2: FloatArray
    up_n: FloatArray
    down_n: FloatArray
    static_up_n: FloatArray
    static_down_n: FloatArray
    low_m: float
    high_m: float
    share: float = 0.0  # friction grows by this share of the actuator's force
    falling_n: float = 0.0  # Stribeck: friction above F_c at small speed
    falling_m_per_s: float = 1.0
    dwell_n: float = 0.0
    dwell_s: float = 1.0
    bristle_m: float = 0.0
    scatter: float = 0.0
    drift_n: FloatArray | None = None  # shape (rows,): friction added over time
    push_n: FloatArray | None = None  # a further force
    softness: FloatArray | None = None  # share of the spring's force that is lost
    extras: dict[str, float] = field(default_factory=dict)


def stem_of(valve: Valve) -> Stem:
    """Return the stem of the mean law, without scatter or roughness."""
    reach_m = _OUTSIDE * valve.travel_m
    at_m = np.linspace(-reach_m, valve.travel_m + reach_m, _CELLS)
    flat = np.ones(_CELLS)
    levels = (valve.F_c * flat, valve.F_c * flat, valve.F_s * flat, valve.F_s * flat)
    return Stem(
        valve, at_m, valve.k * at_m, valve.area_m2 * flat, *levels, low_m=float(at_m[1]), high_m=float(at_m[-2])
    )


def roughen(stem: Stem, grade: Grade, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Give the stem a packing: roughness along the travel and breakaways that scatter.

    Returns what friction varies by, opening and closing, N over ``at_m``. The shape is a sum of random bumps of one
    length, 1 to 5 % of the travel, in part common to both directions.
    """
    valve, length_m = stem.valve, float(rng.uniform(0.01, 0.05)) * stem.valve.travel_m
    common = float(rng.uniform(0.4, 0.8))

    def bumps() -> FloatArray:
        centres = rng.uniform(stem.at_m[0] - 2 * length_m, stem.at_m[-1] + 2 * length_m, 400)
        heights = rng.standard_normal(centres.size)
        distance = np.abs(stem.at_m[:, None] - centres) / length_m
        sum_ = np.maximum(0.0, 1.0 - distance) @ heights if rng.random() < 0.5 else np.exp(-(distance**2)) @ heights
        return np.asarray(sum_ / sum_.std())

    shared, size_n = bumps(), grade.roughness * valve.F_c
    parts = [size_n * (np.sqrt(common) * shared + np.sqrt(1.0 - common) * bumps()) for _ in range(2)]
    stem.up_n = stem.up_n + parts[0]
    stem.down_n = stem.down_n + parts[1]
    stem.static_up_n = stem.static_up_n * (1.0 + parts[0] / valve.F_c)
    stem.static_down_n = stem.static_down_n * (1.0 + parts[1] / valve.F_c)
    stem.scatter = grade.scatter
    return parts[0], parts[1]


def wander(rows: int, size_n: float, rng: np.random.Generator) -> FloatArray:
    """Friction that wanders, N, shape (rows,): an Ornstein-Uhlenbeck path, two slow waves or a random walk."""
    if size_n == 0.0:
        return np.zeros(rows)
    time_s, law = ROW_S * np.arange(rows), int(rng.integers(3))
    if law == 0:
        shape = coloured(rows, float(rng.uniform(15.0, 60.0)), rng)
    elif law == 1:
        shape = sum(
            (np.sin(2 * np.pi * (time_s / rng.uniform(20.0, 100.0) + rng.random())) for _ in range(2)), np.zeros(rows)
        )
    else:
        shape = np.cumsum(rng.standard_normal(rows)) / np.sqrt(rows) * 2.0
        shape -= shape.mean()
    return np.asarray(size_n * shape)


def coloured(rows: int, time_s: float, rng: np.random.Generator) -> FloatArray:
    """First-order coloured noise of size 1, shape (rows,)."""
    keep = float(np.exp(-ROW_S / time_s))
    path = rng.standard_normal(rows)
    path[1:] *= np.sqrt(1.0 - keep**2)
    return _lagged(path, keep)


@njit(cache=True)
def _lagged(path: FloatArray, keep: float) -> FloatArray:
    for row in range(1, path.size):
        path[row] += keep * path[row - 1]
    return path


def move(
    stem: Stem,
    pressure_pa: FloatArray,
    start_m: float,
    rng: np.random.Generator | None = None,
    substeps: int = SUBSTEPS,
) -> FloatArray:
    """Stem position at each row, m, under the true pressure, Pa, both shape (rows,); it starts at rest.

    Without ``rng`` no breakaway differs from the next.
    """
    rows, valve = pressure_pa.size, stem.valve
    start_m = min(max(start_m, stem.low_m), stem.high_m)
    nothing = np.zeros(rows)
    factors = np.ones(20_000)
    if rng is not None and stem.scatter > 0.0:
        factors += stem.scatter * np.clip(rng.standard_normal(factors.size), -3.0, 3.0)
    scalars = np.array(
        [
            valve.m, valve.F_v, valve.DV, valve.F_0, stem.low_m, stem.high_m, stem.share, stem.falling_n,
            stem.falling_m_per_s, stem.dwell_n, stem.dwell_s, stem.bristle_m, valve.F_c, start_m,
        ]
    )  # fmt: skip
    in_time = np.stack([nothing if one is None else one for one in (stem.drift_n, stem.push_n, stem.softness)])
    tables = np.stack(
        [stem.spring_n, stem.area_m2, stem.up_n, stem.down_n, stem.static_up_n, stem.static_down_n]
    )  # fmt: skip
    return np.asarray(_moved(pressure_pa, in_time, tables, stem.at_m, scalars, factors, substeps))


@njit(cache=True)
def _moved(  # noqa: PLR0917 - numba takes them by position
    pressure_pa: FloatArray,
    in_time: FloatArray,
    tables: FloatArray,
    at_m: FloatArray,
    scalars: FloatArray,
    factors: FloatArray,
    substeps: int,
) -> FloatArray:
    """Semi-implicit Euler steps of Eq. 1-2, or of LuGre's bristles; a stop is rigid and takes all speed."""
    m, F_v, DV, F_0, low_m, high_m, share, falling, falling_v, dwell_n, dwell_s, bristle_m, F_c, x = scalars
    rows = pressure_pa.size
    out = np.empty(rows)
    dt = 1.0e-3 / substeps
    first_m, cell_m, cells = at_m[0], at_m[1] - at_m[0], at_m.size
    v, z, travelled = 0.0, 0.0, 0.0
    resting, rested_s, breakaway = True, 10.0, 0
    stiffness = F_c / bristle_m if bristle_m > 0.0 else 0.0
    damping = 2.0 * _BRISTLE_DAMPING * np.sqrt(stiffness * m)
    if bristle_m > 0.0:  # the bristles hold the stem where it starts
        z = (tables[1, 0] * pressure_pa[0] - F_0 - np.interp(x, at_m, tables[0])) / stiffness
    for row in range(rows):
        out[row] = x
        following = min(row + 1, rows - 1)
        for step in range(substeps):
            part = step / substeps
            place = (x - first_m) / cell_m
            cell = min(max(int(place), 0), cells - 2)
            inside = place - cell
            spring = tables[0, cell] + inside * (tables[0, cell + 1] - tables[0, cell])
            area = tables[1, cell] + inside * (tables[1, cell + 1] - tables[1, cell])
            actuator = area * (pressure_pa[row] + part * (pressure_pa[following] - pressure_pa[row]))
            push = in_time[1, row] + part * (in_time[1, following] - in_time[1, row])
            force = actuator - F_0 - spring * (1.0 - in_time[2, row]) + push
            way = 1.0 if (v > 0.0 or (v == 0.0 and force > 0.0)) else -1.0
            table = 2 if way > 0.0 else 3
            more = in_time[0, row] + share * max(actuator, 0.0)
            level = tables[table, cell] + inside * (tables[table, cell + 1] - tables[table, cell]) + more
            static = tables[table + 2, cell] + inside * (tables[table + 2, cell + 1] - tables[table + 2, cell])
            limit = max((static + more) * factors[breakaway], level)
            if dwell_n > 0.0:
                limit += dwell_n * (1.0 - np.exp(-rested_s / dwell_s))
            if bristle_m > 0.0:
                bound = level + (limit - level) * np.exp(-((v / _BRISTLE_SPEED_M_PER_S) ** 2))
                z_new = (z + v * dt) / (1.0 + stiffness * abs(v) * dt / bound)
                friction = stiffness * z_new + damping * (z_new - z) / dt
                z = z_new
                v_new = (v + dt / m * (force - friction)) / (1.0 + dt * F_v / m)
                travelled += abs(v_new) * dt
                if v_new * v < 0.0 and travelled > 5.0 * bristle_m:
                    breakaway, travelled = (breakaway + 1) % factors.size, 0.0
                v = v_new
                x += v * dt
                continue
            if resting:
                rested_s += dt
                if (x <= low_m and force < 0.0) or (x >= high_m and force > 0.0) or abs(force) <= limit:
                    continue
                resting = False
            if abs(v) < DV and abs(force) <= limit:
                v, resting, rested_s, breakaway = 0.0, True, 0.0, (breakaway + 1) % factors.size
                continue
            if abs(v) < DV:
                v_new = v + dt / m * (force - (1.0 if force > 0.0 else -1.0) * limit)
            else:
                friction = level + falling * np.exp(-((v / falling_v) ** 2))
                v_new = (v + dt / m * (force - way * friction)) / (1.0 + dt * F_v / m)
                if v_new * v < 0.0:
                    v_new = 0.0
            v = v_new
            x += v * dt
            if (x < low_m and v < 0.0) or (x > high_m and v > 0.0):
                x = min(max(x, low_m), high_m)
                v, resting, rested_s, breakaway = 0.0, True, 0.0, (breakaway + 1) % factors.size
    return out
