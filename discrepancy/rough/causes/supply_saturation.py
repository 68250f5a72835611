"""A pressure that cannot follow to the top."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted, FloatArray
from discrepancy.rough.causes.seen import InputCause, Seen, command_and_pressure_pa
from estimators.engine.segmentation import moving_mean
from valve.messages import say
from valve.recording import Recording

_MISSING: Final = (0.002, 0.01)  # of the span, by which the pressure stays below the command: quiet and noisy
_SURE: Final = 6.0  # standard deviations of the pressure's noise that it stays below the command
_QUICK: Final = 0.01  # of the record: what of a pressure is quicker is its noise
_FLAT: Final = 0.004  # of the span, within which it stays at its top
_STAYS: Final = 0.3  # of what the command goes on by, within which it stays there: one that lags turns as well
_OF_MEDIAN: Final = 1.4826  # standard deviation over the median of the absolute values
_LEAST: Final = 0.005  # of the rows
_ELSEWHERE: Final = 0.01  # of the span: how well it follows below


class SupplySaturation(InputCause):
    """The measured pressure stays at its top while the command goes on."""

    name: ClassVar[str] = "supply_saturation"
    action: ClassVar[str] = say("supply_saturation_action", "Look at the air supply's pressure and its regulator.")

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the highest pressure where the command asks for more."""
        known = command_and_pressure_pa(recording)
        if known is None:
            return None
        command_pa, pressure_pa = known
        span_pa = float(np.ptp(command_pa))
        top_pa = float(np.quantile(pressure_pa, 0.995))
        missing_pa = min(max(_SURE * self._noise_pa(pressure_pa), _MISSING[0] * span_pa), _MISSING[1] * span_pa)
        asked = command_pa > top_pa + missing_pa
        if float(asked.mean()) < _LEAST:
            return None
        # a command that is held up there, or has turned, an I/P may not follow for other reasons
        rises = asked & (np.gradient(moving_mean(command_pa, self._width(command_pa))) > 0.0)
        if not rises.any():
            return None
        lowest_pa, highest_pa = np.quantile(command_pa[rises], [0.05, 0.95]).tolist()
        goes_on_pa = highest_pa - lowest_pa
        goes_on = goes_on_pa > missing_pa
        at_top = pressure_pa[rises]
        flat_pa = float(np.quantile(at_top, 0.95) - np.quantile(at_top, 0.3))
        flat = flat_pa < min(_FLAT * span_pa, max(_STAYS * goes_on_pa, missing_pa))
        below = command_pa < top_pa - 5.0 * _MISSING[1] * span_pa
        beside_pa = np.abs(np.median(pressure_pa[below] - command_pa[below])) if below.any() else np.inf
        follows = float(beside_pa) < _ELSEWHERE * span_pa
        if not (goes_on and flat and follows):
            return None
        limit_pa = float(np.median(at_top))
        return Seen({"limit_pa": Fitted(limit_pa, float(np.std(at_top)) / np.sqrt(at_top.size), "Pa")}, None)

    @staticmethod
    def _width(rows: FloatArray) -> int:
        """How many rows of a record of shape (n,) are quick."""
        return 2 * (round(_QUICK * rows.size) // 2) + 1

    def _noise_pa(self, pressure_pa: FloatArray) -> float:
        """Standard deviation of what is quick in the pressure, Pa, shape (n,)."""
        quick = np.abs(pressure_pa - moving_mean(pressure_pa, self._width(pressure_pa)))
        return _OF_MEDIAN * float(np.median(quick))

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "pressure_limited",
            "The pressure does not rise above {limit}.",
            limit=fitted["limit_pa"].in_words("kPa"),
        )
