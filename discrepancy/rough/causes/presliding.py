"""A stem that moves elastically before it breaks away."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from estimators.engine.yielding import MOST_YIELD, Held, driven_of, yielding
from valve.effects.presliding import Presliding as PreslidingEffect
from valve.messages import say

_LIMIT: Final = 5.0e-4  # of the travel: packings in good order yield by less


class Presliding(SeenCause):
    """Where the force turns, a stem held by friction stands still until it breaks away; one on bristles follows."""

    name: ClassVar[str] = "presliding"
    action: ClassVar[str] = say("presliding_action", "Look for a soft packing, and for a stem or a bracket that bends.")
    is_last: ClassVar[bool] = False
    by_slips: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the deflection where the stem yields by more than a packing in good order, and by no more than any."""
        null = view.null
        spring, preload_n, coulomb_n, lag_s = (null.known(symbol).value for symbol in ("k", "F_0", "F_c", "lag"))
        found = yielding(driven_of(view.reading), Held(spring, preload_n, coulomb_n, lag_s))
        if found is None or not _LIMIT <= found.value / view.setting.travel_m <= MOST_YIELD:
            return None
        return Seen({"deflection_m": Fitted(found.value, found.std_error, "m")}, PreslidingEffect(found.value))

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return say(
            "stem_yields",
            "The stem yields by {way} before it breaks away.",
            way=fitted["deflection_m"].in_words("mm"),
        )
