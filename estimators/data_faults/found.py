"""All faults of the data of recordings, found one after the other before anything is estimated."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.data_faults.clocks import from_first_row, on_one_clock, with_even_stamps
from estimators.data_faults.drop_outs import without_drop_outs
from estimators.data_faults.fault import DataFault, place_of
from estimators.data_faults.held_values import exception_report, without_held_values
from estimators.data_faults.odd_samples import without_odd_samples_of
from estimators.data_faults.vacuum import as_gauge
from valve.messages import Message, say
from valve.nameplate import Nameplate
from valve.recording import Recording


def recording_number(number: int) -> Message:
    """Return what a recording without a name is called, counted from 1."""
    return say("recording_number", "recording {number}", number=number)


def without_data_faults(
    recordings: Sequence[Recording], nameplate: Nameplate, names: Sequence[str] | None = None
) -> tuple[list[Recording], list[DataFault]]:
    """Return the recordings with their data's faults left out or put right, and what was found, by number or ``names``.

    Samples that cannot be right become gaps and are never filled in. A healthy recording comes back as it was, its
    time counted from its first row.
    """
    if names is None:
        names = [recording_number(number) for number in range(1, len(recordings) + 1)] if len(recordings) > 1 else [""]
    cleaned: list[Recording] = []
    told: list[DataFault] = []
    for name, recording in zip(names, recordings, strict=True):
        one, said = _put_right(recording, nameplate, place_of(name))
        cleaned.append(one)
        told += said
    return cleaned, told


def _put_right(recording: Recording, nameplate: Nameplate, place: str) -> tuple[Recording, list[DataFault]]:
    told: list[DataFault] = []
    # each looks at what the ones before it left: a held value is no drop-out that lasts, a drop-out no spike
    for step in (from_first_row, without_held_values, without_drop_outs, without_odd_samples_of, with_even_stamps):
        recording, said = step(recording, place)
        told += said
    told += exception_report(recording, place)
    recording, said = on_one_clock(recording, place)
    told += said
    recording, said = as_gauge(recording, nameplate, place)
    return recording, told + said
