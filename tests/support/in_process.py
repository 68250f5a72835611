"""The motion process' own object in the process of a test, on a rig that need not have wires."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI

from drivers.addresses import BusAddress, ValveWiring
from drivers.motion.audit_log import AuditLog
from drivers.motion.bus_lock import BusLocks
from drivers.motion.motion import Motion
from drivers.motion.rig import Rig, WiredRig
from service.app import VERSION, create_app
from service.config.plant import Plant
from service.runs.analyst import Analyst
from service.store.store import Store


class _Live:
    """The valves of a plant that a reload changes in this process."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    @property
    def wirings(self) -> dict[str, ValveWiring]:
        return {tag: valve.wiring for tag, valve in self._plant.valves.items() if self._plant.is_ours(tag)}

    @property
    def buses(self) -> dict[str, BusAddress]:
        return self._plant.buses

    def read(self) -> None:
        """Nothing is read: the service changes the plant."""

    def take(self, fresh: None, kept: frozenset[str]) -> None:
        """It is taken over already."""

    def settle(self, tag: str) -> None:
        """It is settled already."""


def motion_on(
    plant: Plant, rig: Rig | None = None, audit: AuditLog | None = None, *, folder: Path | None = None
) -> Motion:
    """Return what moves the valves of a plant whose store is in ``folder``; ``rig`` stands in for its wires."""
    return Motion(
        _Live(plant),
        rig or WiredRig(plant.buses, f"breakaway {VERSION}"),
        (folder or plant.service.store) / "journals",
        locks=BusLocks(plant.buses),
        audit=audit,
    )


def app_of(
    plant: Plant, *, store: Store | None = None, rig: Rig | None = None, analyst: Analyst | None = None
) -> FastAPI:
    """Return the service of a plant that moves its valves in this process."""
    audit = AuditLog(plant.service.store / "audit", plant.service.gateway or "gateway")
    return create_app(plant, motion_on(plant, rig, audit), store=store, analyst=analyst)
