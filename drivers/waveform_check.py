"""What a waveform must keep before anything moves."""

from __future__ import annotations

import math

from drivers.addresses import MotionLimits
from valve.errors import WaveformError
from valve.messages import say
from valve.waveform import Waveform


def check_waveform(tag: str, waveform: Waveform, limits: MotionLimits) -> None:
    """Refuse what the valve must not do. Raises WaveformError."""
    (low_pa, high_pa), (least_pa, most_pa) = waveform.range_pa, limits.pressure_pa
    slack_pa = 1.0e-9 * (most_pa - least_pa)
    if low_pa < least_pa - slack_pa or high_pa > most_pa + slack_pa:
        raise WaveformError(
            say(
                "waveform_beyond_limits",
                "{tag}: waveform {sequence} goes from {low:g in Pa} to {high:g Pa}, limits.pressure_pa "
                "allows {allowed_low:g in Pa} to {allowed_high:g Pa}: choose a smaller range",
                tag=tag,
                sequence=waveform.name,
                low=low_pa,
                high=high_pa,
                allowed_low=least_pa,
                allowed_high=most_pa,
            )
        )
    rate = waveform.fastest_rate_pa_per_s
    if rate > limits.pressure_rate_pa_per_s * (1.0 + 1.0e-9) and not limits.steps_allowed:
        allowed = limits.pressure_rate_pa_per_s
        if math.isinf(rate):
            raise WaveformError(
                say(
                    "waveform_jumps",
                    "{tag}: waveform {sequence} jumps, limits.pressure_rate_pa_per_s allows {allowed:g Pa/s}: choose "
                    "another sequence, or allow steps by limits.steps_allowed",
                    tag=tag,
                    sequence=waveform.name,
                    allowed=allowed,
                )
            )
        raise WaveformError(
            say(
                "waveform_too_fast",
                "{tag}: waveform {sequence} changes by {rate:g Pa/s}, limits.pressure_rate_pa_per_s allows "
                "{allowed:g Pa/s}: choose a longer period, or allow steps by limits.steps_allowed",
                tag=tag,
                sequence=waveform.name,
                rate=float(rate),
                allowed=allowed,
            )
        )
    if waveform.duration_s > limits.longest_test_s:
        raise WaveformError(
            say(
                "waveform_too_long",
                "{tag}: waveform {sequence} lasts {time:g s}, limits.longest_test_s allows {most:g s}: "
                "choose fewer cycles or a shorter period",
                tag=tag,
                sequence=waveform.name,
                time=waveform.duration_s,
                most=limits.longest_test_s,
            )
        )
