"""How many digits a measured number carries: no more than its interval, and the instrument behind it, know."""

from __future__ import annotations

import math
from typing import Final

#: Of the value: a good pressure transmitter, and a good travel sensor, is true to about 0.1 %.
INSTRUMENT: Final = 1.0e-3
_LEAST: Final = 1.0e-300  # below it there is no logarithm


def carried_places(value: float, half_width: float | None = None) -> tuple[int, bool]:
    """Decimal places of a value, negative for tens, and whether its 95 % interval is worth showing beside it.

    ``half_width`` is half of that interval, None where it is unknown. An interval of less than 0.1 % of the value
    claims more than the instrument knows: the value alone is shown, with three digits, four where it begins with 1
    (50.7, 1423, 52500). A wider one is shown with two digits, but no more than one place beyond those of the value.
    """
    is_nothing = not _LEAST < abs(value) < math.inf
    by_instrument = 0 if is_nothing else 2 - math.floor(math.log10(0.5 * abs(value)))
    if half_width is None or not max(INSTRUMENT * abs(value), _LEAST) < half_width < math.inf:
        return by_instrument, False
    by_interval = 1 - math.floor(math.log10(half_width))
    return by_interval if is_nothing else min(by_interval, by_instrument + 1), True
