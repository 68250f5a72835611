"""What a waveform must keep before anything moves."""

from __future__ import annotations

import math

from drivers.addresses import MotionLimits
from valve.errors import WaveformError
from valve.waveform import Waveform


def check_waveform(tag: str, waveform: Waveform, limits: MotionLimits) -> None:
    """Refuse what the valve must not do. Raises WaveformError."""
    (low_pa, high_pa), (least_pa, most_pa) = waveform.range_pa, limits.pressure_pa
    slack_pa = 1.0e-9 * (most_pa - least_pa)
    if low_pa < least_pa - slack_pa or high_pa > most_pa + slack_pa:
        raise WaveformError(
            f"{tag}: waveform {waveform.name} goes from {low_pa:g} to {high_pa:g} Pa, limits.pressure_pa allows "
            f"{least_pa:g} to {most_pa:g} Pa: choose a smaller range"
        )
    rate = waveform.fastest_rate_pa_per_s
    if rate > limits.pressure_rate_pa_per_s * (1.0 + 1.0e-9) and not limits.steps_allowed:
        said = "jumps" if math.isinf(rate) else f"changes by {rate:g} Pa/s"
        other = "another sequence" if math.isinf(rate) else "a longer period"
        raise WaveformError(
            f"{tag}: waveform {waveform.name} {said}, limits.pressure_rate_pa_per_s allows "
            f"{limits.pressure_rate_pa_per_s:g} Pa/s: choose {other}, or allow steps by limits.steps_allowed"
        )
    if waveform.duration_s > limits.longest_test_s:
        raise WaveformError(
            f"{tag}: waveform {waveform.name} lasts {waveform.duration_s:g} s, limits.longest_test_s allows "
            f"{limits.longest_test_s:g} s: choose fewer cycles or a shorter period"
        )
