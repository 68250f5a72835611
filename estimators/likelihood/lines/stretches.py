"""The unbroken stretches of a measured or commanded channel as straight lines: known to rounding, or fitted pieces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Protocol

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.lines.exact_lines import exact_corners
from estimators.likelihood.lines.joined_pieces import Joint, Pieces
from estimators.likelihood.lines.lagged_lines import lagged_lines, lines_behind_some_lag
from estimators.likelihood.lines.pieces import fit_pieces
from estimators.samples import FloatArray, IntArray, position_noise, resolution
from valve.recording import Recording

Corners = tuple[FloatArray, FloatArray]

_FEWEST_ROWS: Final = 12
_FEWEST_FITTED: Final = 3  # two noisy rows are their line
_LONGEST_JUMP_PERIODS: Final = 5.0  # without a row: another recording, or as good as one
_LONGEST_GAP_S: Final = 0.5
_LONGEST_GAP_PERIODS: Final = 25.0  # of rows without a value, across which two lines may still be drawn to a corner
_OF_A_LINE: Final = 0.1  # of its neighbours: a shorter one is a corner that is rounded
_SMOOTH_NOISE: Final = 1.0e-9  # of the span: what a computed curve is fitted to
_CHORD_ERROR: Final = 2.0e-7  # of the span, or a tenth of a curve's own error
_MOST_CHORDS: Final = 2000
_ROUNDING: Final = float(np.finfo(np.float64).eps)
ROWS_A_STEP: Final = 40  # more steps than one in as many rows are a converter's and not the test's
_FEWEST_GRID_CORNERS: Final = 100
_NO_CHANGE: Final = 1.2  # times the noise: a channel that scatters so little about its mean stands still


class Stretch(Protocol):
    """A part of the channel without a break."""

    @property
    def first_s(self) -> float:
        """Time of its first row."""
        ...

    @property
    def last_s(self) -> float:
        """Time of its last row."""
        ...

    def sizes(self) -> FloatArray:
        """Largest change of the value along each independent direction in which it is uncertain, shape (d,)."""
        ...

    def corners(self, direction: int | None = None) -> Corners:
        """Corner times and values; changed by one sigma along a direction if it is given."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class KnownCorners:
    """A stretch that is known to rounding."""

    time_s: FloatArray
    value: FloatArray

    @property
    def first_s(self) -> float:
        """Time of its first row."""
        return float(self.time_s[0])

    @property
    def last_s(self) -> float:
        """Time of its last row."""
        return float(self.time_s[-1])

    def sizes(self) -> FloatArray:
        """None."""
        return np.empty(0)

    def corners(self, direction: int | None = None) -> Corners:  # noqa: ARG002 - as all stretches
        """Corner times and values."""
        return self.time_s, self.value


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPieces:
    """Pieces and the places of the corners that they are drawn with: which piece, and 0 to 1 on it, shape (n,)."""

    pieces: Pieces
    piece_of: IntArray
    share_of: FloatArray

    @property
    def first_s(self) -> float:
        """Time of its first row."""
        return self.pieces.first_s

    @property
    def last_s(self) -> float:
        """Time of its last row."""
        return self.pieces.last_s

    def sizes(self) -> FloatArray:
        """Largest change of the value along each direction, shape (d,)."""
        return np.asarray(np.abs(self.pieces.root).sum(axis=2).max(axis=1))

    def corners(self, direction: int | None = None) -> Corners:
        """Corner times and values; changed by one sigma along a direction if it is given."""
        chosen = self.pieces.coefficient
        if direction is not None:
            chosen = chosen + self.pieces.root[direction]
        at_s = np.concatenate([[self.pieces.first_s], self.pieces.crossings(chosen), [self.pieces.last_s]])
        start_s, end_s = at_s[self.piece_of], at_s[self.piece_of + 1]
        time_s = np.where(self.share_of < 1.0, start_s + self.share_of * (end_s - start_s), end_s)
        return time_s, self.pieces.values(chosen, self.piece_of, time_s)


def find_stretches(
    recording: Recording, force_n: FloatArray, rows_a_step: int
) -> tuple[tuple[Stretch, ...], FloatArray, float] | Outcome:
    """Stretches of this channel, shape (n,), NaN where it is missing; the breaks between; and its noise.

    ``rows_a_step``: more steps than one in as many rows are taken for a converter's.
    """
    rows = np.flatnonzero(np.isfinite(force_n))
    if rows.size < _FEWEST_ROWS:
        return Outcome.TOO_FEW_SAMPLES
    time_s, value = recording.time_s[rows], force_n[rows]
    period_s = recording.sample_period_s
    jumps = np.flatnonzero(np.diff(recording.time_s) > _LONGEST_JUMP_PERIODS * period_s)
    gap = np.diff(rows) > 1
    run_first = np.maximum.accumulate(np.where(np.concatenate([[True], gap]), np.arange(rows.size), 0))
    cuts = np.unique(np.searchsorted(rows, jumps, side="right"))
    edges = [0, *(int(cut) for cut in cuts if 0 < cut < rows.size), int(rows.size)]
    known = [_exact(time_s[i:j], value[i:j], float(np.ptp(value)), rows_a_step) for i, j in pairwise(edges)]
    # a command is what was asked for: its equal steps are real; a few lines are no grid's, whatever its step
    is_asked = rows_a_step >= ROWS_A_STEP and any(part is None or part[0].size > _FEWEST_GRID_CORNERS for part in known)
    step_n = resolution(np.sort(value)) if is_asked else 0.0
    known = [None if part is not None and _follows_grid(part, value.size, step_n) else part for part in known]
    noise_n = 0.0 if all(part is not None for part in known) else position_noise(time_s, value, run_first)
    if noise_n > 0.0:
        noise_n = max(noise_n, step_n / math.sqrt(12.0))
        # of a few rows between two breaks it cannot be told whether they are noisy: as the others are
        known = [None if j - i < _FEWEST_ROWS else part for (i, j), part in zip(pairwise(edges), known, strict=True)]
    if float(np.std(value)) <= _NO_CHANGE * noise_n or np.ptp(value) == 0.0:
        return Outcome.NO_FORCE_CHANGE
    span_n = float(np.ptp(value))
    stretches = [
        stretch
        for (i, j), part in zip(pairwise(edges), known, strict=True)
        for stretch in (
            _fitted_stretches(time_s[i:j], value[i:j], noise_n, span_n, period_s)
            if part is None
            else [KnownCorners(*part)]
        )
    ]
    breaks_s = np.array([(one.last_s, two.first_s) for one, two in pairwise(stretches)]).reshape(-1, 2)
    return tuple(stretches), breaks_s, noise_n


def _follows_grid(corners: Corners, rows: int, step_n: float) -> bool:
    """Whether these lines are those of a converter's rounding: many short ones, which meet within about a step.

    Over the rows of a ramp the rounding averages out.
    """
    time_s, value = corners
    if step_n == 0.0 or not _FEWEST_GRID_CORNERS < time_s.size < rows:
        return False
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    bend_n = np.abs(value[1:-1] - value[:-2] - share * (value[2:] - value[:-2]))
    return float(np.median(bend_n)) < 1.01 * step_n


def _fitted_stretches(
    time_s: FloatArray, value: FloatArray, noise_n: float, span_n: float, period_s: float
) -> list[Stretch]:
    """Stretches of noisy rows, cut where a gap hides how two pieces meet."""
    if time_s.size < _FEWEST_FITTED:
        return [KnownCorners(time_s, value)]
    noise_n = max(noise_n, _SMOOTH_NOISE * span_n)
    pieces = fit_pieces(time_s, value, noise_n)
    cut = _longest_gap(time_s, pieces, period_s)
    if cut is None:
        curved = bool((pieces.degree > 1).any()) or bool((pieces.joint == Joint.SMOOTH).any())
        # a corner that a short lag rounds is drawn as two
        apart_s = np.diff(pieces.joint_s)
        twice = apart_s.size > 1 and bool((apart_s[1:-1] < _OF_A_LINE * np.minimum(apart_s[:-2], apart_s[2:])).any())
        behind_lag = lagged_lines(time_s, value, noise_n) if curved or twice else None
        if behind_lag is None and (curved or twice):
            behind_lag = lines_behind_some_lag(time_s, value, noise_n)
        return [DrawnPieces(pieces, *_drawn(pieces, noise_n, span_n)) if behind_lag is None else behind_lag]
    return [
        *_fitted_stretches(time_s[:cut], value[:cut], noise_n, span_n, period_s),
        *_fitted_stretches(time_s[cut:], value[cut:], noise_n, span_n, period_s),
    ]


def _exact(time_s: FloatArray, value: FloatArray, span_n: float, rows_a_step: int) -> Corners | None:
    """Return the corners of a channel that is straight between them to rounding, or None.

    Many steps, and rows that lie on no line, are the converter's or noise.
    """
    if time_s.size < _FEWEST_ROWS:
        return time_s, value
    off = _rounding_noise(time_s, value)
    if off > _SMOOTH_NOISE * span_n:
        return None
    tolerance = 4.0 * _ROUNDING * float(np.abs(value).max()) + 6.0 * off
    corner_s, corner_n, others = exact_corners(time_s, value, tolerance)
    if others <= max(_FEWEST_ROWS, time_s.size // rows_a_step):
        return corner_s, corner_n
    # lines and a few computed curves between them: as chords, where these are some rows long
    corner_s, corner_n, _ = exact_corners(time_s, value, _CHORD_ERROR * span_n)
    off_n = float(np.abs(np.interp(time_s, corner_s, corner_n) - value).max())
    fits = corner_s.size < time_s.size // 2 and off_n < 5.0 * _CHORD_ERROR * span_n
    return (corner_s, corner_n) if fits else None


def _rounding_noise(time_s: FloatArray, value: FloatArray) -> float:
    """Median of what the middle one of three rows is off the line through the others; a digit lost, or nothing."""
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    off = value[1:-1] - value[:-2] - share * (value[2:] - value[:-2])
    return float(np.median(np.abs(off)))


def is_long_gap(missing_s: float, period_s: float) -> bool:
    """Whether a gap of so many seconds may hide more than one corner between two lines."""
    return missing_s > max(_LONGEST_GAP_S, _LONGEST_GAP_PERIODS * period_s)


def _longest_gap(time_s: FloatArray, pieces: Pieces, period_s: float) -> int | None:
    """First row after a gap in which two pieces meet and that hides how; None where there is none."""
    for joint, at_s in zip(pieces.joint, pieces.joint_s, strict=True):
        after = int(np.searchsorted(time_s, at_s, side="right"))
        if not 0 < after < time_s.size:
            continue
        missing_s = float(time_s[after] - time_s[after - 1])
        if is_long_gap(missing_s, period_s) or (joint == Joint.STEP and missing_s > _LONGEST_JUMP_PERIODS * period_s):
            return after
    return None


def _drawn(pieces: Pieces, noise_n: float, span_n: float) -> tuple[IntArray, FloatArray]:
    """Piece of each corner to be drawn and its place on it, 0 to 1; chords leave a curve by a tenth of its error."""
    at_s = np.concatenate([[pieces.first_s], pieces.joint_s, [pieces.last_s]])
    piece_of, share_of = [], []
    count = pieces.degree.size
    for i in range(count):
        c, half_s = pieces.coefficient[i], float(pieces.half_s[i])
        bend = max(abs(2.0 * c[2] + 6.0 * c[3]), abs(2.0 * c[2] - 6.0 * c[3])) / half_s**2
        error = max(
            _CHORD_ERROR * span_n, 0.1 * noise_n * math.sqrt((pieces.degree[i] + 1.0) / max(1.0, float(pieces.rows[i])))
        )
        wanted = (at_s[i + 1] - at_s[i]) * math.sqrt(bend / (8.0 * error)) if pieces.degree[i] > 1 else 1.0
        chords = int(np.clip(math.ceil(wanted), 1, _MOST_CHORDS))
        drops_start = i > 0 and pieces.joint[i - 1] != Joint.STEP
        share = np.linspace(0.0, 1.0, chords + 1)[1 if drops_start else 0 :]
        piece_of.append(np.full(share.size, i))
        share_of.append(share)
    return np.concatenate(piece_of), np.concatenate(share_of)
