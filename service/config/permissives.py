"""``[valves.permissives]`` as a plant has it: what the nameplate fills in, and what must be said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from drivers.maps import register_map
from drivers.permissive_rules import PermissiveRules
from drivers.points import Point
from drivers.register_map import RegisterMap
from valve.errors import ConfigurationError
from valve.messages import say
from valve.nameplate import Nameplate

if TYPE_CHECKING:
    from service.config.errors import Findings, Key

_BEYOND_TRAVEL: Final = 0.1  # of the travel: transmitters are set up with some room at both ends
_STILL: Final = 0.01  # of the travel; a position sensor's noise is a tenth of that or less


def stem_rules_of(rules: PermissiveRules, nameplate: Nameplate) -> PermissiveRules:
    """Return the rules with where the stem can be and how still it must stand, from its travel where not given."""
    travel_m = nameplate.actuator.travel_m
    return replace(
        rules,
        position_m=rules.position_m or (-_BEYOND_TRAVEL * travel_m, (1.0 + _BEYOND_TRAVEL) * travel_m),
        still_m=rules.still_m or _STILL * travel_m,
    )


def check_permissives(
    findings: Findings, key: Key, command: Point, rules: PermissiveRules, maps: Mapping[str, RegisterMap]
) -> None:
    """Note where nothing could ever permit a test of this valve."""
    try:
        device = None if command.map is None else register_map(command.map, maps)
    except ConfigurationError:
        return  # told already
    shows_manual = device is not None and device.live is not None and device.live.manual_mask != 0
    if not (shows_manual or rules.manual is not None or rules.permit or rules.manual_waived):
        findings.add(
            (*key, "permissives"),
            None,
            say("map_without_manual", "map {map} does not show whether the loop is in manual", map=str(command.map)),
            say(
                "name_manual",
                "name permissives.manual, demand a permit (permissives.permit = true) or say permissives.manual_waived",
            ),
        )
    if rules.device_number is not None and (device is None or device.number is None):
        findings.add(
            (*key, "permissives", "device_number"),
            rules.device_number,
            say("map_without_number", "map {map} shows no number of the device", map=str(command.map)),
            say("remove_it", "remove it"),
        )
