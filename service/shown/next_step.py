"""What to do after a diagnosis without a name: one sentence, of what is known of the test and of its misfit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

#: More than half: else no single coordinate says where to look.
_MOST: Final = 0.5
_FULL_SEQUENCE: Final = "diagnostic"
_LOOK_AT: Final = {
    "travel": "at stem, packing and seat where the misfit is largest, for it goes with the travel",
    "speed": "at packing and guide, for the misfit goes with the speed of the stem",
    "time": "for what changed during the test (supply pressure, vibration, another controller), for it goes with time",
    "time at rest": "at the packing, for the misfit goes with how long the stem stood",
    "force": "at actuator and pressure channel, for the misfit goes with the force",
}


def next_step(analysis: Mapping[str, Any], sequence: str | None) -> str:
    """Return what to do where something is there that no cause explains; "" for every other verdict.

    ``sequence`` is the one that the test played, None where nobody knows.
    """
    found = analysis.get("discrepancy") or {}
    if found.get("verdict") != "unexplained":
        return ""
    if sequence == _FULL_SEQUENCE:
        repeat = f"Repeat the sequence {_FULL_SEQUENCE}: what comes again at the same place is the valve's own"
    else:
        repeat = (
            f"Repeat with the sequence {_FULL_SEQUENCE}: its rests, small loops and many speeds tell most causes apart"
        )
    if (analysis.get("recording") or {}).get("acquisition") == "polled":
        repeat += ", most of all where the device captures the samples itself"
    coordinate = most_telling(analysis)
    return f"{repeat}; meanwhile look {_LOOK_AT[coordinate]}." if coordinate in _LOOK_AT else f"{repeat}."


def most_telling(analysis: Mapping[str, Any]) -> str | None:
    """Return the coordinate that explains most of the misfit, None where none explains more than half of it."""
    pictures = (analysis.get("discrepancy") or {}).get("pictures") or {}
    shares: Mapping[str, float] = pictures.get("explained") or {}
    if not shares:
        return None
    name = max(shares, key=lambda one: shares[one])
    return name if shares[name] > _MOST else None
