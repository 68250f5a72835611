"""A pressure that cannot follow to the top."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from valve.messages import say

_MISSING: Final = 0.01  # of the span, by which the pressure stays below the command
_FLAT: Final = 0.004  # of the span, within which it stays at its top
_GOES_ON: Final = 0.01  # of the span, by which the command changes while the pressure stays at its top
_LEAST: Final = 0.01  # of the rows
_ELSEWHERE: Final = 0.01  # of the span: how well it follows below


class SupplySaturation(SeenCause):
    """The measured pressure stays at its top while the command goes on."""

    name: ClassVar[str] = "supply_saturation"
    action: ClassVar[str] = say("supply_saturation_action", "Look at the air supply's pressure and its regulator.")
    is_last: ClassVar[bool] = False

    def seen(self, view: View) -> Seen | None:
        """Return the highest pressure where the command asks for more."""
        known = view.command_and_pressure_pa()
        if known is None:
            return None
        command_pa, pressure_pa = known
        span_pa = float(np.ptp(command_pa))
        top_pa = float(np.quantile(pressure_pa, 0.995))
        asked = command_pa > top_pa + _MISSING * span_pa
        if float(asked.mean()) < _LEAST:
            return None
        # of a command that is held up there an I/P may stay short for other reasons
        lowest_pa, highest_pa = np.quantile(command_pa[asked], [0.05, 0.95]).tolist()
        goes_on = highest_pa - lowest_pa > _GOES_ON * span_pa
        at_top = pressure_pa[asked]
        flat = float(np.quantile(at_top, 0.95) - np.quantile(at_top, 0.3)) < _FLAT * span_pa
        below = command_pa < top_pa - 5.0 * _MISSING * span_pa
        follows = abs(float(np.median(pressure_pa[below] - command_pa[below]))) < _ELSEWHERE * span_pa
        if not (goes_on and flat and follows):
            return None
        limit_pa = float(np.median(at_top))
        return Seen({"limit_pa": Fitted(limit_pa, float(np.std(at_top)) / np.sqrt(at_top.size), "Pa")}, None)

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return say(
            "pressure_limited",
            "The pressure does not rise above {limit}.",
            limit=fitted["limit_pa"].in_words("kPa"),
        )
