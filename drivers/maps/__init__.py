"""Register maps of devices, one file each; add one by its file and a line in REGISTER_MAPS.

A plant file may describe more of them (``[[maps]]``); those belong to its valves' wiring and to nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from drivers.maps import advantech_adam_6024, fisher_easy_drive, moxa_iologik, reference
from drivers.register_map import RegisterMap
from valve.errors import ConfigurationError
from valve.messages import say

REGISTER_MAPS: Final[dict[str, RegisterMap]] = {
    entry.name: entry
    for entry in (
        reference.MAP,
        advantech_adam_6024.MAP,
        moxa_iologik.E1240,
        moxa_iologik.E1241,
        fisher_easy_drive.OLDER,
        fisher_easy_drive.GEN_2,
    )
}


def register_map(name: str, own: Mapping[str, RegisterMap] | None = None) -> RegisterMap:
    """Return the map of this name, one of a plant's ``own`` included. Raises ConfigurationError for another name."""
    known = REGISTER_MAPS | dict(own or {})
    if name not in known:
        raise ConfigurationError(
            say(
                "map_unknown",
                "register map {map} is unknown: choose one of {known:, }",
                map=repr(name),
                known=tuple(known),
            )
        )
    return known[name]
