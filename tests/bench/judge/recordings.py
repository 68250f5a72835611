"""Recordings as a user hands them in: a valve, its packing and instruments, driven through a test."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit

from tests.bench.judge.effects import Effect, Instruments, Scene
from tests.bench.judge.valves import (
    ROW_S,
    SUBSTEPS,
    FloatArray,
    Grade,
    Stem,
    Valve,
    coloured,
    move,
    roughen,
    stem_of,
    wander,
)
from valve.recording import Recording

_HOLD_S: Final = 0.3
_PERIODS_S: Final = (20.0, 10.0, 6.0, 5.0, 4.0, 3.5, 3.0, 2.6, 2.3)
# Triangles of several rates, rests on ramps, small loops: time in s and share of the range.
_RAMPS_WITH_RESTS: Final = (
    (0, 0), (4, 0.6), (4.3, 0.6), (5.1, 0.68), (5.4, 0.68), (6.2, 0.76), (6.4, 0.76), (7.2, 0.84), (7.5, 0.84),
    (8.6, 1), (12.7, 0.4), (12.9, 0.4), (13.6, 0.32), (13.9, 0.32), (14.6, 0.24), (14.9, 0.24), (15.7, 0.16),
    (16, 0.16), (17.1, 0), (21.1, 0.6), (21.4, 0.6), (22.1, 0.68), (29.8, 0.68), (30.7, 0.76), (30.9, 0.76),
    (31.7, 0.84), (32, 0.84), (33.1, 1), (37, 0.4), (37.4, 0.4), (38.1, 0.32), (45.9, 0.32), (46.6, 0.24),
    (46.9, 0.24), (47.7, 0.16), (47.9, 0.16), (49.1, 0),
)  # fmt: skip
_LOOPS: Final = ((9, 0.845), (15, 0.153), (21, 0.727), (27, 0.273), (33, 0.66), (39, 0.342), (42, 0.498), (48, 0))


def _triangles(periods_s: tuple[float, ...], hold_s: float = 0.0) -> list[tuple[float, float]]:
    points, now_s = [(0.0, 0.0)], 0.0
    for period_s in periods_s:
        for end in (1.0, 0.0):
            now_s += 0.5 * period_s
            points.append((now_s, end))
            if hold_s > 0.0:
                now_s += hold_s
                points.append((now_s, end))
    return points


def sequence(name: str) -> FloatArray:
    """Share of the range at each row of 1 ms; triangle, multi_rate, diagnostic or held_out."""
    if name == "triangle":
        points = _triangles((20.0, 20.0, 20.0))
    elif name == "multi_rate":
        points = _triangles(_PERIODS_S, _HOLD_S)
    elif name == "diagnostic":
        points = _triangles((20.0, 8.0, 5.0, 3.1, 2.3, 2.7))
        for part in (_RAMPS_WITH_RESTS, _LOOPS):
            begin_s = points[-1][0]
            points += [(begin_s + at_s, share) for at_s, share in part if at_s > 0]
    elif name == "held_out":  # another waveform: ramps to other ends at other rates
        points = [(0, 0), (6, 0.9), (9, 0.35), (13, 0.8), (16, 0.1), (20, 1.0), (26, 0.0), (30, 0.7), (35, 0.0)]
    else:
        raise ValueError(name)
    at_s, shares = np.array(points, dtype=float).T
    return np.asarray(np.interp(np.arange(0.0, at_s[-1] + 0.5 * ROW_S, ROW_S), at_s, shares))


@njit(cache=True)
def with_play(signal: FloatArray, width: float) -> FloatArray:
    """Return the signal behind lost motion of the width, in the signal's unit; it starts in the middle."""
    out = np.empty_like(signal)
    held = signal[0]
    for row in range(signal.size):
        held = min(max(held, signal[row] - 0.5 * width), signal[row] + 0.5 * width)
        out[row] = held
    return out


@njit(cache=True)
def filtered(signal: FloatArray, time_s: float) -> FloatArray:
    """Return the signal behind a first-order lag, exact for straight lines between the rows."""
    out = np.empty_like(signal)
    keep = np.exp(-1.0e-3 / time_s) if time_s > 0.0 else 0.0
    slope_share = 1.0 - time_s / 1.0e-3 * (1.0 - keep)
    out[0] = signal[0]
    for row in range(1, signal.size):
        step = signal[row] - signal[row - 1]
        out[row] = signal[row - 1] + step * slope_share + (out[row - 1] - signal[row - 1]) * keep
    return out


def _with_loop(signal: FloatArray, width: float) -> FloatArray:
    """Return the signal behind a hysteresis that is ``width`` wide in its middle and closed at its ends."""
    span = float(np.ptp(signal))
    widths = np.linspace(0.05, 0.95, 10) * span
    loop = np.asarray(sum((with_play(signal, one) - signal for one in widths), np.zeros_like(signal)))
    in_the_middle = float(np.minimum(widths, 0.5 * span).sum())
    return signal + loop * (width / in_the_middle if in_the_middle > 0.0 else 0.0)


def dead_at(signal: FloatArray, low: float, high: float) -> FloatArray:
    """Return the signal with its reading stuck while it is between the two limits, as it came in."""
    inside = (signal > low) & (signal < high)
    last = np.where(~inside, np.arange(signal.size), 0)
    return np.asarray(signal[np.maximum.accumulate(last)])


@dataclass(frozen=True, slots=True)
class Setting:
    """All that a case is made of but what is hidden; the seeds of its packing, its effects and its instruments."""

    valve: Valve
    grade: Grade
    sequence: str
    lag_s: float
    dead_time_s: float
    ends: tuple[float, float]  # of the sequence, shares of the range
    seed: int

    def random(self, what: str, number: int = 0) -> np.random.Generator:
        """Return a source of its own for each purpose."""
        return np.random.default_rng([self.seed, number, *what.encode()])


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One run through a sequence at rows of 1 ms: Pa and m, true and as measured, and what the model knows."""

    command_pa: FloatArray
    path_pa: FloatArray  # the command through a healthy path
    true_pa: FloatArray
    pressure_pa: FloatArray
    stem_m: FloatArray
    position_m: FloatArray
    drift_n: FloatArray
    varies_n: tuple[FloatArray, FloatArray]  # the roughness, opening and closing, over the stem's table
    at_m: FloatArray

    def recording(self, period_s: float, with_command: bool, with_pressure: bool = True) -> Recording:
        """Return what was recorded, one row a period."""
        each = slice(None, None, round(period_s / ROW_S))
        return Recording(
            time_s=np.asarray(ROW_S * np.arange(self.position_m.size)[each], dtype=np.float64),
            position_m=self.position_m[each],
            pressure_pa=self.pressure_pa[each] if with_pressure else None,
            command_pa=self.command_pa[each] if with_command else None,
        )


Hidden = tuple[tuple[Effect, float], ...]


def scene_of(setting: Setting, rows: int) -> Scene:
    """Return the travel that the mean law sweeps in the setting's own sequence, and its slowest ramp's speed."""
    valve = setting.valve
    low_pa, high_pa = (valve.range_pa[0] + share * (valve.range_pa[1] - valve.range_pa[0]) for share in setting.ends)
    high_m = (valve.area_m2 * high_pa - valve.F_0 - valve.F_c) / valve.k
    low_m = max(0.0, (valve.area_m2 * low_pa - valve.F_0 + valve.F_c) / valve.k)
    high_m = min(high_m, valve.travel_m)
    return Scene(low_m, high_m, (high_m - low_m) / 10.0, rows)


def run(setting: Setting, hidden: Hidden = (), *, number: int = 0, name: str = "", mean: Stem | None = None) -> Run:
    """Drive the valve; another ``number`` is another day: fresh wander, breakaways and noise, the same packing.

    ``name`` of the sequence in place of the setting's own; ``mean``: this stem without a packing, and no noise.
    """
    valve, grade = setting.valve, setting.grade
    low_pa, high_pa = valve.range_pa
    span_pa = high_pa - low_pa
    shares = setting.ends[0] + (setting.ends[1] - setting.ends[0]) * sequence(name or setting.sequence)
    command_pa = low_pa + span_pa * shares
    rows = command_pa.size
    scene = scene_of(setting, rows)
    stem, ways = stem_of(valve), Instruments(setting.dead_time_s, setting.lag_s)
    flat = np.zeros_like(stem.at_m)
    varies = (flat, flat)
    wandered = np.zeros(rows)
    fresh = setting.random("day", number)
    if mean is None:
        varies = roughen(stem, grade, setting.random("packing"))
        wandered = wander(rows, grade.wander * valve.F_c, fresh)
        stem.drift_n = wandered
    else:
        stem = replace(mean)
    for effect, size in hidden:
        effect.hide(stem, ways, size, scene, setting.random(effect.name))
    if ways.scatter is not None:
        stem.scatter = ways.scatter
    healthy = Instruments(setting.dead_time_s, setting.lag_s)
    path_pa = _through_path(command_pa, healthy)
    true_pa = _through_path(command_pa, ways)
    if mean is None:
        true_pa = true_pa + grade.hunting * span_pa * coloured(rows, 0.3, fresh)
    start_m = _start(valve, float(true_pa[0]))
    stem_m = move(stem, true_pa, start_m, fresh if mean is None else None)
    position_m = _read(stem_m, ways, grade, valve, fresh if mean is None else None)
    gauge_pa = true_pa if ways.gauge_offset_pa is None else true_pa + ways.gauge_offset_pa
    gauge_pa = filtered(gauge_pa, grade.gauge_filter_s)
    if mean is None and grade.gauge > 0.0:
        gauge_pa = gauge_pa + grade.gauge * span_pa * coloured(rows, grade.gauge_filter_s, fresh)
    return Run(command_pa, path_pa, true_pa, gauge_pa, stem_m, position_m, wandered, varies, stem.at_m)


def _start(valve: Valve, pressure_pa: float) -> float:
    """Return where the stem rests after it has closed, in the middle of what its friction holds, m."""
    return max(0.0, (valve.area_m2 * pressure_pa - valve.F_0 + 0.5 * valve.F_c) / valve.k)


def _through_path(command_pa: FloatArray, ways: Instruments) -> FloatArray:
    time_s = ROW_S * np.arange(command_pa.size)
    out = np.interp(time_s - ways.dead_time_s, time_s, command_pa)
    if ways.dead_band_pa > 0.0:
        out = with_play(out, ways.dead_band_pa)
    if ways.hysteresis_pa > 0.0:
        out = _with_loop(out, ways.hysteresis_pa)
    return np.minimum(filtered(out, ways.lag_s) * (1.0 - ways.leak), ways.limit_pa)


def _read(
    stem_m: FloatArray, ways: Instruments, grade: Grade, valve: Valve, rng: np.random.Generator | None
) -> FloatArray:
    out = with_play(stem_m, ways.play_m) if ways.play_m > 0.0 else stem_m
    if ways.read_as is not None:
        out = ways.read_as(out)
    if ways.dead_spot_m is not None:
        out = dead_at(out, *ways.dead_spot_m)
    if ways.offset_m is not None:
        out = out + ways.offset_m
    out = filtered(filtered(out, ways.position_lag_s), grade.filter_s)
    if rng is None:
        return out
    rows, travel_m = stem_m.size, valve.travel_m
    out = out + grade.white * travel_m * rng.standard_normal(rows)
    if grade.coloured > 0.0:
        out = out + grade.coloured * travel_m * coloured(rows, float(rng.uniform(0.01, 0.1)), rng)
    if grade.hum > 0.0:
        out = out + grade.hum * travel_m * np.sin(2 * np.pi * (50.0 * ROW_S * np.arange(rows) + rng.random()))
    if grade.bits:
        step_m = travel_m / 2.0**grade.bits
        out = np.round(out / step_m) * step_m
    return np.asarray(out)


def true_mean(setting: Setting, made: Run) -> Valve:
    """Return the law that an estimate is judged by: F_c and F_0 averaged over swept travel and recorded time.

    F_s is the expected force of a breakaway; one below the friction in motion counts as that.
    """
    valve = setting.valve
    swept = (made.at_m > made.stem_m.min()) & (made.at_m < made.stem_m.max())
    up_n, down_n = (float(part[swept].mean()) for part in made.varies_n)
    moving = np.abs(np.gradient(made.stem_m)) > 2.0 * valve.DV * ROW_S
    wandered_n = float(made.drift_n[moving].mean()) if moving.any() else 0.0
    F_c = valve.F_c + 0.5 * (up_n + down_n) + wandered_n
    drawn = valve.F_s * (1.0 + setting.grade.scatter * np.random.default_rng(1).standard_normal(20_000))
    F_s = float(np.maximum(drawn, valve.F_c).mean())
    return replace(valve, F_c=F_c, F_s=max(F_s, F_c), F_0=valve.F_0 + 0.5 * (up_n - down_n))


def mean_position(valve: Valve, pressure_pa: FloatArray, start_m: float, substeps: int = SUBSTEPS) -> FloatArray:
    """Return what the mean law makes of the pressure, m at each row, from where the stem stood."""
    return move(stem_of(valve), pressure_pa, start_m, None, substeps)


def nameplate(setting: Setting, *, mass: bool, bench_set: bool) -> str:
    """Return the valve's nameplate, TOML; its bench set is right to 0.3 % of the span."""
    valve, rng = setting.valve, setting.random("plate")
    ends = np.array([valve.F_0, valve.F_0 + valve.k * valve.travel_m]) / valve.area_m2
    ends = ends + rng.uniform(-0.003, 0.003, 2) * np.ptp(ends)
    lines = [
        f'tag = "{valve.name.upper()}"',
        "[actuator]",
        f"diaphragm_area_m2 = {valve.area_m2}",
        f"travel_m = {valve.travel_m}",
        'action = "spring"',
        *([f"moving_mass_kg = {valve.m:.3g}"] if mass else []),
        *([f"bench_set_pa = [{max(ends[0], 0.0):.0f}.0, {ends[1]:.0f}.0]"] if bench_set else []),
        "[signal]",
        "range_ma = [4.0, 20.0]",
        f"range_pa = [{valve.range_pa[0]}, {valve.range_pa[1]}]",
    ]
    return "\n".join(lines) + "\n"
