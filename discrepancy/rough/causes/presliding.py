"""A stem that moves elastically before it breaks away."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from estimators.base import NORMAL_95
from valve.effects.presliding import Presliding as PreslidingEffect

FloatArray = npt.NDArray[np.float64]

YIELDING: Final = 6.0  # deflections: ln(1.9 / 0.02) of them after the force turned a stem slides, with a margin
LIMIT: Final = 5.0e-4  # of the travel: packings in good order yield by less
_INSIDE: Final = 0.5  # of F_c: so far below it nothing but bristles lets a stem move
_YIELDS: Final = 0.98  # of the bristles' largest force, at which they give way (Dahl's law as the valve has it)
_LAGS: Final = 4.0  # after a turn of the force a late stem still coasts
_PEAK: Final = 0.99  # quantile of the friction borne: the largest is noise
_FEWEST_ROWS: Final = 8
_FEWEST_TURNS: Final = 3
_SURE: Final = 4.0  # standard errors
_ALIKE: Final = 0.8  # of the turns at least, the stem yields towards the force


class Presliding(SeenCause):
    """Where the force turns, a stem held by friction stands still until it breaks away; one on bristles follows.

    By dF/dx = (F_s/deflection) (1 - F/F_m) it goes on by -deflection ln(1 - F/F_m) while friction turns its sign.
    """

    name: ClassVar[str] = "presliding"
    action: ClassVar[str] = "Look for a soft packing, and for a stem or a bracket that bends."
    is_last: ClassVar[bool] = False
    by_slips: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the deflection where the stem yields alike at most turns, and by more than a packing in good order."""
        found = np.array(self._deflections_m(view))
        if found.size < _FEWEST_TURNS or float(np.mean(found > 0.0)) < _ALIKE:
            return None
        deflection_m = float(np.median(found))
        # the median of so many, and no better known than they differ
        error_m = 1.2533 * float(np.std(found, ddof=1)) / math.sqrt(found.size)
        error_m *= float(student.ppf(0.975, found.size - 1)) / NORMAL_95
        if deflection_m < max(LIMIT * view.setting.travel_m, _SURE * error_m):
            return None
        return Seen({"deflection_m": Fitted(deflection_m, error_m, "m")}, PreslidingEffect(deflection_m))

    @staticmethod
    def _deflections_m(view: View) -> list[float]:
        """The deflection by each turn of the force, m."""
        reading, null = view.reading, view.null
        time_s, position_m, force_n = reading.time_s, reading.position_m, reading.path.force_n
        coulomb_n, lag_s = null.known("F_c").value, max(null.known("lag").value, 0.0)
        friction_n = force_n - null.known("k").value * position_m - null.known("F_0").value
        found = []
        for turn_s, next_s in pairwise([*reading.path.corners_s.tolist(), float(time_s[-1])]):
            first, last = np.searchsorted(time_s, [turn_s + _LAGS * lag_s, next_s])
            if last - first < _FEWEST_ROWS:
                continue
            sign = math.copysign(1.0, float(force_n[last - 1] - force_n[first]))
            towards_n, way_m = sign * friction_n[first:last], sign * (position_m[first:last] - position_m[first])
            # held on the other side at first, and then up to where it might break away
            over = np.flatnonzero(towards_n > _INSIDE * coulomb_n)
            ends = int(over[0]) if over.size else 0
            rows = np.flatnonzero(towards_n[:ends] > -_INSIDE * coulomb_n)
            if rows.size < _FEWEST_ROWS or towards_n[0] > -_INSIDE * coulomb_n:
                continue
            deflection_m = _slope(way_m[rows], towards_n[rows], coulomb_n)
            # F_s is the most that the bristles bear, until they give way
            borne_n = towards_n[np.abs(way_m) < YIELDING * abs(deflection_m)]
            static_n = max(coulomb_n, float(np.quantile(borne_n, _PEAK))) if borne_n.size else coulomb_n
            found.append(_slope(way_m[rows], towards_n[rows], static_n))
        return found

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return f"The stem yields by {fitted['deflection_m'].in_words(1.0e3, 'mm')} before it breaks away."


def _slope(way_m: FloatArray, towards_n: FloatArray, static_n: float) -> float:
    """The deflection with which a stem of this F_s goes this way under this friction, m; arrays of shape (n,)."""
    shape = -np.log1p(-towards_n * _YIELDS / static_n)
    away = shape - shape.mean()
    return float(away @ way_m) / float(away @ away)
