"""``limits.end_out_of_family`` in plant.toml: refused where no test of the valve could ever follow it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.addresses import Mode
from valve.messages import say

if TYPE_CHECKING:
    from drivers.wiring import Wired
    from service.config.errors import Findings
    from service.config.valves import ValveParts


def check_family_rule(findings: Findings, valve: ValveParts, wired: Wired | None) -> None:
    """Note where the rule is on and the valve's tests cannot be ended, or do not show their forces."""
    if valve.limits is None or not valve.limits.end_out_of_family:
        return
    key = (*valve.key, "limits", "end_out_of_family")
    if valve.acquisition is not None and valve.acquisition.mode is not Mode.POLLED:
        findings.add(
            key,
            True,
            say(
                "family_rule_needs_polling",
                "{tag}: it needs polled tests, acquisition.mode is {mode} and its device plays to the end",
                tag=valve.tag,
                mode=valve.acquisition.mode.value,
            ),
            say("poll_or_no_family_rule", "say acquisition.mode = polled, or end_out_of_family = false"),
        )
    is_without_area = valve.nameplate is not None and valve.nameplate.actuator.diaphragm_area_m2 is None
    is_without_pressure = wired is not None and wired.pressure is None
    if is_without_area or is_without_pressure:
        findings.add(
            key,
            True,
            say("family_rule_needs_force", "{tag}: it needs the force of the actuator", tag=valve.tag),
            say(
                "measure_force_or_no_family_rule",
                "give {missing} and a measured pressure, or say end_out_of_family = false",
                missing="actuator.diaphragm_area_m2",
            ),
        )
