"""Whether something changed once, or wandered, while the valve was recorded: a load, a sensor's zero, the friction.

Moving one way through one place, a spring-opposed stem needs the same input on every stroke: P = kappa x + P_0 + s P_f
with s the way. The highest s (P - kappa x) in a window of travel is where the stem breaks away or slides. What strokes
of one rate differ in there is a change of P_0 (a force, or a zero) where it has one sign both ways, and of friction
P_f where it turns with s. Neither is in the catalogue, so that a recording with one ends as unexplained.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.data_faults.fault import place_of
from estimators.data_faults.found import recording_number
from estimators.samples import FloatArray
from valve.messages import Message, say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

# Own choices; tests/discrepancy/notes/test_change_note.py has what must not be taken for a change.
_WINDOWS: Final = (8, 4, 2)  # a slip may be longer than a window: then fewer are tried
_EDGE: Final = 0.1  # of the stroke: at its ends stand stops and turning places
_TURNED: Final = 0.05  # of the stroke: within it a stem that has just turned is not looked at
_TURNS: Final = 0.15  # of the stroke: a stem that comes back by less has not turned
_HIGH: Final = 98.0  # percentile: below the noise's own highest value
_ONE_RATE: Final = 1.05  # times: friction goes with speed
_LEAST_ROWS: Final = 200
_LEAST_INSIDE: Final = 3
_LEAST_OBSERVED: Final = 12
_LEAST_SIDES: Final = 2  # windows each way that were passed before as well as after
_LEFT: Final = 0.05  # of the sum of squares: what one change may leave
_BETTER: Final = 5.0  # times less than what any other kind of change leaves
_AS_GOOD: Final = 2.0  # times the least: as good a moment
_ALIKE: Final = 0.25  # of the change: how far it may differ between the two ways
_LEAST_OF_SPAN: Final = 1.0e-3  # of the input's span: below it nobody looks for a cause


_IndexArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class _Passages:
    """Passages of windows of travel: when, s; window and way as one number; way, +1 or -1; input there, and its rate.

    Each of shape (passages,).
    """

    time_s: FloatArray
    group: _IndexArray
    way: FloatArray
    level: FloatArray
    rate: FloatArray

    def rows(self, keep: npt.NDArray[np.bool_]) -> _Passages:
        """Return these passages only."""
        return _Passages(self.time_s[keep], self.group[keep], self.way[keep], self.level[keep], self.rate[keep])


@dataclass(frozen=True, slots=True)
class _Change:
    """A change of the input that a place needs, in the input's unit: of its zero, or of friction, which turns with way.

    ``left`` is the sum of squares that it leaves; ``between_s`` the moments at which it may have come, the record's
    first and last one for a steady change.
    """

    friction: bool
    steady: bool
    size: float
    left: float
    between_s: tuple[float, float]


def change_note(recordings: Sequence[Recording], nameplate: Nameplate) -> str:
    """Return what changed in the course of a recording, and where to look; "" where nothing stands out."""
    if nameplate.actuator.action is not Action.SPRING:
        return ""
    for number, recording in enumerate(recordings, 1):
        found = _found(recording)
        if found is not None:
            change, slope = found
            place = place_of(recording_number(number) if len(recordings) > 1 else "")
            return _told(change, slope, recording, nameplate, place)
    return ""


def _found(recording: Recording) -> tuple[_Change, float] | None:
    """Return the change, and the input per metre of the spring; None where no change alone explains the strokes."""
    input_ = _input(recording)
    rows = np.flatnonzero(np.isfinite(recording.position_m) & np.isfinite(input_))
    if rows.size < _LEAST_ROWS:
        return None
    time_s, position_m, own = recording.time_s[rows], recording.position_m[rows], input_[rows]
    low_m, high_m = np.percentile(position_m, (1.0, 99.0))
    if not high_m > low_m:
        return None
    slope = float(np.polyfit(position_m, own, 1)[0])
    for windows in _WINDOWS:
        edges_m = float(low_m) + float(high_m - low_m) * np.linspace(_EDGE, 1.0 - _EDGE, windows + 1)
        passages = _passages(time_s, position_m, own, slope, edges_m)
        tilt = _tilt(passages, edges_m)
        if tilt is None or slope + tilt <= 0.0:
            continue
        # The loop's width tilts the straight line through it; the middle between both ways is not tilted.
        spring = slope + tilt
        taken = _of_one_rate(_passages(time_s, position_m, own, spring, edges_m))
        change = None if taken is None else _standing_out(taken, _LEAST_OF_SPAN * spring * float(high_m - low_m))
        if change is not None:
            return change, spring
    return None


def _standing_out(passages: _Passages, least: float) -> _Change | None:
    """Return the one change that explains what strokes differ in, and is larger than ``least``; None without one."""
    changes = sorted(_changes(passages), key=lambda one: one.left)
    best = changes[0]
    plain = _left(passages, np.zeros(passages.time_s.size))[1]
    if all(one.steady for one in changes):  # too few strokes to tell how it came
        return None
    if best.left > _LEFT * plain or abs(best.size) < least or changes[1].left < _BETTER * best.left:
        return None
    return best if _is_alike(passages, best) else None


def _tilt(passages: _Passages, edges_m: FloatArray) -> float | None:
    """Return by how much the input rises with travel beyond what was taken off, per metre; None where it is unseen."""
    if passages.time_s.size < _LEAST_OBSERVED:
        return None
    middles_m = (0.5 * (edges_m[1:] + edges_m[:-1]))[passages.group // 2]
    columns = np.column_stack([passages.way, np.ones_like(middles_m), middles_m])
    return float(np.linalg.lstsq(columns, passages.level)[0][2])


def _input(recording: Recording) -> FloatArray:
    """Force, pressure or command, what acts on the stem most directly."""
    channels = (recording.force_n, recording.pressure_pa, recording.command_pa)
    return next(channel for channel in channels if channel is not None)


def _passages(
    time_s: FloatArray, position_m: FloatArray, own: FloatArray, slope: float, edges_m: FloatArray
) -> _Passages:
    """Return each window that the stem passed from edge to edge on one stroke, with the highest input against it."""
    stroke_m = float(edges_m[-1] - edges_m[0]) / (1.0 - 2.0 * _EDGE)
    found = []
    for first, last, way in _strokes(position_m, _TURNS * stroke_m):
        place_m = way * position_m[first:last]
        start_m, end_m = float(place_m[0]) + _TURNED * stroke_m, float(place_m[-1])
        for window, pair_m in enumerate(itertools.pairwise(edges_m)):
            entry_m, leaving_m = sorted(way * edge_m for edge_m in pair_m)
            inside = first + np.flatnonzero((place_m > entry_m) & (place_m < leaving_m))
            if inside.size < _LEAST_INSIDE or entry_m < start_m or end_m < leaving_m:
                continue
            against = way * (own[inside] - slope * position_m[inside])
            height = float(np.percentile(against, _HIGH))
            at = int(inside[np.argmin(np.abs(against - height))])
            rate = abs(float(own[inside[-1]] - own[inside[0]])) / float(time_s[inside[-1]] - time_s[inside[0]])
            found.append((float(time_s[at]), 2 * window + (way > 0), way, way * height, rate))
    columns = np.array(found).reshape(-1, 5).T
    return _Passages(columns[0], columns[1].astype(np.intp), columns[2], columns[3], columns[4])


def _strokes(position_m: FloatArray, turn_m: float) -> list[tuple[int, int, int]]:
    """Return first row, one past the last row and way of each stroke between two turns."""
    # Turning places are far apart: every 4000th part of the record finds them.
    step = max(position_m.size // 4000, 1)
    places = position_m[::step]
    strokes, begun, extreme, way = [], 0, 0, 0
    for row, place_m in enumerate(places):
        if way == 0:
            if abs(place_m - places[begun]) > turn_m:
                way, extreme = (1 if place_m > places[begun] else -1), row
        elif way * (place_m - places[extreme]) > 0.0:
            extreme = row
        elif way * (places[extreme] - place_m) > turn_m:
            strokes.append((begun * step, extreme * step + 1, way))
            begun, extreme, way = extreme, row, -way
    if way != 0:
        strokes.append((begun * step, extreme * step + 1, way))
    return strokes


def _of_one_rate(passages: _Passages) -> _Passages | None:
    """Return the passages of each group's commonest rate, where two and more have it; None where they are too few."""
    if passages.time_s.size < _LEAST_OBSERVED:
        return None
    ratios = passages.rate[:, None] / np.maximum(passages.rate[None, :], 1.0e-12)
    near = (np.maximum(ratios, 1.0 / np.maximum(ratios, 1.0e-12)) < _ONE_RATE) & (
        passages.group[:, None] == passages.group[None, :]
    )
    counts = near.sum(axis=0)
    keep = np.zeros(passages.time_s.size, dtype=np.bool_)
    for group in np.unique(passages.group):
        commonest = int(np.argmax(np.where(passages.group == group, counts, 0)))
        if counts[commonest] > 1:
            keep |= near[:, commonest]
    return passages.rows(keep) if np.count_nonzero(keep) >= _LEAST_OBSERVED else None


def _changes(passages: _Passages) -> list[_Change]:
    """Return the best change of each kind: of zero and of friction, at once and steadily."""
    time_s = passages.time_s
    ordered_s = np.unique(time_s)
    duration_s = float(ordered_s[-1] - ordered_s[0])
    found = []
    for friction in (False, True):
        sign = passages.way if friction else np.ones_like(time_s)
        size, left = _left(passages, sign * (time_s - ordered_s[0]) / duration_s)
        found.append(_Change(friction, True, size, left, (float(ordered_s[0]), float(ordered_s[-1]))))
        tried = [
            (*_left(passages, sign * (time_s > moment_s)), number)
            for number, moment_s in enumerate(ordered_s[:-1])
            if _has_both_sides(passages, time_s > moment_s)
        ]
        if tried:
            size, left, _ = min(tried, key=lambda one: one[1])
            good = [number for _, other, number in tried if other <= _AS_GOOD * left]
            between_s = (float(ordered_s[good[0]]), float(ordered_s[good[-1] + 1]))
            found.append(_Change(friction, False, size, left, between_s))
    return found


def _left(passages: _Passages, column: FloatArray) -> tuple[float, float]:
    """Return the size of what goes with the column in all windows, and the sum of squares that is left."""
    counts = np.maximum(np.bincount(passages.group), 1)
    level, own = (
        values - (np.bincount(passages.group, values) / counts)[passages.group] for values in (passages.level, column)
    )
    power = float(own @ own)
    size = float(own @ level) / power if power > 0.0 else 0.0
    return size, float(np.sum((level - size * own) ** 2))


def _has_both_sides(passages: _Passages, after: npt.NDArray[np.bool_]) -> bool:
    """Whether enough windows were passed before and after, either way, and some twice before and some twice after."""
    count = int(passages.group.max()) + 1
    late, early = (np.bincount(passages.group[rows], minlength=count) for rows in (after, ~after))
    both = np.flatnonzero((late > 0) & (early > 0))
    up = int(np.count_nonzero(both % 2))
    return min(up, both.size - up) >= _LEAST_SIDES and late.max() > 1 and early.max() > 1


def _is_alike(passages: _Passages, change: _Change) -> bool:
    """Whether the change is as large one way as the other, each by itself."""
    sizes = []
    for way in (1.0, -1.0):
        own = passages.rows(passages.way == way)
        sign = own.way if change.friction else np.ones_like(own.way)
        first_s, last_s = change.between_s
        shape = (own.time_s - first_s) / (last_s - first_s) if change.steady else own.time_s > 0.5 * (first_s + last_s)
        sizes.append(_left(own, sign * shape)[0])
    return max(abs(size - change.size) for size in sizes) < _ALIKE * abs(change.size)


def _told(change: _Change, slope: float, recording: Recording, nameplate: Nameplate, place: Message) -> Message:
    first_s, last_s = change.between_s
    area_m2 = 1.0 if recording.force_n is not None else nameplate.actuator.diaphragm_area_m2
    size, unit = (abs(change.size), "kPa") if area_m2 is None else (abs(change.size) * area_m2, "N")
    amount = say("about", "{amount:g {unit}}", amount=float(f"{size:.2g}"), unit=unit)
    begun = (
        say("recording_drifts", "The recording{place} drifts: from its beginning to its end", place=place)
        if change.steady
        else say(
            "recording_changes",
            "The recording{place} changes between {first:.3g} and {last:.3g} s: from then on",
            place=place,
            first=first_s,
            last=last_s,
        )
    )
    if change.friction:
        return say(
            "friction_changed",
            "{begun} {change}, opening and closing alike. It is part of what the simulation misses: look at the "
            "packing and at what touches the stem, and repeat the test.",
            begun=begun,
            change=_friction_words(change, amount),
        )
    by_command = recording.force_n is None and recording.pressure_pa is None
    return say(
        "position_changed",
        "{begun} {change} at the same input, opening and closing alike. A load of the process that changes by {amount} "
        "does that, and so does a zero that moves, of the position sensor or of {zero}. It is part of what the "
        "simulation misses: ask what the process did meanwhile, look at the sensor's bracket and at {zero}, and repeat "
        "the test under a steady load.",
        begun=begun,
        change=_position_words(change, abs(change.size) / slope),
        amount=amount,
        zero=say("the_signal", "the signal") if by_command else say("the_gauge", "the gauge"),
    )


def _friction_words(change: _Change, amount: Message) -> Message:
    if change.steady:
        if change.size > 0.0:
            return say("friction_becomes_larger", "friction becomes about {amount} larger", amount=amount)
        return say("friction_becomes_smaller", "friction becomes about {amount} smaller", amount=amount)
    if change.size > 0.0:
        return say("friction_is_larger", "friction is about {amount} larger", amount=amount)
    return say("friction_is_smaller", "friction is about {amount} smaller", amount=amount)


def _position_words(change: _Change, moved_m: float) -> Message:
    if change.steady:
        if change.size > 0.0:
            return say("position_becomes_smaller", "the position becomes {moved:.2g mm} smaller", moved=moved_m)
        return say("position_becomes_larger", "the position becomes {moved:.2g mm} larger", moved=moved_m)
    if change.size > 0.0:
        return say("position_is_smaller", "the position is {moved:.2g mm} smaller", moved=moved_m)
    return say("position_is_larger", "the position is {moved:.2g mm} larger", moved=moved_m)
