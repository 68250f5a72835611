"""The separating test of a diagnosis: the sequences that a valve's limits allow, and which tells the causes apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Final

import numpy as np

from discrepancy.rough.separating import Planned, SeparatingTest, Undecided, separating_test
from service.model.sequences import SEQUENCES, Room
from valve.errors import WaveformError
from valve.messages import say
from valve.recording import Recording

# What a separating test is chosen from; steps are left out, as no step is followed to better than a sample.
_CHOSEN_FROM: Final[tuple[tuple[str, dict[str, float]], ...]] = (
    ("diagnostic", {}),
    ("multi_rate", {}),
    ("multi_rate", {"duration_s": 150.0}),
    ("small_loops", {}),
    ("dwell", {}),
)
# Without a plant's limits: the whole range in a second, for two and a half minutes.
_USUAL_RAMP_S: Final = 1.0
_USUAL_LONGEST_S: Final = 150.0
NOTHING_SEPARATES: Final = say(
    "nothing_separates", "No sequence that the valve's limits allow would tell these causes apart."
)


def room_of_recordings(recordings: Sequence[Recording]) -> dict[str, float] | None:
    """Return what tests like these may use: their range of pressure; None where no pressure was recorded."""
    levels = [one.pressure_pa if one.command_pa is None else one.command_pa for one in recordings]
    known = [values for values in levels if values is not None and np.isfinite(values).any()]
    if not known:
        return None
    low_pa = min(float(np.nanmin(values)) for values in known)
    high_pa = max(float(np.nanmax(values)) for values in known)
    if not high_pa > low_pa:
        return None
    return asdict(Room(low_pa, high_pa, (high_pa - low_pa) / _USUAL_RAMP_S, _USUAL_LONGEST_S))


def find_separating_test(undecided: Undecided | None, room: Mapping[str, float] | None) -> SeparatingTest | None:
    """Return the test that tells apart what a diagnosis leaves undecided, None where none does."""
    if undecided is None or room is None:
        return None
    return separating_test(undecided, planned(Room(**room)))


def planned(room: Room) -> list[Planned]:
    """Return the sequences that this room allows, between its pressures."""
    allowed = []
    for name, more in _CHOSEN_FROM:
        overrides = {"low_pa": room.low_pa, "high_pa": room.high_pa, **more}
        try:
            waveform = SEQUENCES[name].model_validate(overrides).waveform(room)
        except WaveformError:
            continue
        if waveform.fastest_rate_pa_per_s <= room.rate_pa_per_s and waveform.duration_s <= room.longest_s:
            allowed.append(Planned(name, overrides, waveform))
    return allowed
