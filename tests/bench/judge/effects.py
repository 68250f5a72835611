"""What is hidden in a valve: each cause of the catalogue, and what is in no catalogue, by its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from tests.bench.judge.valves import ROW_S, FloatArray, Stem

Curve = Callable[[FloatArray], FloatArray]


@dataclass(slots=True)
class Instruments:
    """What stands before and after the stem: the way of the signal, and of the position; SI units."""

    dead_time_s: float = 0.0
    lag_s: float = 0.0
    dead_band_pa: float = 0.0
    hysteresis_pa: float = 0.0
    leak: float = 0.0
    limit_pa: float = np.inf
    scatter: float | None = None  # of the breakaways, in place of the packing's
    play_m: float = 0.0
    read_as: Curve | None = None  # position read over position
    position_lag_s: float = 0.0
    offset_m: FloatArray | None = None  # shape (rows,)
    dead_spot_m: tuple[float, float] | None = None
    gauge_offset_pa: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Scene:
    """The test that an effect is hidden in: travel that is swept, m, a ramp's speed, m/s, and the rows."""

    low_m: float
    high_m: float
    speed_m_per_s: float
    rows: int

    @property
    def time_s(self) -> FloatArray:
        """Time of each row."""
        return np.asarray(ROW_S * np.arange(self.rows), dtype=np.float64)

    def at(self, share: float) -> float:
        """Return a position inside the swept travel, m."""
        return self.low_m + share * (self.high_m - self.low_m)


Hide = Callable[[Stem, Instruments, float, Scene, np.random.Generator], None]


@dataclass(frozen=True, slots=True)
class Effect:
    """A cause with the range of its sizes; ``path``: it lies between command and pressure."""

    name: str
    hide: Hide
    smallest: float
    largest: float
    path: bool = False
    sequence: str = ""
    kin: tuple[str, ...] = field(default=())  # names that mean the same to a fitter


def _asymmetry(stem: Stem, _i: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    half = 0.5 * size * float(rng.choice([-1.0, 1.0]))
    stem.up_n, stem.static_up_n = stem.up_n * (1.0 + half), stem.static_up_n * (1.0 + half)
    stem.down_n, stem.static_down_n = stem.down_n * (1.0 - half), stem.static_down_n * (1.0 - half)


def _stribeck(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    excess_n = size * stem.valve.F_c
    more_n = max(0.0, stem.valve.F_c + excess_n - stem.valve.F_s)
    stem.falling_n, stem.falling_m_per_s = excess_n, float(rng.uniform(0.4, 2.5)) * scene.speed_m_per_s
    stem.static_up_n, stem.static_down_n = stem.static_up_n + more_n, stem.static_down_n + more_n


def _raise(stem: Stem, curve_n: FloatArray) -> None:
    for name in ("up_n", "down_n", "static_up_n", "static_down_n"):
        setattr(stem, name, getattr(stem, name) + curve_n)


def _local(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    centre_m, width_m = scene.at(float(rng.uniform(0.2, 0.8))), float(rng.uniform(0.015, 0.04)) * stem.valve.travel_m
    _raise(stem, size * stem.valve.F_c * np.exp(-0.5 * ((stem.at_m - centre_m) / width_m) ** 2))


def _seat(stem: Stem, _i: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    width_m = float(rng.uniform(0.03, 0.06)) * stem.valve.travel_m
    _raise(stem, size * stem.valve.F_c * np.exp(-0.5 * (stem.at_m / width_m) ** 2))


def _gradient(stem: Stem, _i: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    share = size * float(rng.choice([-1.0, 1.0])) * (stem.at_m / stem.valve.travel_m - 0.5)
    _raise(stem, stem.valve.F_c * np.maximum(share, -0.8))


def _drift(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    constant_s, sign = float(rng.uniform(20.0, 60.0)), float(rng.choice([-1.0, 1.0]))
    change_n = sign * size * stem.valve.F_c * (1.0 - np.exp(-scene.time_s / constant_s))
    stem.drift_n = change_n if stem.drift_n is None else stem.drift_n + change_n


def _pressure_dependent(stem: Stem, _i: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    stem.share = size


def _dwell(stem: Stem, _i: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    stem.dwell_n, stem.dwell_s = size * stem.valve.F_s, float(rng.uniform(1.0, 4.0))


def _presliding(stem: Stem, _i: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    stem.bristle_m = size * stem.valve.travel_m


def _push(stem: Stem, force_n: FloatArray) -> None:
    stem.push_n = force_n if stem.push_n is None else stem.push_n + force_n


def _preload(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    _push(stem, np.full(scene.rows, float(rng.choice([-1.0, 1.0])) * size * stem.valve.full_force_n))


def _hardening(stem: Stem, _i: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    stem.spring_n = stem.spring_n + 0.5 * size * stem.valve.k * stem.at_m**2 / stem.valve.travel_m


def _dual_rate(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    knee_m, sign = scene.at(float(rng.uniform(0.3, 0.7))), float(rng.choice([-1.0, 1.0]))
    stem.spring_n = stem.spring_n + sign * size * stem.valve.k * np.maximum(0.0, stem.at_m - knee_m)


def _area(stem: Stem, _i: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    stem.area_m2 = stem.area_m2 * (1.0 - size * (stem.at_m / stem.valve.travel_m - 0.5))


def _stop_low(stem: Stem, _i: Instruments, size: float, scene: Scene, _r: np.random.Generator) -> None:
    stem.low_m = scene.at(size)


def _stop_high(stem: Stem, _i: Instruments, size: float, scene: Scene, _r: np.random.Generator) -> None:
    stem.high_m = scene.at(1.0 - size)


def _flow(stem: Stem, _i: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    decay_m = float(rng.uniform(0.12, 0.3)) * stem.valve.travel_m
    stem.spring_n = stem.spring_n - size * stem.valve.full_force_n * np.exp(-stem.at_m / decay_m)


def _ip_lag(_t: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.lag_s += size


def _ip_delay(_t: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.dead_time_s += size


def _supply(stem: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    low_pa, high_pa = stem.valve.range_pa
    instruments.limit_pa = high_pa - size * (high_pa - low_pa)


def _leak(_t: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.leak = size


def _dead_band(stem: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.dead_band_pa = size * (stem.valve.range_pa[1] - stem.valve.range_pa[0])


def _hysteresis(stem: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.hysteresis_pa = size * (stem.valve.range_pa[1] - stem.valve.range_pa[0])


def _scatter(_t: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.scatter = size


def _play(stem: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.play_m = size * stem.valve.travel_m


def _bow(stem: Stem, instruments: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    travel_m, sign = stem.valve.travel_m, float(rng.choice([-1.0, 1.0]))
    instruments.read_as = lambda at_m: at_m + sign * size * 4.0 * at_m * (1.0 - at_m / travel_m)


def _position_lag(_t: Stem, instruments: Instruments, size: float, _s: Scene, _r: np.random.Generator) -> None:
    instruments.position_lag_s = size


def _vibration(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    _push(stem, size * stem.valve.full_force_n * np.sin(2 * np.pi * float(rng.uniform(4.0, 20.0)) * scene.time_s))


CATALOGUE: Final = {
    one.name: one
    for one in (
        Effect("friction_asymmetry", _asymmetry, 0.02, 0.8),
        Effect("stribeck_friction", _stribeck, 0.05, 0.8),
        Effect("local_friction", _local, 0.03, 1.2, kin=("seat_friction",)),
        Effect("friction_gradient", _gradient, 0.03, 1.4),
        Effect("friction_drift", _drift, 0.03, 0.8),
        Effect("pressure_dependent_friction", _pressure_dependent, 0.003, 0.15),
        Effect("dwell_dependent_breakaway", _dwell, 0.05, 1.0, sequence="diagnostic"),
        Effect("presliding", _presliding, 5.0e-4, 0.012, sequence="diagnostic"),
        Effect("spring_preload", _preload, 0.02, 0.25),
        Effect("spring_hardening", _hardening, 0.01, 0.5),
        Effect("dual_rate_spring", _dual_rate, 0.02, 0.6),
        Effect("diaphragm_area_change", _area, 0.01, 0.3),
        Effect("travel_stop_low", _stop_low, 0.01, 0.3),
        Effect("travel_stop_high", _stop_high, 0.01, 0.3),
        Effect("flow_force", _flow, 0.005, 0.3),
        Effect("transducer_lag", _ip_lag, 0.08, 1.0, path=True),
        Effect("transducer_dead_time", _ip_delay, 0.08, 0.8, path=True),
        Effect("supply_saturation", _supply, 0.03, 0.35, path=True),
        Effect("actuator_leak", _leak, 0.02, 0.2, path=True),
        Effect("position_backlash", _play, 0.002, 0.04, sequence="diagnostic"),
        Effect("position_nonlinearity", _bow, 0.002, 0.06),
        Effect("position_lag", _position_lag, 0.05, 0.5),
        Effect("vibration", _vibration, 0.003, 0.05),
        Effect("breakaway_scatter", _scatter, 0.12, 0.30, sequence="diagnostic"),
        Effect("positioner_dead_band", _dead_band, 0.004, 0.10, path=True),
        Effect("transducer_hysteresis", _hysteresis, 0.004, 0.10, path=True),
        Effect("seat_friction", _seat, 0.1, 3.0, kin=("local_friction",)),
    )
}
# A single rate and equal strokes do not show these, an ideal packing hides none.
TRIANGLE: Final = tuple(
    name
    for name in CATALOGUE
    if name not in {"dwell_dependent_breakaway", "presliding", "position_backlash", "breakaway_scatter", "vibration"}
)


def _bursts(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    more_n = np.zeros(scene.rows)
    for _ in range(int(rng.integers(4, 10))):
        begin_s, long_s = float(rng.uniform(0.0, scene.time_s[-1])), float(rng.uniform(0.3, 1.5))
        more_n[(scene.time_s > begin_s) & (scene.time_s < begin_s + long_s)] = size * stem.valve.F_c
    stem.drift_n = more_n if stem.drift_n is None else stem.drift_n + more_n


def _soft_spring(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    waves = sum(
        (np.sin(2 * np.pi * (scene.time_s / rng.uniform(5.0, 25.0) + rng.random())) for _ in range(3)),
        np.zeros(scene.rows),
    )
    stem.softness = size * np.asarray(waves)


def _bracket(stem: Stem, instruments: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    offset_m = np.zeros(scene.rows)
    for when in rng.uniform(0.15, 0.85, int(rng.integers(1, 4))):
        offset_m[int(when * scene.rows) :] += size * stem.valve.travel_m * float(rng.choice([-1.0, 1.0]))
    instruments.offset_m = offset_m


def _zero_creeps(stem: Stem, instruments: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    way = float(rng.choice([-1.0, 1.0]))
    instruments.offset_m = way * size * stem.valve.travel_m * scene.time_s / scene.time_s[-1]


def _dead_spot(stem: Stem, instruments: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    centre_m, half_m = scene.at(float(rng.uniform(0.25, 0.75))), 0.5 * size * stem.valve.travel_m
    instruments.dead_spot_m = (centre_m - half_m, centre_m + half_m)


def _broken_coil(stem: Stem, _i: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    when = int(float(rng.uniform(0.3, 0.7)) * scene.rows)
    _push(stem, np.where(np.arange(scene.rows) < when, 0.0, size * stem.valve.full_force_n))


def _gear(stem: Stem, instruments: Instruments, size: float, _s: Scene, rng: np.random.Generator) -> None:
    pitch_m = float(rng.uniform(0.06, 0.12)) * stem.valve.travel_m
    instruments.read_as = lambda at_m: at_m + size * stem.valve.travel_m * np.sin(2 * np.pi * at_m / pitch_m)


def _gauge_creeps(stem: Stem, instruments: Instruments, size: float, scene: Scene, rng: np.random.Generator) -> None:
    span_pa, way = stem.valve.range_pa[1] - stem.valve.range_pa[0], float(rng.choice([-1.0, 1.0]))
    instruments.gauge_offset_pa = way * size * span_pa * scene.time_s / scene.time_s[-1]


ODD: Final = {
    one.name: one
    for one in (
        Effect("sticking_bursts", _bursts, 0.05, 1.0),
        Effect("wandering_spring", _soft_spring, 0.003, 0.1),
        Effect("slipping_bracket", _bracket, 0.002, 0.05),
        Effect("creeping_zero", _zero_creeps, 0.003, 0.08),
        Effect("dead_spot", _dead_spot, 0.01, 0.10),
        Effect("broken_coil", _broken_coil, 0.005, 0.15),
        Effect("gear_error", _gear, 0.001, 0.02),
        Effect("creeping_gauge", _gauge_creeps, 0.004, 0.1),
    )
}
