"""Breakaways that differ from one to the next by more than packings in good order do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.evidence import surely
from discrepancy.rough.setting import Setting
from estimators.base import NORMAL_95
from valve.messages import say

FloatArray = npt.NDArray[np.float64]

_PACKINGS_DO: Final = 0.08  # of F_s: a poor packing scatters by 6 %
_OF_FULL_FORCE: Final = 0.004  # or of the full force: what gauge and I/P leave
_FEWEST: Final = 6
_MIDDLE: Final = 0.6745  # standard deviations of a normal law that half of it lies within
_OFTEN: Final = 0.5  # of the scatter that the middle half must show too: no single breakaway stands out
_STAND_OUT: Final = 0.1  # of the breakaways, and two at least, without which so much of the scatter must be left
_ALIKE: Final = 1.64  # standard errors by which one is like the last: by chance one record in twenty is
_BY_ITSELF: Final = 0.8  # of the variance, that place, direction and time leave


class BreakawayScatter(SeenCause):
    """The breakaways' forces by the healthy fit: their standard deviation, a share of F_s, up to twice F_s.

    Each is drawn by itself. Where one is like the last, in friction or in force, something wanders or has moved: a
    spring, a sensor's zero, a stem that creeps while it rests.
    """

    name: ClassVar[str] = "breakaway_scatter"
    action: ClassVar[str] = say(
        "breakaway_scatter_action",
        "Look at the packing: dry, over-tightened, or of a material that sticks; positions are reached by chance.",
    )
    is_last: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the scatter if the low end of its interval is beyond what packings do, and many have a part in it."""
        null, setting = view.null, view.setting
        rows = null.problem.rows
        most_n = max(_PACKINGS_DO * setting.static_n, _OF_FULL_FORCE * setting.full_force_n)
        # what is known no better than packings scatter tells nothing: slow rows on quick ramps, the first after a rest
        usual = ~rows.is_slide & (rows.variance_n2 < most_n**2)
        forces_n = null.left_n[usual]
        if forces_n.size < _FEWEST:
            return None
        # what place, direction and time explain is no scatter
        way, place_m = rows.direction[usual], rows.travel_m[usual]
        opens, closes = way > 0.0, way < 0.0
        design = np.column_stack([opens, closes, place_m * opens, place_m * closes, rows.time_s[usual]])
        design = design / np.maximum(np.abs(design).max(axis=0), 1.0e-300)
        explained_n, _, rank, _ = np.linalg.lstsq(design, forces_n, rcond=1.0e-6)
        away_n = forces_n - design @ explained_n
        free = forces_n.size - int(rank)
        if free < _FEWEST - 1:
            return None
        noise_n2 = float(np.mean(rows.variance_n2[usual]))
        variance_n2 = float(away_n @ away_n) / free - noise_n2
        if variance_n2 <= 0.0:
            return None
        scatter_n = math.sqrt(variance_n2)
        low_n = surely(scatter_n, free)
        middle_n = float(np.median(np.abs(away_n - np.median(away_n)))) / _MIDDLE
        by_itself = float(away_n @ away_n) / max(float(np.sum((forces_n - forces_n.mean()) ** 2)), 1.0e-300)
        if low_n <= most_n or middle_n < _OFTEN * scatter_n or by_itself < _BY_ITSELF * free / (forces_n.size - 1):
            return None
        if _without_extremes(away_n) < _OFTEN * scatter_n or max(_repeats(away_n), _repeats(way * away_n)) > _ALIKE:
            return None
        static_n = max(setting.static_n, 1.0e-9)
        # what is told ends below where the decision did
        error = (scatter_n - low_n) / (NORMAL_95 * static_n)
        return Seen({"scatter": Fitted(scatter_n / static_n, error, "1")}, None)

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return say(
            "breakaways_differ",
            "The breakaways' forces differ by {share} from one to the next; packings do up to {usual:.0f %}.",
            share=fitted["scatter"].in_words("%"),
            usual=_PACKINGS_DO,
        )


def _without_extremes(away_n: FloatArray) -> float:
    """Root mean square of the breakaways without those that stand out, N."""
    kept = away_n.size - max(2, round(_STAND_OUT * away_n.size))
    return math.sqrt(float(np.mean(np.sort(away_n**2)[:kept])))


def _repeats(away_n: FloatArray) -> float:
    """By how many standard errors each breakaway is like the one before it: their first autocorrelation."""
    return float(away_n[1:] @ away_n[:-1]) / float(away_n @ away_n) * math.sqrt(away_n.size)
