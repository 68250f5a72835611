"""A noisy channel as pieces, lines up to cubics, and what joins them: a corner, a step or a smooth passage."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.lines.joined_pieces import Joint, Pieces
from estimators.likelihood.lines.piece_kernel import fitted, merged, refined
from estimators.likelihood.lines.smooth_spans import SHAPE_ERROR, smooth_span
from estimators.samples import FloatArray, IntArray

# Own choices, tried on triangles, multi-rate triangles, sines, steps and lagged triangles at 1-50 ms, 0.01-0.5 % noise.
_PRICE: Final = 1.3
_BLOCKS: Final = 8000
_LARGEST_BLOCK: Final = 8
_FEWEST_ROWS: Final = 3
_LINE: Final = 2  # coefficients
_SIGMAS: Final = 6.0  # a difference of slopes or of values beyond it is one
_SIGMAS_OF_LINES: Final = 3.0  # of slopes: two lines do not pass smoothly into each other, they would be one
_EDGE_ROUNDS: Final = 4
_EDGE_SQUARES: Final = 40.0
_MOST_PIECES_SHARE: Final = 0.02  # of the rows, and at least ...
_MANY_PIECES: Final = 300


def fit_pieces(time_s: FloatArray, value: FloatArray, noise: float) -> Pieces:
    """Return the fewest pieces that leave white noise of this standard deviation; times rise, shape (n,).

    Each coefficient and each edge costs 1.3 ln(n), times the noise's variance, of the squares left (Schwarz 1978,
    made a little dearer). Noise that is not white would be taken for shape: where there are more pieces than any
    test has, the noise is raised until there are not.
    """
    price = _PRICE * float(np.log(max(time_s.size, 8)))
    most = max(_MANY_PIECES, int(_MOST_PIECES_SHARE * time_s.size))
    noise, edges = _few_enough(time_s, value, noise, price, most)
    apart = _fitted_apart(time_s, value, noise, edges, price)
    for _ in range(_EDGE_ROUNDS):
        moved = _moved(time_s, edges, apart)
        if (moved == edges).all():
            break
        edges = moved
        apart = _fitted_apart(time_s, value, noise, edges, price)
    return _smoothed(time_s, value, noise, edges, apart)


def _few_enough(time_s: FloatArray, value: FloatArray, noise: float, price: float, most: int) -> tuple[float, IntArray]:
    """Return the noise, raised by half as often as it takes to at most so many pieces, and their edges."""
    edges = _edges(time_s, value, noise, price)
    many, few = -1, 0  # how often: too seldom, and enough
    while edges.size - 1 > most:
        many, few = few, max(1, 2 * few)
        edges = _edges(time_s, value, noise * 1.5**few, price)
    while few - many > 1:
        between = (many + few) // 2
        tried = _edges(time_s, value, noise * 1.5**between, price)
        if tried.size - 1 > most:
            many = between
        else:
            few, edges = between, tried
    return noise * 1.5**few, edges


def _edges(time_s: FloatArray, value: FloatArray, noise: float, price: float) -> IntArray:
    block = int(np.clip(time_s.size // _BLOCKS, 2, _LARGEST_BLOCK))
    longest, weight = max(64, time_s.size // 50), 1.0 / noise**2
    edges = merged(time_s, value, block, weight, price, 0.0)
    return refined(time_s, value, edges, 2 * block + 8, _FEWEST_ROWS, longest, weight, price, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Apart:
    """Pieces fitted each for itself, and how they meet; arrays as those of ``Pieces``."""

    centre_s: FloatArray
    half_s: FloatArray
    coefficient: FloatArray
    degree: IntArray
    roots: list[FloatArray]
    joint: IntArray
    joint_s: FloatArray
    reach_s: FloatArray

    def end(self, piece: int, at_s: float) -> tuple[float, float, float, float]:
        """Value, slope and their standard errors of one piece at a time."""
        half_s = float(self.half_s[piece])
        u = (at_s - float(self.centre_s[piece])) / half_s
        powers = np.array([1.0, u, u * u, u * u * u])
        rates = np.array([0.0, 1.0, 2.0 * u, 3.0 * u * u]) / half_s
        c, root = self.coefficient[piece], self.roots[piece]
        return (
            float(powers @ c),
            float(rates @ c),
            float(np.linalg.norm(root @ powers)),
            float(np.linalg.norm(root @ rates)),
        )

    def met(self, i: int, variance_s: float) -> tuple[Joint, float, float]:
        """How piece i meets the next one, when, and how far a corner may be from there.

        ``variance_s`` is the noise's variance times the period. Rows on the wrong side of a corner for a time d
        cost (bend d)^2 d / 3 / variance_s of squares: an edge is found to where that is a few dozens. A line of a few
        rows has a slope that is hardly known: that it meets another line smoothly is no finding.
        """
        at_s, apart_s = float(self.joint_s[i]), float(self.reach_s[i])
        one, two = self.end(i, at_s), self.end(i + 1, at_s)
        gap, bend = one[0] - two[0], two[1] - one[1]
        gap_error, bend_error = math.hypot(one[2], two[2]), math.hypot(one[3], two[3])
        are_lines = max(int(self.degree[i]), int(self.degree[i + 1])) <= 1
        if abs(bend) > (_SIGMAS_OF_LINES if are_lines else _SIGMAS) * bend_error:
            edge_error_s = math.cbrt(3.0 * _EDGE_SQUARES * variance_s / bend**2)
            near_s = 0.6 * apart_s + _SIGMAS * gap_error / abs(bend) + edge_error_s
            near_s = min(near_s, max(0.9 * float(min(self.half_s[i], self.half_s[i + 1])), 0.6 * apart_s))
            if abs(gap) <= near_s * abs(bend):
                return Joint.CORNER, at_s + gap / bend, near_s
        if abs(gap) > _SIGMAS * gap_error + abs(bend) * 0.6 * apart_s:
            return Joint.STEP, at_s, 0.0
        return Joint.SMOOTH, at_s, 0.0


def _fitted_apart(time_s: FloatArray, value: FloatArray, noise: float, edges: IntArray, price: float) -> _Apart:
    factors, degree = fitted(time_s, value, edges, 1.0 / noise**2, price, 0.0)
    count = degree.size
    first_s, last_s = time_s[edges[:-1]], time_s[edges[1:] - 1]
    centre_s, half_s = 0.5 * (first_s + last_s), 0.5 * (last_s - first_s)
    half_s = np.where(half_s > 0.0, half_s, 1.0)
    coefficient, roots = np.zeros((count, 4)), []
    for i in range(count):
        size = min(int(degree[i]) + 1, int(edges[i + 1] - edges[i]))
        inverse = np.linalg.pinv(factors[i, :size, :size])
        if size == _LINE and float(inverse[1] @ factors[i, :2, 4]) ** 2 < price * (noise * float(inverse[1, 1])) ** 2:
            # a slope that is not worth its price is none: that of a hold of three rows is hardly known
            size, degree[i] = 1, 0
            inverse = np.linalg.pinv(factors[i, :1, :1])
        coefficient[i, :size] = inverse @ factors[i, :size, 4]
        directions, sizes, _ = np.linalg.svd(inverse)
        root = np.zeros((size, 4))
        root[:, :size] = noise * (directions * sizes).T
        roots.append(root)
    apart = _Apart(
        centre_s,
        half_s,
        coefficient,
        degree,
        roots,
        np.zeros(count - 1, np.int64),
        0.5 * (last_s[:-1] + first_s[1:]),
        first_s[1:] - last_s[:-1],
    )
    variance_s = noise**2 * float(np.median(np.diff(time_s)))
    for i in range(count - 1):
        apart.joint[i], apart.joint_s[i], apart.reach_s[i] = apart.met(i, variance_s)
    return apart


def _moved(time_s: FloatArray, edges: IntArray, apart: _Apart) -> IntArray:
    """Edges with each corner's rows on the side of the crossing on which they lie."""
    moved = edges.copy()
    corner = np.flatnonzero(apart.joint == Joint.CORNER)
    moved[corner + 1] = np.searchsorted(time_s, apart.joint_s[corner], side="right")
    return edges if (np.diff(moved) < _FEWEST_ROWS).any() else moved


def _smoothed(time_s: FloatArray, value: FloatArray, noise: float, edges: IntArray, apart: _Apart) -> Pieces:
    """Fit each run of pieces that pass smoothly into each other as one, and gather all directions."""
    smooth = apart.joint == Joint.SMOOTH
    firsts = np.flatnonzero(np.concatenate([[True], ~smooth]))
    lasts = np.flatnonzero(np.concatenate([~smooth, [True]]))
    spans = [
        _span(time_s, value, noise, edges, apart, first=int(i), last=int(j)) for i, j in zip(firsts, lasts, strict=True)
    ]
    counts = [span.degree.size for span in spans]
    offsets = np.concatenate([[0], np.cumsum(counts)])
    total = int(offsets[-1])
    root = np.zeros((sum(span.root.shape[0] for span in spans), total, 4))
    joint = np.full(total - 1, int(Joint.SMOOTH))
    joint_s, reach_s = np.zeros(total - 1), np.zeros(total - 1)
    direction = 0
    for number, span in enumerate(spans):
        begin, end = int(offsets[number]), int(offsets[number + 1])
        root[direction : direction + span.root.shape[0], begin:end] = span.root
        direction += span.root.shape[0]
        joint_s[begin : end - 1] = span.inner_s
        if number < len(spans) - 1:
            met = int(lasts[number])
            joint[end - 1], joint_s[end - 1], reach_s[end - 1] = (
                apart.joint[met],
                apart.joint_s[met],
                apart.reach_s[met],
            )
    pieces = Pieces(
        float(time_s[0]),
        float(time_s[-1]),
        np.concatenate([span.centre_s for span in spans]),
        np.concatenate([span.half_s for span in spans]),
        np.concatenate([span.coefficient for span in spans]),
        np.concatenate([span.degree for span in spans]),
        np.concatenate([span.rows for span in spans]),
        joint,
        joint_s,
        reach_s,
        root,
    )
    joint_s[:] = pieces.crossings(pieces.coefficient)
    return pieces


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """Pieces from one corner or step to the next, fitted together; arrays as those of ``Pieces``."""

    centre_s: FloatArray
    half_s: FloatArray
    coefficient: FloatArray
    degree: IntArray
    rows: IntArray
    inner_s: FloatArray
    root: FloatArray


def _span(
    time_s: FloatArray, value: FloatArray, noise: float, edges: IntArray, apart: _Apart, *, first: int, last: int
) -> _Span:
    if first == last:
        own = slice(first, first + 1)
        rows = np.diff(edges[first : first + 2])
        root = apart.roots[first][:, None, :]
        if apart.degree[first] > 1:
            root = SHAPE_ERROR * root
        return _Span(
            apart.centre_s[own], apart.half_s[own], apart.coefficient[own], apart.degree[own], rows, np.empty(0), root
        )
    begin, end = int(edges[first]), int(edges[last + 1])
    node_s = np.concatenate([time_s[[begin]], apart.joint_s[first:last], time_s[[end - 1]]])
    node_s, degree, coefficient, root = smooth_span(
        time_s[begin:end], value[begin:end], node_s, np.maximum(apart.degree[first : last + 1], 1), noise
    )
    inside = np.searchsorted(time_s[begin:end], node_s[1:-1])
    rows = np.diff(np.concatenate([[0], inside, [end - begin]]))
    middle_s, half_s = 0.5 * (node_s[1:] + node_s[:-1]), 0.5 * np.diff(node_s)
    return _Span(middle_s, half_s, coefficient, degree, rows, node_s[1:-1], root)
