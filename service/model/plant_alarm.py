"""An alarm of the plant as a whole: what keeps every test, or the tests of some valves, from being made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Final

from valve.messages import joined, say

_NAMED: Final = 5  # valves of one sentence


class AlarmKind(StrEnum):
    """What is wrong."""

    MOTION_PROCESS = "motion_process"
    PLANT_FILE = "plant_file"


@dataclass(frozen=True, slots=True)
class PlantAlarm:
    """What is wrong since when, what to do, and the valves that it is about; none named: all."""

    kind: AlarmKind
    since: datetime
    sentence: str
    remedy: str
    valves: tuple[str, ...] = ()


def no_motion_process(since: datetime, reason: str) -> PlantAlarm:
    """Return the alarm that the motion process cannot be asked; ``reason`` is what was heard of it."""
    return PlantAlarm(
        AlarmKind.MOTION_PROCESS,
        since,
        say(
            "motion_process_does_not_answer",
            "The motion process does not answer ({why}). No valve can be tested, and Stop reaches none: "
            "a valve that moves goes to its safe value by the watchdog of its device alone.",
            why=reason,
        ),
        say(
            "look_at_motion_process",
            "On the gateway: systemctl status breakaway-motion, or breakaway motion --config plant.toml",
        ),
    )


def other_plant_file(since: datetime, valves: Sequence[str], buses: Sequence[str]) -> PlantAlarm:
    """Return the alarm that service and motion process have read different plant files, of these valves and buses."""
    named = say("valves_named", "{valves:, }", valves=tuple(valves[:_NAMED]))
    if len(valves) > _NAMED:
        named = say("valves_named_and_more", "{valves} and {n} more", valves=named, n=len(valves) - _NAMED)
    sentence = say(
        "other_plant_file",
        "Service and motion process have read different plant files: wiring or limits differ. "
        "No test starts of {valves}.",
        valves=named,
    )
    restart = say("restart_both", "systemctl restart breakaway-motion breakaway, while no valve moves")
    if buses:
        moved = say("other_addresses", "Other addresses: bus {buses:, }.", buses=tuple(buses))
        sentence = joined(" ", (sentence, moved))
    return PlantAlarm(
        AlarmKind.PLANT_FILE,
        since,
        sentence,
        restart
        if buses
        else say("reload_first", "breakaway reload; if that does not end it: {restart}", restart=restart),
        tuple(valves),
    )
