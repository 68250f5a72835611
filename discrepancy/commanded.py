"""The valve behind an I/P as maximum likelihood fits it: where the causes of a command alone begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from discrepancy.observed import Observed
from estimators.likelihood.inputs.transducer_path import DEAD_TIME, LAG

_VALVE: Final = ("m", "k", "F_v", "F_c", "F_0", "DV")
# What a command comes late by in this fit: an I/P's lag, and its dead time beside it, s.
LAG_S: Final = "lag_s"
DEAD_TIME_S: Final = "dead_time_s"


def from_estimate(fitted: Mapping[str, float], guess: Mapping[str, float]) -> dict[str, float]:
    """Return what an estimate has ``fitted`` under the baseline's names, SI, with a ``guess`` for what it lacks."""
    values = {**guess, **{name: float(value) for name, value in fitted.items()}}
    values["d"] = max(0.0, values["F_s"] / values["F_c"] - 1.0) if "F_s" in fitted else values.get("d", 0.0)
    return values


def with_commanded(observed: Observed, fitted: Mapping[str, float]) -> Observed:
    """Return the recordings with the valve and the I/P that maximum likelihood has ``fitted`` to the command alone.

    As they are where the pressure was measured, or where the fit has no I/P or no whole valve.
    """
    if not observed.command_only or LAG not in fitted or any(name not in fitted for name in _VALVE):
        return observed
    whole = from_estimate(fitted, {})
    valve = {name: whole[name] for name in (*_VALVE, "d")}
    late = {LAG_S: max(0.0, whole[LAG]), DEAD_TIME_S: max(0.0, whole.get(DEAD_TIME, 0.0))}
    # its breakaways are all alike
    return replace(observed, commanded={**valve, "first_rise": 0.0, **late})
