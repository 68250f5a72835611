"""Which of several recordings the methods can read as one: those that were sampled about as often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from valve.messages import Message, say
from valve.recording import Recording

# What the estimators take for a gap within one recording: each row of a slower one would begin the stem anew.
_LONGEST_STEP_PERIODS: Final = 1.75


def of_like_periods(recordings: Sequence[Recording]) -> list[int]:
    """Return the numbers, from 0, of recordings with like sampling periods: of such groups that with most samples.

    With a group of one the first of the largest; a recording of one row has no period and goes with any.
    """
    best: list[int] = []
    most = -1
    for one in recordings:
        like = [number for number, other in enumerate(recordings) if _alike(one, other)]
        samples = sum(recordings[number].samples for number in like)
        if samples > most:
            best, most = like, samples
    return best


def _alike(one: Recording, other: Recording) -> bool:
    if one.samples < 2 or other.samples < 2:
        return True
    short_s, long_s = sorted((one.sample_period_s, other.sample_period_s))
    return long_s <= _LONGEST_STEP_PERIODS * short_s


def periods_note(recordings: Sequence[Recording], read: Sequence[int]) -> str:
    """Return which recordings of other periods the diagnosis was only tried on; "" where there is none."""
    left = [number for number in range(len(recordings)) if number not in read]
    if not left:
        return ""
    return say(
        "recordings_of_other_rates",
        "The methods, the signature and the diagnosis are those of recording {own:, } alone: recording {others:, } was "
        "sampled at another rate, and the diagnosis was tried on it. Analyse it by itself for its own result.",
        own=tuple(_with_period(number, recordings[number]) for number in read),
        others=tuple(_with_period(number, recordings[number]) for number in left),
    )


def _with_period(number: int, recording: Recording) -> Message:
    return say(
        "number_with_period", "{number} (every {period:.3g ms})", number=number + 1, period=recording.sample_period_s
    )
