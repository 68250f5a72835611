"""A force of many corners as fewer chords, for the search: a curve that is drawn far finer than the position shows."""

# mypy: allow-untyped-defs
# numba types the kernel from its arguments, as in valve.kernel
from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from estimators.likelihood.inputs.transducer_path import TransducerPath
from estimators.likelihood.model import Corners, ForcePath, StemModel
from estimators.samples import FloatArray, IntArray
from valve.kernel.compiled import kernel

# Own choices.
_OFF: Final = 0.02  # of the position's noise, times the spring rate: what a chord may be off the force
_MANY: Final = 3000  # corners: fewer are followed in less time than all else takes
_WORTH: Final = 0.5  # of the corners, at most, are left: else the force stays as it is


def thinned(model: StemModel, values: dict[str, float]) -> StemModel:
    """Return the model, without a change of its rows, whose force goes in chords that its position does not show.

    ``values`` are of all unknowns by name, k among them. The chords have the force's mean; its deviations go with it.
    """
    time_s, force_n = model.corners(values)
    largest = float(model.weight.max(initial=0.0))
    if time_s.size < _MANY or largest == 0.0:
        return model
    if isinstance(model.path, TransducerPath):
        # another lag has another number of corners
        own = np.array([values[name] for name in model.input_names])
        return replace(model, path=model.path.with_fewer_corners(own, _MANY))
    kept = np.flatnonzero(_chord_ends(time_s, force_n, _OFF * values["k"] / largest))
    if kept.size > _WORTH * time_s.size:
        return model
    deviations = tuple((late_s[kept], more_n[kept]) for late_s, more_n in model.deviations)
    return replace(model, path=_Chords(model.path, time_s.size, kept), deviations=deviations)


class _Chords:
    """Some corners of another force, each moved so that the chords on both sides have its mean."""

    def __init__(self, path: ForcePath, count: int, kept: IntArray) -> None:
        self._path, self._count, self._kept = path, count, kept

    def corners(self, values: FloatArray) -> Corners:
        """Times, s, and forces, N, of the corners; all of them where they are others than those it was made for."""
        time_s, force_n = self._path.corners(values)
        return (time_s, force_n) if time_s.size != self._count else _balanced(time_s, force_n, self._kept)


def _balanced(time_s: FloatArray, force_n: FloatArray, kept: IntArray) -> Corners:
    area = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (force_n[1:] + force_n[:-1]))])
    own_s, own_n = time_s[kept], force_n[kept]
    length_s = np.diff(own_s)
    missed = np.diff(area[kept]) - 0.5 * length_s * (own_n[1:] + own_n[:-1])
    off_n = np.divide(missed, length_s, out=np.zeros_like(missed), where=length_s > 0.0)
    beside = np.concatenate([[0.0], off_n, [0.0]])
    return own_s, own_n + 0.5 * (beside[1:] + beside[:-1])


@kernel
def _chord_ends(time, value, off):
    """Return which corners (n,) are ends of chords that leave the line by no more than ``off``; both ends are."""
    n = time.size
    is_end = np.zeros(n, np.bool_)
    is_end[0] = is_end[n - 1] = True
    begin, low, high = 0, -np.inf, np.inf
    for i in range(1, n):
        length = time[i] - time[begin]
        slope = (value[i] - value[begin]) / length if length > 0.0 else np.inf
        if length <= 0.0 or not low <= slope <= high:
            # the last one ends the chord; a step ends it on both sides
            begin = i - 1 if i - 1 > begin else i
            is_end[i - 1] = is_end[begin] = True
            low, high = -np.inf, np.inf
            length = time[i] - time[begin]
        if length > 0.0:
            low = max(low, (value[i] - off - value[begin]) / length)
            high = min(high, (value[i] + off - value[begin]) / length)
    return is_end
