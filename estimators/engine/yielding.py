"""A stem that yields before it breaks away, by what it does where the force turns.

A stem that friction holds stands still from where the force turns until it breaks away. One on bristles (Dahl, 1968)
follows by dF/dx = (F_s/deflection) (1 - F/F_m): it goes on by -deflection ln(1 - F/F_m) while friction turns its sign,
and gives way at F_s = 0.98 F_m. Neither is a slide or a breakaway, and how it starts shows neither mass nor damping.
One that creeps goes as fast as it is pushed: its way grows with time, and first on to where it came from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import NORMAL_95, student_95
from estimators.engine.balance import Balance, Blocks
from estimators.engine.breakaways import Breakaways
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.segmentation import moving_mean

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MOST_YIELD: Final = 0.04  # of the travel: what seems to yield by more is a spring or a reading that is bent
WAY: Final = 6.0  # deflections: ln(1.9 / 0.02) of them after the force turned a stem slides, with a margin
_HELD: Final = 0.5  # of F_c, against the force that turned: from here on its friction is followed
_INSIDE: Final = 0.8  # of F_c: so far below it nothing but bristles lets a stem move
_BEGINS: Final = 0.2  # of F_c: where it is followed from at the latest
_YIELDS: Final = 0.98  # of the bristles' largest force, at which they give way
_LAGS: Final = 1.0  # after a turn of the force a late stem still coasts
_PEAK: Final = 0.99  # quantile of the friction borne: the largest is noise
_FEWEST_ROWS: Final = 8
_FEWEST_TURNS: Final = 3
_SURE: Final = 5.0  # standard errors
_ALIKE: Final = 0.8  # of the turns at least, by their weight: the stem yields towards the force
_AS_DRIVEN: Final = 0.6  # of the driven speed, or the other way: a stem that slides
_SHORTEST_S: Final = 0.02
_SMOOTHED_S: Final = 0.005  # of the position, to see how far the stem went
_RATE_S: Final = 0.02
_GIVES: Final = 4.6  # deflections, ln(1.98 / 0.02), after which the bristles give way
_AWAY: Final = 5.0  # times the noise: surely gone so far


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A stem and the force that drives it, arrays of shape (n,), and when that force turns, s, shape (t,)."""

    time_s: FloatArray
    position_m: FloatArray
    force_n: FloatArray
    turns_s: FloatArray
    noise_m: float
    late_s: float = 0.0  # the force, in the middle of what it may be


@dataclass(frozen=True, slots=True)
class Held:
    """What a balance of forces says of a stem: k, N/m, F_0 and F_c, N, and how late it follows, s."""

    spring_n_per_m: float
    preload_n: float
    coulomb_n: float
    lag_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """What follows a turn of the force, arrays of shape (n,): friction, N, and way, m, towards that force."""

    first: int
    sign: float
    time_s: FloatArray
    towards_n: FloatArray
    way_m: FloatArray


def driven_of(reading: Reading) -> Driven:
    """Return the stem of a reading."""
    path = reading.path
    late_s = 0.5 * path.late_s if path.lag_s == 0.0 else 0.0
    return Driven(reading.time_s, reading.position_m, path.force_n, path.corners_s, reading.noise_m, late_s)


def yielding(driven: Driven, held: Held) -> Known | None:
    """Return the deflection by which the stem yields, m, None where it surely does not, or too few turns show it."""
    found = [one for turn in _turns(driven, held) if (one := _of_turn(turn, held.coulomb_n)) is not None]
    if len(found) < _FEWEST_TURNS:
        return None
    # a turn tells as much as the shape has squares in it: a fast one is over in a few rows
    each_m, weight, creeps = np.array(found).T
    if creeps.sum() > 0.0:
        return None
    share = weight / weight.sum()
    mean_m, many = float(share @ each_m), 1.0 / float(share @ share)
    if many <= _FEWEST_TURNS - 1:
        return None
    error_m = math.sqrt(float(share**2 @ (each_m - mean_m) ** 2) * many / (many - 1.0))
    error_m *= student_95(many - 1.0) / NORMAL_95
    is_alike = float(share @ (each_m > 0.0)) >= _ALIKE
    return Known(mean_m, error_m) if is_alike and mean_m > _SURE * error_m else None


def gave_way(driven: Driven, held: Held, deflection_m: float) -> Breakaways:
    """Return where the bristles gave way: the most friction that they bore, once after each turn of the force."""
    period_s = float(np.median(np.diff(driven.time_s)))
    half, back = max(1, round(0.5 * _SMOOTHED_S / period_s)), max(1, round(_RATE_S / period_s))
    far_m = _GIVES * deflection_m + _AWAY * driven.noise_m
    viscous = held.spring_n_per_m * max(held.lag_s, 0.0)
    rows = []
    for turn in _turns(driven, held):
        way_m = moving_mean(turn.way_m, 2 * half + 1)
        way_m -= way_m[0]
        beyond = np.flatnonzero(way_m > far_m)
        if not beyond.size:
            continue
        # as fast as it was: what it does next is no drag yet
        before_m = np.concatenate([np.full(min(back, way_m.size), way_m[0]), way_m[:-back]])
        borne_n = turn.towards_n - viscous * (way_m - before_m) / (back * period_s)
        number = int(np.argmax(borne_n[: int(beyond[0]) + 1]))
        now_s, force_n = float(driven.time_s[turn.first + number]), float(driven.force_n[turn.first + number])
        before_n, after_n = np.interp([now_s - _RATE_S, now_s + _RATE_S], driven.time_s, driven.force_n)
        rate = (float(after_n) - float(before_n)) / (2.0 * _RATE_S)
        if turn.sign * rate > 0.0:
            drag_n = turn.sign * float(turn.towards_n[number] - borne_n[number])
            place_m = float(driven.position_m[turn.first]) + turn.sign * float(way_m[number])
            rows.append((now_s, place_m, turn.sign, force_n - drag_n - driven.late_s * rate, rate))
    return Breakaways(*np.array(rows).reshape(-1, 5).T)


def _turns(driven: Driven, held: Held) -> Iterator[_Turn]:
    time_s, position_m, force_n = driven.time_s, driven.position_m, driven.force_n
    friction_n = force_n - held.spring_n_per_m * position_m - held.preload_n
    for turn_s, next_s in pairwise([*driven.turns_s.tolist(), float(time_s[-1])]):
        first, last = np.searchsorted(time_s, [turn_s + _LAGS * max(held.lag_s, 0.0), next_s])
        if last - first >= _FEWEST_ROWS:
            sign = math.copysign(1.0, float(force_n[last - 1] - force_n[first]))
            rows = slice(first, last)
            yield _Turn(
                int(first), sign, time_s[rows], sign * friction_n[rows], sign * (position_m[rows] - position_m[first])
            )


def _of_turn(turn: _Turn, coulomb_n: float) -> tuple[float, float, float] | None:
    """The deflection, m, by one turn, how much of it that shows, and by how many m^2 creep explains it better.

    None where it is hidden.
    """
    towards_n, way_m = turn.towards_n, turn.way_m
    # held on the other side at first, and then up to where it might break away
    over = np.flatnonzero(towards_n > _INSIDE * coulomb_n)
    rows = np.flatnonzero(towards_n[: int(over[0]) if over.size else 0] > -_HELD * coulomb_n)
    if rows.size < _FEWEST_ROWS or towards_n[0] > _BEGINS * coulomb_n:
        return None
    way_m, time_s, pushed_n = way_m[rows], turn.time_s[rows], towards_n[rows]
    deflection_m = _slope(way_m, _bristles(pushed_n, coulomb_n))[0]
    # F_s is about the most that the bristles bear, until they give way
    borne_n = towards_n[np.abs(turn.way_m) < WAY * abs(deflection_m)]
    static_n = max(coulomb_n, float(np.quantile(borne_n, _PEAK))) if borne_n.size else coulomb_n
    deflection_m, squares, explained = _slope(way_m, _bristles(pushed_n, static_n))
    creep = _slope(way_m, np.cumsum(pushed_n * np.gradient(time_s)))[2]
    if squares == 0.0:
        return None
    return deflection_m, squares, creep - explained


def _bristles(towards_n: FloatArray, static_n: float) -> FloatArray:
    """How many deflections a stem of this F_s has gone under this friction."""
    return np.asarray(-np.log1p(-towards_n * _YIELDS / static_n))


def _slope(way_m: FloatArray, shape: FloatArray) -> tuple[float, float, float]:
    """How much of a shape a way has in it, the shape's squares, and the way's that it explains, m^2."""
    away = shape - shape.mean()
    squares, common = float(away @ away), float(away @ way_m)
    return (common / squares, squares, common**2 / squares) if squares > 0.0 else (0.0, 0.0, 0.0)


def slides(
    reading: Reading,
    way_m: float,
    *,
    time_s: FloatArray,
    travel_m: FloatArray,
    duration_s: FloatArray,
    speed: FloatArray,
) -> BoolArray:
    """Whether a stem on bristles slides at these times and places, shape (n,); ``speed`` is the driven one, m/s.

    It does further than ``way_m`` from where the force turned last, about as fast as the force drives it: it is slower
    on its bristles, and faster when they give way.
    """
    times_s, position_m = reading.time_s, reading.position_m
    turned_s = np.concatenate([[times_s[0]], reading.path.corners_s])
    last_s = turned_s[np.maximum(np.searchsorted(turned_s, time_s) - 1, 0)]
    far = np.abs(travel_m - np.interp(last_s, times_s, position_m)) > way_m
    half_s = 0.5 * np.maximum(duration_s, _SHORTEST_S)
    before_m, after_m = (np.interp(time_s + side * half_s, times_s, position_m) for side in (-1.0, 1.0))
    passed_m, driven_m = np.abs(after_m - before_m), 2.0 * half_s * np.abs(speed)
    return np.asarray(far & (passed_m > _AS_DRIVEN * driven_m) & (_AS_DRIVEN * passed_m < driven_m))


def sliding_blocks(reading: Reading, blocks: Blocks, found: Balance, way_m: float) -> Blocks:
    """Return the blocks in which a stem on bristles slides."""
    speed = blocks.rate_n_per_s / found.known("k").value
    times_s, places_m, lengths_s = blocks.time_s, blocks.travel_m, blocks.duration_s
    kept = slides(reading, way_m, time_s=times_s, travel_m=places_m, duration_s=lengths_s, speed=speed)
    names = ("time_s", "travel_m", "rate_n_per_s", "force_n", "direction", "rows", "duration_s")
    return Blocks(*(getattr(blocks, name)[kept] for name in names))
