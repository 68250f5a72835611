"""What to do after a diagnosis without a name: one sentence, of what is known of the test and of its misfit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from service.words.sentences import as_sentence
from valve.messages import say

#: More than half: else no single coordinate says where to look.
_MOST: Final = 0.5
_FULL_SEQUENCE: Final = "diagnostic"
_LOOK_AT: Final = {
    "travel": say(
        "look_where_largest", "at stem, packing and seat where the misfit is largest, for it goes with the travel"
    ),
    "speed": say("look_at_packing_and_guide", "at packing and guide, for the misfit goes with the speed of the stem"),
    "time": say(
        "look_for_change",
        "for what changed during the test (supply pressure, vibration, another controller), for it goes with time",
    ),
    "time at rest": say("next_at_packing", "at the packing, for the misfit goes with how long the stem stood"),
    "force": say("look_at_actuator", "at actuator and pressure channel, for the misfit goes with the force"),
}


def next_step(analysis: Mapping[str, Any], sequence: str | None) -> str:
    """Return what to do where something is there that no cause explains; "" for every other verdict.

    ``sequence`` is the one that the test played, None where nobody knows.
    """
    found = analysis.get("discrepancy") or {}
    if found.get("verdict") != "unexplained":
        return ""
    if sequence == _FULL_SEQUENCE:
        repeat = say(
            "repeat_sequence",
            "Repeat the sequence {sequence}: what comes again at the same place is the valve's own",
            sequence=_FULL_SEQUENCE,
        )
    else:
        repeat = say(
            "repeat_with_sequence",
            "Repeat with the sequence {sequence}: its rests, small loops and many speeds tell most causes apart",
            sequence=_FULL_SEQUENCE,
        )
    if (analysis.get("recording") or {}).get("acquisition") == "polled":
        repeat = say(
            "best_captured", "{repeat}, most of all where the device captures the samples itself", repeat=repeat
        )
    coordinate = most_telling(analysis)
    if coordinate in _LOOK_AT:
        repeat = say("meanwhile_look", "{repeat}; meanwhile look {where}", repeat=repeat, where=_LOOK_AT[coordinate])
    return as_sentence(repeat)


def most_telling(analysis: Mapping[str, Any]) -> str | None:
    """Return the coordinate that explains most of the misfit, None where none explains more than half of it."""
    pictures = (analysis.get("discrepancy") or {}).get("pictures") or {}
    shares: Mapping[str, float] = pictures.get("explained") or {}
    if not shares:
        return None
    name = max(shares, key=lambda one: shares[one])
    return name if shares[name] > _MOST else None
