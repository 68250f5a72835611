"""What only the whole plant shows: names that point somewhere, and limits that fit together."""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

from drivers.addresses import BusAddress, GaugeAddress, Point, RtuAddress, ValveWiring
from drivers.capabilities import Role
from drivers.maps import register_map
from drivers.waveform_check import check_waveform
from drivers.wiring import Bus, wire
from service.bus import make_bus
from service.bus_lock import place_of
from service.runs.sequences import build_waveform
from service.settings_permissives import check_permissives
from valve.errors import ConfigurationError, ValveError
from valve.nameplate import Nameplate

if TYPE_CHECKING:
    from service.settings_errors import Findings, Key
    from service.settings_nightly import Schedule


def check_wiring(
    findings: Findings,
    buses: Sequence[BusAddress],
    valves: Sequence[tuple[Nameplate, ValveWiring]],
    gateways: Mapping[str, str],
) -> None:
    """Note every contradiction between the parts of a plant."""
    by_name: dict[str, BusAddress] = {}
    unopened: dict[str, Bus] = {}
    for index, address in enumerate(buses):
        if address.name in by_name:
            findings.add(("buses", index, "name"), address.name, "another bus has this name", "rename one")
        by_name[address.name] = address
        try:
            unopened[address.name] = make_bus(address)
        except ConfigurationError as error:
            findings.add_error(("buses", index), error)
    _check_places(findings, buses, gateways)
    tags: set[str] = set()
    commanded: dict[tuple[object, ...], str] = {}
    for index, (nameplate, wiring) in enumerate(valves):
        key: Key = ("valves", index)
        if wiring.tag in tags:
            findings.add((*key, "tag"), wiring.tag, "another valve has this tag", "rename one")
        tags.add(wiring.tag)
        for role, point in (("command", wiring.command), ("position", wiring.position), ("pressure", wiring.pressure)):
            if point is not None:
                _check_point(findings, (*key, role), role, point, by_name)
        _check_gateways(findings, (*key, "command", "bus"), wiring, gateways)
        others = {commanded.setdefault(word, wiring.tag) for word in _commanded_words(wiring.command)} - {wiring.tag}
        for other in sorted(others):
            findings.add(
                (*key, "command"),
                f"{wiring.command.bus}, device_id {wiring.command.device_id}",
                f"{wiring.tag} would move {other}, which is commanded by the same register",
                "correct one: its bus, device_id or register",
            )
        _check_limits(findings, (*key, "limits", "pressure_pa"), nameplate, wiring)
        check_permissives(findings, key, wiring)
        if not findings:  # what is left is for the drivers to find
            try:
                wire(wiring, unopened)
            except ConfigurationError as error:
                findings.add_error(key, error)


def _check_places(findings: Findings, buses: Sequence[BusAddress], gateways: Mapping[str, str]) -> None:
    """Refuse two names for one line: each would be driven as if it were alone.

    A serial port and the loopback interface are each gateway's own.
    """
    places: dict[tuple[str, str], str] = {}
    for index, address in enumerate(buses):
        place = place_of(address)
        if isinstance(address, (RtuAddress, GaugeAddress)):
            key, local = "serial_port", True
        else:
            key, local = "port", _is_loopback(place.rpartition(":")[0])
        other = places.setdefault((gateways.get(address.name, "") if local else "", place), address.name)
        if other != address.name:
            findings.add(("buses", index, key), place, f"bus {other} is there too", f"use {other} for both")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _check_gateways(findings: Findings, key: Key, wiring: ValveWiring, gateways: Mapping[str, str]) -> None:
    """Refuse a valve whose test would need buses of two gateways."""
    points = (wiring.command, wiring.position, wiring.pressure)
    needed = sorted({gateways.get(point.bus, "") for point in points if point is not None})
    if len(needed) > 1:
        findings.add(
            key,
            wiring.tag,
            f"its buses belong to gateways {' and '.join(needed)}",
            "wire all that its test needs to one gateway",
        )


def check_schedules(
    findings: Findings,
    schedules: Sequence[Schedule],
    valves: Sequence[tuple[Nameplate, ValveWiring]],
    approved: Collection[str] | None,
) -> None:
    """Note every schedule that is not approved, and every valve that cannot or must not follow what one asks of it."""
    by_tag = {nameplate.tag: (nameplate, wiring) for nameplate, wiring in valves}
    for index, schedule in enumerate(schedules):
        if approved is not None and schedule.sequence not in approved:
            findings.add(
                ("schedules", index, "sequence"),
                schedule.sequence,
                f"service.approved_sequences has {', '.join(sorted(approved))} alone",
                "choose one of them, or approve it",
            )
        for tag in schedule.valves:
            nameplate, wiring = by_tag[tag]
            if wiring.permissives.permit:
                findings.add(
                    ("schedules", index, "valves"),
                    tag,
                    "its tests need a work permit, and a schedule names none: every check would be skipped",
                    "take the valve out of the schedule and its groups, or its permissives.permit away",
                )
            limits = wiring.limits
            try:
                check_waveform(tag, build_waveform(schedule.sequence, schedule.overrides, nameplate, limits), limits)
            except ValveError as error:
                text = str(error)
                findings.add(
                    ("schedules", index, "sequence"),
                    schedule.sequence,
                    text if text.startswith(tag) else f"{tag}: {text}",
                    "choose another sequence or overrides for this valve",
                )


def _commanded_words(command: Point) -> list[tuple[object, ...]]:
    """Every word that commanding this point writes; none where the point is wrong in itself, which is told anyway."""
    try:
        device = register_map(command.map or "")
        name = command.register or device.roles.get(Role.COMMAND)
        register = None if name is None else device.register(name)
    except ConfigurationError:
        return []
    if register is None:
        return []
    words = range(register.address, register.address + register.words)
    return [(command.bus, command.device_id, register.table, word) for word in words]


def _check_point(findings: Findings, key: Key, role: str, point: Point, buses: dict[str, BusAddress]) -> None:
    address = buses.get(point.bus)
    if address is None:
        findings.add((*key, "bus"), point.bus, "no bus has this name", f"choose one of {', '.join(buses)}")
        return
    is_gauge = isinstance(address, GaugeAddress)
    if is_gauge and role != "position":
        findings.add((*key, "bus"), point.bus, f"a gauge measures positions, not the {role}", "name a Modbus bus")
    elif is_gauge and point.map is not None:
        findings.add((*key, "map"), point.map, f"bus {point.bus} is a gauge, it has no registers", "remove it")
    elif not is_gauge and point.map is None:
        findings.add(
            (*key, "map"), None, f"bus {point.bus} is Modbus, its device has registers", "name device_id and map"
        )
    if point.map is None:
        return
    try:
        chosen = register_map(point.map)
        for name in (point.register, point.readback_register):
            if name is not None:
                chosen.register(name)
    except ConfigurationError as error:
        findings.add_error((*key, "map"), error)


def _check_limits(findings: Findings, key: Key, nameplate: Nameplate, wiring: ValveWiring) -> None:
    if nameplate.signal is None:
        return
    (low_pa, high_pa), (signal_low_pa, signal_high_pa) = wiring.limits.pressure_pa, nameplate.signal.range_pa
    slack_pa = 1.0e-9 * (signal_high_pa - signal_low_pa)
    if low_pa < signal_low_pa - slack_pa or high_pa > signal_high_pa + slack_pa:
        findings.add(
            key,
            list(wiring.limits.pressure_pa),
            f"the I/P gives {signal_low_pa:g} to {signal_high_pa:g} Pa",
            "stay inside signal.range_pa",
        )
