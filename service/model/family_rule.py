"""The rule that ends a test at a breakaway twice the last one (``limits.end_out_of_family``): its event."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from valve.messages import say

#: Of how a test ended early: the event that did it.
OUT_OF_FAMILY_KEY: Final = "out_of_family"


def event_of(notice: Mapping[str, Any]) -> dict[str, float]:
    """Return what is kept of a notice (``service.runs.out_of_family``): which breakaway, when, and both forces.

    ``breakaway`` counts those of the test so far, ``times`` is its force when it was seen by the last one's.
    """
    force_n, last_n = float(notice["force_n"]), float(notice["last_n"])
    return {
        "breakaway": int(notice["breakaway"]),
        "time_s": float(notice["time_s"]),
        "force_n": force_n,
        "last_n": last_n,
        "times": force_n / last_n,
    }


def event_of_early(ended_early: Mapping[str, Any] | None) -> Mapping[str, Any] | None:
    """Return the event that ended a test early; None where something else did, or nothing."""
    return None if ended_early is None else ended_early.get(OUT_OF_FAMILY_KEY)


def event_words(event: Mapping[str, Any]) -> str:
    """Return the event as a clause."""
    return say(
        "breakaway_out_of_family",
        "breakaway {number:.0f} took {force:.0f N} after {time:.1f s}, {times:.1f} times the {last:.0f N} of the last",
        number=float(event["breakaway"]),
        force=float(event["force_n"]),
        time=float(event["time_s"]),
        times=float(event["times"]),
        last=float(event["last_n"]),
    )
