"""What was seen and does not matter yet: the sensor's filter, an I/P that lags or hunts."""

from __future__ import annotations

from typing import Final

import numpy as np

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.position_lag import LIMIT_S, lag_of
from discrepancy.rough.causes.seen import View
from discrepancy.rough.causes.transducer_delay import beyond_limit, delays
from discrepancy.rough.result import Finding
from valve.messages import say

_LEAST_S: Final = 0.004
_LEAST_SHARE: Final = 5.0e-4  # of the span
_KNOWN: Final = 0.3  # of it, its error: what is known worse says nothing
_IF_QUICK: Final = say(
    "stem_lag_action", "If this valve is known to be quick, check the damping of its position transmitter."
)
_NOTHING: Final = say("nothing_to_do", "Nothing needs to be done.")


def remarks(view: View, *, is_plain: bool) -> tuple[Finding, ...]:
    """Return what the engine's model takes into account of this recording's instruments.

    ``is_plain``: no cause is told, which may look like a stem that is late.
    """
    found = []
    slow = view.null.known("lag")
    if is_plain and slow.value - 2.0 * slow.std_error > LIMIT_S:
        late_s = Fitted(slow.value, slow.std_error, "s")
        said = say(
            "stem_follows_late",
            "The stem follows its force {lag} late: it is damped, or its position reading lags.",
            lag=late_s.in_words("ms"),
        )
        found.append(Finding("stem_lag", said, _IF_QUICK, {"lag_s": late_s}))
    lag = lag_of(view)
    if lag is not None and _LEAST_S < lag.value < LIMIT_S and lag.std_error < _KNOWN * lag.value:
        said = say("position_filtered", "The position sensor has a filter of {lag}.", lag=lag.in_words("ms"))
        found.append(Finding("position_filter", said, _NOTHING, {"lag_s": lag}))
    path = view.reading.path
    late = delays(view.recording)
    if late is not None:
        lag_words, delay_words = late.lag.in_words("ms"), late.dead_time.in_words("ms")
        lags = say("pressure_lags_by", "The pressure lags the command by {lag}.", lag=lag_words)
        follows = say("pressure_follows_after", "The pressure follows the command after {delay}.", delay=delay_words)
        for name, key, known, said in (
            ("transducer_lag", "lag_s", late.lag, lags),
            ("transducer_dead_time", "delay_s", late.dead_time, follows),
        ):
            if known.value > _LEAST_S and known.std_error < _KNOWN * known.value and not beyond_limit(known):
                found.append(Finding(name, said, _NOTHING, {key: known}))
    span_n = float(np.ptp(path.force_n))
    beside = float(np.std(path.left_n)) / max(span_n, 1.0e-9)
    if beside > _LEAST_SHARE:
        said = say(
            "pressure_beside_command",
            "The measured pressure leaves the command's path by {share:.2f %} of its range: noise and hunting.",
            share=beside,
        )
        found.append(Finding("pressure_noise", said, _NOTHING, {"share": Fitted(beside, 0.0, "1")}))
    return tuple(found)
