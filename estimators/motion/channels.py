"""How far apart in time force and position of a row may have been read."""

from __future__ import annotations

from typing import Final

from valve.recording import Acquisition, Recording

# Of a sampling period: what a device that takes all channels at one instant leaves to its converter, and the least
# that is believed of a file that says nothing (docs/reference-map.md, "Capture").
ONE_INSTANT: Final = 0.005


def channels_apart_s(recording: Recording | None) -> float:
    """Return one standard deviation of the delay between the channels, s, by what the recording says of it."""
    if recording is None:
        return 0.0
    least_s = ONE_INSTANT * recording.sample_period_s
    provenance = recording.provenance
    if provenance.acquisition in {Acquisition.CAPTURED, Acquisition.SIMULATED}:
        return least_s
    if provenance.timing_uncertainty_s is not None:
        return max(provenance.timing_uncertainty_s, least_s)
    exchange_s = recording.sampling_quality().median_exchange_s
    return least_s if exchange_s is None else max(0.5 * exchange_s, least_s)
