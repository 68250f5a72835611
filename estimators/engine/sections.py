"""The sections that the dynamic fit works on: one a breakaway, with the rows that it is fitted to, fixed beforehand.

Rows stand alone where the stem accelerates, after a breakaway and around a corner, and are averaged elsewhere. They
are chosen once, by what was measured: rows that came and went with the parameters would make the likelihood jump.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.nodes import Section, Sections
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.segmentation import Move
from estimators.engine.stops import ends_driven, last_row_before_stop

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_BEFORE_S: Final = 0.02  # before the instant of breakaway as it was seen
_ALONE_S: Final = 0.015  # after an event, whose instant is not known better
# Of the age of a motion: blocks that long falsify an exponential by 0.54 * 0.06 ** 2 / 24 of it, 8e-5.
_GROWTH: Final = 0.06
_LONGEST_BLOCK_S: Final = 0.03
_NODE_S: Final = 0.004  # between two nodes at most, where the stem may accelerate
_QUICK_SLIP_S: Final = 0.03  # shorter slips have steps of their own
_NODES_A_SLIP: Final = 14.0
_NEAR_LAGS: Final = 5.0
_MOST_SECTIONS: Final = 160  # each has its own instant and level to be fitted
_IN_A_RUN: Final = 8  # neighbours: every other one may be of the other direction
_NEAR_S: Final = 0.1
_SLOW_NODE_S: Final = 0.03
_AFTER_STOP_S: Final = 0.06
_ROUNDED_S: Final = 1.0e-7
_LATTICE_S, _LATTICE_SHARE = 2.0e-4, 0.02  # of a row's period at most


def sections_of(reading: Reading, lag: Known) -> Sections:
    """Return the sections of a reading; moves that begin without a rest are left out."""
    moves = _followed([move for move in reading.segmentation.breakaways if move.last - move.first >= 3])
    near_s = _NEAR_S + _NEAR_LAGS * max(lag.value, reading.path.lag_s)
    knots = reading.path.knots(reading.time_s)
    made = []
    for move in moves:
        one = _section(reading, move, near_s, _unseen_s(reading, move, lag), knots)
        if one is not None:
            made.append(one)
    lengths = np.unique(np.concatenate([np.diff(one.time_s) for one in made])) if made else np.empty(0)
    lengths = np.unique(np.round(lengths / _ROUNDED_S).astype(np.int64))
    numbered = []
    for one in made:
        steps = np.round(np.diff(one.time_s) / _ROUNDED_S).astype(np.int64)
        step = np.concatenate([[0], np.searchsorted(lengths, steps)]).astype(np.int64)
        numbered.append(replace(one, step=step))
    return Sections(tuple(numbered), lengths * _ROUNDED_S)


def _followed(moves: list[Move]) -> list[Move]:
    """The moves that are followed: of a stem that slips hundreds of times the farthest, and runs all over the test."""
    if len(moves) <= _MOST_SECTIONS:
        return moves
    chosen = set(np.argsort([-abs(move.distance_m) for move in moves], kind="stable")[: _MOST_SECTIONS // 4].tolist())
    runs = 3 * _MOST_SECTIONS // (4 * _IN_A_RUN)
    for first in np.linspace(0, len(moves) - _IN_A_RUN, runs).astype(np.int64).tolist():
        chosen.update(range(first, first + _IN_A_RUN))
    return [moves[at] for at in sorted(chosen)]


def _unseen_s(reading: Reading, move: Move, lag: Known) -> float:
    """How long before it was seen a stem may have broken away, s: so long its lag keeps it within the noise."""
    time_s, force_n = reading.time_s, reading.path.force_n
    reach_s = max(_BEFORE_S, 2.0 * reading.samples.period_s)
    before_n, after_n = np.interp([move.began_s - reach_s, move.began_s + reach_s], time_s, force_n).tolist()
    rate = move.direction * (after_n - before_n) / (2.0 * reach_s)
    if rate <= 0.0 or reading.spring_n_per_m <= 0.0:
        return _BEFORE_S
    unseen_s = math.sqrt(2.0 * lag.value * reading.segmentation.band_m * reading.spring_n_per_m / rate)
    return max(_BEFORE_S, min(unseen_s, lag.value))


def _section(
    reading: Reading, move: Move, near_s: float, unseen_s: float, knots: tuple[FloatArray, FloatArray]
) -> Section | None:
    time_s, position_m, path = reading.time_s, reading.position_m, reading.path
    rest = reading.segmentation.rests[move.rest]
    last = move.last
    at_stop = ends_driven(reading, move)
    stops = move.next_rest >= 0 and not at_stop
    arrived_s = []
    if at_stop:
        last = last_row_before_stop(reading, move)
    if stops:
        after = reading.segmentation.rests[move.next_rest]
        last = min(after.last - 1, int(np.searchsorted(time_s, time_s[after.first] + _AFTER_STOP_S)))
        arrived_s = [float(time_s[after.first])]
    elif not at_stop:
        # it may have come to rest too shortly before it turned, or the recording ended, for that to be seen; in the
        # row of the turn it may be on its way back
        stops, last = True, last - 1 if _turns_at_once(reading, move) else last
    corners_s = path.corners_s[(path.corners_s > move.began_s) & (path.corners_s < time_s[last])]
    first = max(rest.first + 1, int(np.searchsorted(time_s, move.began_s - unseen_s)))
    if last - first < 4:
        return None
    at = np.arange(first, last + 1)
    bends_s = path.bends_s[(path.bends_s > move.began_s) & (path.bends_s < time_s[last])]
    events_s = np.array([move.began_s, *corners_s.tolist(), *bends_s.tolist(), *arrived_s])
    blocks = _blocks(time_s[at], events_s)
    sizes = np.diff(np.append(blocks, at.size))
    mean_s, measured_m = np.add.reduceat(time_s[at], blocks) / sizes, np.add.reduceat(position_m[at], blocks) / sizes
    # uneven rows are moved to a lattice, their positions with them: each length of a step costs an exponential
    lattice_s = _ROUNDED_S if reading.is_even else min(_LATTICE_S, _LATTICE_SHARE * reading.samples.period_s)
    block_s = _on_lattice(mean_s, lattice_s)
    measured_m = measured_m + np.gradient(measured_m, mean_s) * (block_s - mean_s)
    slip_s = arrived_s[0] - move.began_s if arrived_s else math.inf
    nodes_s = _nodes(block_s, events_s, near_s, lattice_s, slip_s)
    if nodes_s.size < 4 or move.began_s >= nodes_s[-3]:
        return None  # hardly anything of the motion is left
    free_s = _free_from(move, corners_s, float(time_s[move.last]), stops)
    step_s = max(2.0 * reading.samples.period_s, 0.01)
    force_n = np.interp(nodes_s, *knots)
    # not across a gap
    first_s, last_s = time_s[reading.samples.run_first[at[0]]], time_s[reading.samples.run_last[at[0]]]
    later_s, sooner_s = np.minimum(nodes_s + step_s, last_s), np.maximum(nodes_s - step_s, first_s)
    later, sooner = np.interp(later_s, *knots), np.interp(sooner_s, *knots)
    return Section(
        direction=move.direction,
        began_s=move.began_s,
        rest_m=rest.level_m,
        rest_error_m=rest.error_m,
        time_s=nodes_s,
        step=np.zeros(nodes_s.size, np.int64),
        force_n=force_n,
        rate_n_per_s=(later - sooner) / (later_s - sooner_s),
        free=int(np.searchsorted(nodes_s, free_s)) if stops else nodes_s.size,
        row=np.searchsorted(nodes_s, block_s - 0.5 * lattice_s),
        measured_m=measured_m,
        rows=sizes.astype(np.float64),
        path_m=np.interp(nodes_s, block_s, measured_m),
        rested_s=move.began_s - float(time_s[rest.first]),
        rest_ends_s=float(time_s[rest.last]),
        before=_direction_before(reading, move),
    )


def _turns_at_once(reading: Reading, move: Move) -> bool:
    """Whether the next move goes back from where this one ended."""
    following = next((one for one in reading.segmentation.moves if one.first >= move.last), None)
    return following is not None and following.direction == -move.direction and following.first - move.last <= 1


def _direction_before(reading: Reading, move: Move) -> int:
    """Direction of the move that led to the rest before this one, 0 where the recording begins with it."""
    return next((one.direction for one in reading.segmentation.moves if one.next_rest == move.rest), 0)


def _free_from(move: Move, corners_s: FloatArray, ends_s: float, stops: bool) -> float:
    """From when on the stem may come to rest, s: after its last corner, or in the last part of a jump."""
    if not stops:
        return math.inf
    before = corners_s[corners_s < ends_s]  # a slip may be over before the corner
    if before.size:
        return float(before[-1])
    return ends_s - 0.4 * (ends_s - move.began_s)


def _blocks(time_s: FloatArray, events_s: FloatArray) -> IntArray:
    """First rows of blocks that are single after each event and grow with its age."""
    period_s = float(np.median(np.diff(time_s)))
    age_s = np.full(time_s.size, math.inf)
    for event_s in events_s:
        since_s = time_s - event_s
        # a block ends before the next event
        age_s = np.minimum(age_s, np.where(since_s >= 0.0, since_s, np.maximum(-since_s - _BEFORE_S, 0.0)))
    length_s = np.clip(_GROWTH * (age_s - _ALONE_S), period_s, _LONGEST_BLOCK_S)
    firsts = []
    row = 0
    while row < time_s.size:
        firsts.append(row)
        row = max(row + 1, int(np.searchsorted(time_s, time_s[row] + length_s[row] - 0.5 * period_s)))
    return np.array(firsts, dtype=np.int64)


def _nodes(block_s: FloatArray, events_s: FloatArray, near_s: float, lattice_s: float, slip_s: float) -> FloatArray:
    """Times of the rows with others between them, so that no step is long where the stem accelerates.

    ``slip_s`` is how long the stem slips from rest to rest: a quick slip has its own, and some before and after it, as
    its instants are not known better.
    """
    # a corner of the force is a node: a step's force is straight
    parts = [block_s, events_s[1:][(events_s[1:] > block_s[0]) & (events_s[1:] < block_s[-1])]]
    for left_s, right_s in pairwise(block_s.tolist()):
        near = bool(((left_s - events_s < near_s) & (right_s - events_s > -_BEFORE_S)).any())
        quick = slip_s < _QUICK_SLIP_S and -slip_s < left_s - events_s[0] < 3.0 * slip_s
        step_s = max(slip_s / _NODES_A_SLIP, lattice_s) if quick else _NODE_S if near else _SLOW_NODE_S
        count = math.ceil((right_s - left_s) / step_s - 1.0e-9)
        if count > 1:
            parts.append(left_s + (right_s - left_s) * np.arange(1, count) / count)
    return np.unique(_on_lattice(np.concatenate(parts), lattice_s))


def _on_lattice(time_s: FloatArray, lattice_s: float) -> FloatArray:
    return np.asarray(np.round(time_s / lattice_s).astype(np.int64) * lattice_s, np.float64)
