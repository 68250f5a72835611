"""The same recordings in longer blocks where the stem moves evenly: what a fit needs before it has found its place."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.observed import Observed, Segment
from estimators.samples import FloatArray, IntArray

# Own choice: blurred residuals, means over 0.1 s and more, lose nothing by it.
_MERGED: Final = 4  # blocks of more than one row each


def thinned(observed: Observed) -> Observed:
    """Return the recordings with up to four blocks in one; rows that stand alone, where it is fast, stay alone."""
    return replace(observed, segments=tuple(_thinned(segment) for segment in observed.segments), spread=None)


def _thinned(segment: Segment) -> Segment:
    first = _firsts(segment)
    rows = np.add.reduceat(segment.rows, first)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(segment.rows * values, first) / rows)

    return replace(
        segment,
        time_s=mean(segment.time_s),
        position_m=mean(segment.position_m),
        # independent errors: their weights' squares add up
        weight=np.sqrt(np.add.reduceat(segment.weight**2, first)),
        rows=rows,
    )


def _firsts(segment: Segment) -> IntArray:
    """Return the first block of each group, shape (g,): no group reaches over a gap or over a row that stands alone."""
    count = segment.time_s.size
    alone = segment.rows <= 1.0
    usual_s = float(np.median(np.diff(segment.time_s)[~alone[1:]])) if (~alone[1:]).any() else 0.0
    begins = alone.copy()
    begins[0] = True
    begins[1:] |= alone[:-1] | (np.diff(segment.time_s) > 1.5 * usual_s)
    place = np.arange(count)
    since = place - np.maximum.accumulate(np.where(begins, place, 0))
    return np.asarray(np.flatnonzero(since % _MERGED == 0), dtype=np.int64)
