"""What the stem did: where it was at rest, where it broke away, where it moved, and where it ran into a stop."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.motion.moving_rows import find_moving_rows
from estimators.motion.rests import Breakaway, Span, find_spans
from estimators.motion.windowed_slope import windowed_slope, windowed_slope_noise
from estimators.samples import BoolArray, FloatArray, IntArray, Samples

_CORNER_WINDOW_S: Final = 0.05  # own choice, of the force's slope: longer than a command's update


class After(StrEnum):
    """What a stretch of motion began with."""

    BREAKAWAY = "breakaway"
    CORNER = "corner"  # the force's slope changed while the stem moved
    UNKNOWN = "unknown"  # the recording, or one of its runs, begins in motion


@dataclass(frozen=True, slots=True)
class Stretch:
    """Motion in one direction (+1, -1) on one line of the force: rows ``first`` to ``last``, both in motion."""

    first: int
    last: int
    direction: int
    after: After
    driven: bool  # the force still rises in the direction of motion (or holds); False: it coasts after a reversal

    @property
    def rows(self) -> slice:
        """The rows of the stretch."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """The phases of one recording; ``velocity`` is the windowed one, shape (n,), for choosing and not for fitting."""

    velocity: FloatArray
    half_window: int
    moving_speed: float
    stretches: tuple[Stretch, ...]
    breakaways: tuple[Breakaway, ...]
    corners: IntArray
    force_rate: FloatArray

    @property
    def directions(self) -> set[int]:
        """Directions in which the stem moved."""
        return {stretch.direction for stretch in self.stretches}

    def differenced_rows(self, count: int, *, coasting: bool) -> BoolArray:
        """Rows, shape (n,), whose backward differences reach over motion alone: no rest, corner or gap in them.

        Without ``coasting`` what goes on after a reversal of the force is left out: a spring makes another bias there.
        """
        chosen = np.zeros(count, dtype=np.bool_)
        for stretch in self.stretches:
            if stretch.driven or coasting:
                chosen[self.first_differenced_row(stretch) : stretch.last + 1] = True
        return chosen

    def first_differenced_row(self, stretch: Stretch) -> int:
        """First row whose differences are of this motion: the third, one later after a breakaway.

        There the stem accelerates below DV at first, for sqrt(2 m DV / force rate): about a millisecond.
        """
        return stretch.first + (3 if stretch.after is After.BREAKAWAY else 2)


def find_phases(samples: Samples) -> Phases | Outcome:
    """Return the phases, or the outcome where the stem never moved, or only jumped."""
    moving = find_moving_rows(samples)
    if moving is None:
        return Outcome.NEVER_MOVED
    force_window = max(moving.half_window, 2, round(_CORNER_WINDOW_S / samples.period_s))
    force_rate = windowed_slope(samples, samples.force_n, force_window)
    corners = _corners(samples, force_rate, force_window)
    breakaways: list[Breakaway] = []
    stretches: list[Stretch] = []
    for span in find_spans(samples, moving):
        if span.left_rest is not None:
            breakaways.append(span.left_rest)
        stretches += _split(span, corners, force_rate)
    if not stretches:
        return Outcome.NO_UNIFORM_MOTION  # it moved, by jumps too short to follow
    return Phases(
        velocity=moving.velocity,
        half_window=moving.half_window,
        moving_speed=moving.usual_speed,
        stretches=tuple(stretches),
        breakaways=tuple(breakaways),
        corners=corners,
        force_rate=force_rate,
    )


def _corners(samples: Samples, force_rate: FloatArray, window: int) -> IntArray:
    """Rows nearest to where the force's slope changes its sign, starts or ends."""
    typical = float(np.median(np.abs(force_rate)))
    if typical == 0.0:
        typical = float(np.abs(force_rate).max())
    dead = max(0.2 * typical, 4.0 * windowed_slope_noise(samples.force_noise_n, window, samples.period_s))
    sense = np.where(np.abs(force_rate) > dead, np.sign(force_rate), 0.0)
    flips = np.flatnonzero((sense[1:] != sense[:-1]) & (samples.run_first[1:] == samples.run_first[:-1]))
    # two flips within a window (+, 0, -) are one corner
    groups = np.split(flips, np.flatnonzero(np.diff(flips) > 2 * window) + 1) if flips.size else []
    found = []
    for group in groups:
        low = max(int(group[0]) - window, int(samples.run_first[group[0]]) + 1)
        high = min(int(group[-1]) + window + 1, int(samples.run_last[group[0]]) - 1)
        if high <= low:
            continue
        force_n = samples.force_n
        rows = np.arange(low, high + 1)
        if sense[group[0]] * sense[group[-1] + 1] < 0:
            found.append(int(rows[np.argmax(sense[group[0]] * force_n[rows])]))
        else:
            bend = np.abs(force_n[rows + 1] - 2.0 * force_n[rows] + force_n[rows - 1])
            found.append(int(rows[np.argmax(bend)]))
    return np.array(found, dtype=np.int64)


def _split(span: Span, corners: IntArray, force_rate: FloatArray) -> list[Stretch]:
    """Cut a span at the corners of the force."""
    inside = corners[(corners > span.first) & (corners < span.last)]
    begin = After.UNKNOWN if span.left_rest is None else After.BREAKAWAY
    # the corner lies within one row of its row
    firsts = [span.first, *(int(corner) + 1 for corner in inside)]
    lasts = [*(int(corner) - 1 for corner in inside), span.last]
    stretches = []
    opposing = 0.05 * float(np.abs(force_rate).max())  # a force that holds does not oppose
    for number, (first, last) in enumerate(zip(firsts, lasts, strict=True)):
        if last - first < 2:
            continue
        middle = (first + last) // 2
        driven = bool(force_rate[middle] * span.direction > -opposing)
        stretches.append(Stretch(first, last, span.direction, begin if number == 0 else After.CORNER, driven))
    return stretches
