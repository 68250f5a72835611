"""What was seen and does not matter yet: the sensor's filter, an I/P that lags or hunts."""

from __future__ import annotations

from typing import Final

import numpy as np

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.position_lag import LIMIT_S, lag_of
from discrepancy.rough.causes.seen import View
from discrepancy.rough.causes.transducer_delay import beyond_limit, delays
from discrepancy.rough.result import Finding

_LEAST_S: Final = 0.004
_LEAST_SHARE: Final = 5.0e-4  # of the span
_NOTHING: Final = "Nothing needs to be done."


def remarks(view: View) -> tuple[Finding, ...]:
    """Return what the engine's model takes into account of this recording's instruments."""
    found = []
    lag = lag_of(view)
    if lag is not None and _LEAST_S < lag.value < LIMIT_S and lag.std_error < 0.3 * lag.value:
        said = f"The position sensor has a filter of {lag.in_words(1.0e3, 'ms')}."
        found.append(Finding("position_filter", said, _NOTHING, {"lag_s": lag}))
    path = view.reading.path
    late = delays(view.recording)
    if late is not None:
        for name, key, known, what in (
            ("transducer_lag", "lag_s", late.lag, "lags the command by"),
            ("transducer_dead_time", "delay_s", late.dead_time, "follows the command after"),
        ):
            if known.value > _LEAST_S and not beyond_limit(known):
                said = f"The pressure {what} {known.in_words(1.0e3, 'ms')}."
                found.append(Finding(name, said, _NOTHING, {key: known}))
    span_n = float(np.ptp(path.force_n))
    beside = float(np.std(path.left_n)) / max(span_n, 1.0e-9)
    if beside > _LEAST_SHARE:
        share = f"{100.0 * beside:.2f} %"
        said = f"The measured pressure leaves the command's path by {share} of its range: noise and hunting."
        found.append(Finding("pressure_noise", said, _NOTHING, {"share": Fitted(beside, 0.0, "1")}))
    return tuple(found)
