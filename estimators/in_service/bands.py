"""Dead band, stick band and slip jump of a valve in service, from each rest by itself: no spring is needed for these.

A stem that came to rest going one way stands at signal = k x + F_0 + s F, and leaves that place at k x + F_0 + s' F_s:
the difference is F_s + F where it turned (stick band), and F_s - F where it went on (slip jump).
Choudhury, Thornhill & Shah (2005).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.in_service.events import Kind, Observations
from estimators.in_service.figure import HIDDEN, LEAST_REPEATS, Figure, mean_of_repeats, not_known
from estimators.in_service.moves import DRIVEN_BANDS, Moves
from estimators.in_service.rows import Rows
from valve.messages import Message, say
from valve.recording import FloatArray

_DIFFER: Final = say("moves_differ", "the moves differ too much among each other: a longer record, or faster rows")
SLIPS_HIDDEN: Final = say(
    "slips_hidden",
    "the position moves by little more than the least change that is reported: slips and slides look alike; export "
    "with a smaller exception limit",
)
_SEEN_BANDS: Final = 4.0  # times the band, 3 reports: of smaller slips the larger ones alone are seen, and slides step
_CREPT: Final = 0.29  # of the band: the standard error of what is anywhere within it
_ABOVE_NOISE: Final = 12.0  # times the noise: a move is seen from 5 on, and of smaller slips only the larger ones


@dataclass(frozen=True, slots=True)
class Bands:
    """Figures in the signal's unit; ``slip`` in the position's."""

    dead_band: Figure
    stick_band: Figure
    slip_jump: Figure
    slip: Figure


def bands_of(
    rows: Rows, moves: Moves, seen: Observations, *, spring: float | None, signal_unit: str, position_unit: str
) -> Bands:
    """Return the bands; ``spring`` (signal by position) leaves out rests in which the stem may have crept."""
    left, stopped = _by_move(seen, moves.count, Kind.BREAKAWAY), _by_move(seen, moves.count, Kind.MOTION)
    driven = np.full(moves.count, np.nan)
    driven[seen.move[seen.kind == Kind.BREAKAWAY]] = seen.driven[seen.kind == Kind.BREAKAWAY]
    real = driven[1:] >= (0.0 if spring is None else DRIVEN_BANDS * spring * moves.band)
    same_rest = (moves.rest_first[1:] <= moves.reached[:-1] + 1) & (
        rows.run[moves.reached[:-1]] == rows.run[moves.left[1:]]
    )
    both = real & same_rest & np.isfinite(left[0][1:]) & np.isfinite(stopped[0][:-1])
    change = moves.began[1:] * (left[0][1:] - stopped[0][:-1])
    half = left[1][1:] + stopped[1][:-1]
    turned = both & (moves.began[1:] != moves.ended[:-1])
    went_on = both & (moves.began[1:] == moves.ended[:-1])
    turn = [_turn(rows, moves, number) for number in np.flatnonzero(turned).tolist()]
    # the farthest of many noisy rows lies beyond where the signal turned, by so much if it stayed there: half of it is
    # taken off, and all of it may be
    beyond = np.array([beyond for _, beyond in turn])
    dead = np.abs(left[0][1:][turned] - np.array([at for at, _ in turn])) - 0.5 * beyond
    # the stem is seen to leave when it has gone by the band: a slide is seen late, a slip is not
    crept = (spring or 0.0) * moves.band
    dead, crept = dead - 0.5 * crept, _CREPT * crept
    unsure = math.hypot(crept, float(np.mean(beyond)) / math.sqrt(12.0) if turn else 0.0)
    turns, ons = int(turned.sum()), int(went_on.sum())
    jumps = np.abs(moves.to_level - moves.from_level)
    slipped = np.isfinite(stopped[0]) & (moves.began == moves.ended) & (moves.reached - moves.left <= _slip_rows(rows))
    # a held position shows a breakaway when the stem has gone by the band
    late = float(np.hypot(rows.signal_noise, 0.5 * (spring or 0.0) * moves.band)) if rows.is_held else None
    few_turns = _few(say("reversals", "reversals"), turns)
    few_ons = _few(say("breakaways_onward", "breakaways in the direction of the last motion"), ons)
    few_slips = _few(say("slips_within_row", "slips within one row"), int(slipped.sum()))
    apart = np.full(int(slipped.sum()), rows.noise)
    slip = mean_of_repeats(jumps[slipped], apart, position_unit, few_slips, _DIFFER)
    if rows.is_held and slip.value is not None and slip.value < _SEEN_BANDS * moves.band:
        slip = not_known(position_unit, SLIPS_HIDDEN, slip.count)
    stick = mean_of_repeats(change[turned], half[turned], signal_unit, few_turns, _DIFFER, common=late, unsure=crept)
    jump = mean_of_repeats(change[went_on], half[went_on], signal_unit, few_ons, _DIFFER, common=late)
    if slip.value is not None and slip.value < _ABOVE_NOISE * rows.noise:
        slip = not_known(position_unit, HIDDEN, slip.count)
        stick, jump = (not_known(signal_unit, HIDDEN, one.count) for one in (stick, jump))
    return Bands(
        mean_of_repeats(dead, half[turned], signal_unit, few_turns, _DIFFER, common=late, unsure=unsure),
        stick,
        jump,
        slip,
    )


def _few(what: Message, count: int) -> Message:
    return say(
        "few_seen",
        "{what}: {count} of these were seen, {needed} are needed: a longer record",
        what=what,
        count=count,
        needed=LEAST_REPEATS,
    )


def _slip_rows(rows: Rows) -> int:
    return max(2, round(0.3 / rows.period_s))


def _by_move(seen: Observations, count: int, kind: Kind) -> tuple[FloatArray, FloatArray]:
    """Signal and half width of each move's last observation of this kind, NaN without one, each of shape (count,)."""
    own = seen.kind == kind
    signal, half = np.full(count, np.nan), np.full(count, np.nan)
    signal[seen.move[own]], half[seen.move[own]] = seen.signal[own], seen.half_width[own]
    return signal, half


def _turn(rows: Rows, moves: Moves, number: int) -> tuple[float, float]:
    """Where the signal turned in the rest after a move, and by how much its noise alone would seem to go beyond.

    Rows of fast records are averaged over a fifth of a second.
    """
    part = rows.signal[moves.reached[number] : moves.left[number + 1] + 1]
    width = max(1, min(part.size, round(0.2 / rows.period_s)))
    smooth = np.convolve(part, np.full(width, 1.0 / width), mode="valid")
    beyond = rows.signal_noise * float(np.sqrt(2.0 * np.log(max(part.size / width, 1.0)) / width))
    return float(smooth.max() if moves.ended[number] > 0 else smooth.min()), beyond
