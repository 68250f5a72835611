"""``[valves.health]`` in plant.toml: the limits that each valve is judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from service.health.limits import HealthLimits
from service.settings_errors import Findings


def health_limits(findings: Findings, valves: Sequence[Mapping[str, Any]]) -> dict[str, HealthLimits]:
    """Return the limits by tag, the documented defaults where a valve has none of its own."""
    limits: dict[str, HealthLimits] = {}
    for index, raw in enumerate(valves):
        section = raw.get("health")
        own = findings.part(HealthLimits, section, ("valves", index, "health")) if isinstance(section, dict) else None
        limits[str(raw.get("tag"))] = own or HealthLimits()
    return limits
