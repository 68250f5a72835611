"""What only the whole plant shows: names that point somewhere, and limits that fit together."""

from __future__ import annotations

import ipaddress
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from drivers.addresses import BusAddress, GaugeAddress, MotionLimits, Point, RtuAddress, ValveWiring
from drivers.bus import Bus, unopened
from drivers.capabilities import Role
from drivers.maps import register_map
from drivers.motion.bus_lock import place_of
from drivers.register_map import RegisterMap
from drivers.representable import misfits, waveform_misfit
from drivers.waveform_check import check_waveform
from drivers.wiring import Signal, Wired, wire
from service.config.family_rule import check_family_rule
from service.config.maps import without_wrong
from service.config.permissives import check_permissives
from service.model.sequences import build_waveform
from service.model.until import until_of
from valve.errors import ConfigurationError, RequestError, ValveError, WaveformError
from valve.messages import Message, message_of, say
from valve.nameplate import Nameplate
from valve.nameplate import Signal as Transducer

_LEAST_SEEN: Final = 0.05  # of the travel in a position's range, and the other way round; below it the unit is another

if TYPE_CHECKING:
    from service.config.errors import Findings, Key
    from service.config.valves import ValveParts
    from service.model.schedule import Schedule


def check_wiring(
    findings: Findings,
    buses: Mapping[int, BusAddress | None],
    valves: Sequence[ValveParts],
    gateways: Mapping[str, str],
) -> dict[str, Wired]:
    """Note every contradiction between the parts of a plant, and every value that a device cannot hold.

    ``gateways`` has every bus by its name, also one that is wrong. Returns the valves that could be wired, by tag.
    """
    by_name: dict[str, BusAddress] = {}
    named: dict[str, Bus] = {}
    for index, address in buses.items():
        if address is None:
            continue
        if address.name in by_name:
            findings.add(
                ("buses", index, "name"),
                address.name,
                say("other_bus_has_name", "another bus has this name"),
                say("rename_one", "rename one"),
            )
        by_name[address.name] = address
        named[address.name] = unopened(address)
    _check_places(findings, buses, gateways)
    tags: set[str] = set()
    commanded: dict[tuple[object, ...], str] = {}
    wired: dict[str, Wired] = {}
    for valve in valves:
        if valve.tag in tags and valve.tag:
            findings.add(
                (*valve.key, "tag"),
                valve.tag,
                say("other_valve_has_tag", "another valve has this tag"),
                say("rename_one", "rename one"),
            )
        tags.add(valve.tag)
        before = len(findings)
        _check_points(findings, valve, by_name, gateways, commanded)
        is_placed = len(findings) == before
        if valve.limits is not None and valve.signal is not None:
            _check_limits(findings, (*valve.key, "limits", "pressure_pa"), valve.limits, valve.signal)
        if valve.permissives is not None and "command" in valve.points:
            check_permissives(
                findings, valve.key, valve.points["command"], valve.permissives, without_wrong(valve.maps)
            )
        wiring = valve.wiring
        if wiring is None or not is_placed or not _buses_of(wiring) <= named.keys():
            check_family_rule(findings, valve, None)
            continue  # what is left is for the drivers to find
        try:
            wired[valve.tag] = wire(wiring, named)
        except ConfigurationError as error:
            findings.add_error(valve.key, error)
            continue
        check_family_rule(findings, valve, wired[valve.tag])
        for misfit in misfits(wiring, wired[valve.tag]):
            findings.add((*valve.key, *misfit.key), misfit.value, misfit.reason, misfit.remedy)
        if valve.nameplate is not None:
            _check_travel(findings, (*valve.key, "position", "quantity"), valve.nameplate, wired[valve.tag])
    return wired


def _check_travel(findings: Findings, key: Key, nameplate: Nameplate, wired: Wired) -> None:
    """Refuse a position whose range is in another unit than the travel, which no limit of the position would notice."""
    if not isinstance(wired.position, Signal):
        return
    span, travel_m = wired.position.register.span, nameplate.actuator.travel_m
    seen_m = min(span.greatest, travel_m) - max(span.least, 0.0)
    if span.step == 0.0 and wired.position.register.raw_range is None:
        return  # a float in m: it has no range
    if seen_m < _LEAST_SEEN * travel_m or span.greatest - span.least > travel_m / _LEAST_SEEN:
        findings.add(
            key,
            [span.least, span.greatest],
            say(
                "range_beside_travel",
                "it is the range of {name} in m, and the travel is {travel:g m}",
                name=wired.position.register.name,
                travel=travel_m,
            ),
            say("write_quantity_in_m", "write quantity in m"),
        )


def _buses_of(wiring: ValveWiring) -> set[str]:
    points = (wiring.command, wiring.position, wiring.pressure, *wiring.permissives.points)
    return {point.bus for point in points if point is not None}


def _check_points(
    findings: Findings,
    valve: ValveParts,
    buses: Mapping[str, BusAddress],
    gateways: Mapping[str, str],
    commanded: dict[tuple[object, ...], str],
) -> None:
    """Judge where a valve's signals and contacts stand; ``commanded`` are the words that other valves command."""
    for role, point in valve.points.items():
        _check_point(findings, (*valve.key, role), role, point, buses=buses, declared=gateways, maps=valve.maps)
    rules = valve.permissives
    if rules is not None:
        for role, place in (("manual", rules.manual), ("interlock", rules.interlock), ("supply", rules.supply)):
            if place is not None:
                point = (
                    place if isinstance(place, Point) else Point(place.bus, place.device_id, place.map, place.register)
                )
                key = (*valve.key, "permissives", role)
                _check_point(findings, key, role, point, buses=buses, declared=gateways, maps=valve.maps)
    command = valve.points.get("command")
    if command is None:
        return
    _check_gateways(findings, (*valve.key, "command", "bus"), valve, gateways)
    for other in sorted(
        {commanded.setdefault(word, valve.tag) for word in _commanded_words(command, valve.maps)} - {valve.tag}
    ):
        findings.add(
            (*valve.key, "command"),
            f"{command.bus}, device_id {command.device_id}",
            say(
                "same_register_commanded",
                "{tag} would move {other}, which is commanded by the same register",
                tag=valve.tag,
                other=other,
            ),
            say("correct_the_command", "correct one: its bus, device_id or register"),
        )


def _check_places(findings: Findings, buses: Mapping[int, BusAddress | None], gateways: Mapping[str, str]) -> None:
    """Refuse two names for one line: each would be driven as if it were alone.

    A serial port and the loopback interface are each gateway's own.
    """
    places: dict[tuple[str, str], str] = {}
    for index, address in buses.items():
        if address is None:
            continue
        place = place_of(address)
        if isinstance(address, (RtuAddress, GaugeAddress)):
            key, local = "serial_port", True
        else:
            key, local = "port", _is_loopback(place.rpartition(":")[0])
        other = places.setdefault((gateways.get(address.name, "") if local else "", place), address.name)
        if other != address.name:
            findings.add(
                ("buses", index, key),
                place,
                say("bus_is_there_too", "bus {other} is there too", other=other),
                say("use_one_bus", "use {other} for both", other=other),
            )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _check_gateways(findings: Findings, key: Key, valve: ValveParts, gateways: Mapping[str, str]) -> None:
    """Refuse a valve whose test would need buses of two gateways."""
    contacts = () if valve.permissives is None else valve.permissives.points
    buses = {point.bus for point in (*valve.points.values(), *contacts)}
    needed = sorted({gateways[bus] for bus in buses if bus in gateways})
    if len(needed) > 1:
        findings.add(
            key,
            valve.tag,
            say("buses_of_gateways", "its buses belong to gateways {gateways: and }", gateways=tuple(needed)),
            say("wire_to_one_gateway", "wire all that its test needs to one gateway"),
        )


def check_schedules(
    findings: Findings,
    schedules: Mapping[int, Schedule],
    valves: Mapping[str, ValveParts],
    wired: Mapping[str, Wired],
    approved: Collection[str] | None,
) -> None:
    """Note every schedule that is not approved, and every valve that cannot or must not follow what one asks of it."""
    for index, schedule in schedules.items():
        key = ("schedules", index, "sequence")
        if approved is not None and schedule.sequence not in approved:
            findings.add(
                key,
                schedule.sequence,
                say(
                    "approved_alone",
                    "service.approved_sequences has {approved:, } alone",
                    approved=tuple(sorted(approved)),
                ),
                say("choose_or_approve", "choose one of them, or approve it"),
            )
        for tag in schedule.valves:
            valve = valves.get(tag)
            if valve is None:
                continue  # told with the schedule
            if valve.permissives is not None and valve.permissives.permit:
                findings.add(
                    ("schedules", index, "valves"),
                    tag,
                    say(
                        "permit_in_schedule",
                        "its tests need a work permit, and a schedule names none: every check would be skipped",
                    ),
                    say(
                        "take_valve_out",
                        "take the valve out of the schedule and its groups, or its permissives.permit away",
                    ),
                )
            reason, is_of_all = _cannot_follow(schedule, valve, wired.get(tag))
            if reason:
                remedy = (
                    say("choose_other_sequence", "choose another sequence or overrides")
                    if is_of_all
                    else say("choose_other_for_valve", "choose another sequence or overrides for this valve")
                )
                findings.add(key, schedule.sequence, reason, remedy)
            no_end = _cannot_end_early(schedule, valve)
            if no_end:
                findings.add(("schedules", index, "until"), dict(schedule.until or {}), no_end, "")
            if is_of_all or no_end:
                break


def _cannot_follow(schedule: Schedule, valve: ValveParts, wired: Wired | None) -> tuple[str, bool]:
    """Return why a valve cannot follow a schedule, "" where it can, and whether that holds for every valve."""
    nameplate, limits = valve.nameplate, valve.limits
    if nameplate is None or limits is None:
        return "", False
    try:
        waveform = build_waveform(schedule.sequence, schedule.overrides, nameplate, limits)
        check_waveform(valve.tag, waveform, limits)
    except ValveError as error:
        text = message_of(error)
        is_of_all = not isinstance(error, WaveformError)
        names_it = valve.tag in text.values.values() if isinstance(text, Message) else text.startswith(valve.tag)
        return (text if is_of_all or names_it else _of_valve(valve, text)), is_of_all
    misfit = "" if wired is None or valve.wiring is None else waveform_misfit(valve.wiring, wired, waveform)
    return (_of_valve(valve, misfit) if misfit else ""), False


def _of_valve(valve: ValveParts, why: str) -> str:
    return say("of_valve", "{tag}: {why}", tag=valve.tag, why=why)


def _cannot_end_early(schedule: Schedule, valve: ValveParts) -> str:
    """Return why a valve's tests cannot end as a schedule's ``until`` says, and what to do; "" where they can."""
    acquisition = valve.acquisition
    if schedule.until is None or acquisition is None:
        return ""
    try:
        until_of(valve.tag, acquisition.mode, schedule.sequence, schedule.until)
    except RequestError as error:
        return message_of(error)
    return ""


def _commanded_words(command: Point, maps: Mapping[str, RegisterMap | None]) -> list[tuple[object, ...]]:
    """Every word that commanding this point writes; none where the point is wrong in itself, which is told anyway."""
    try:
        device = register_map(command.map or "", without_wrong(maps))
        name = command.register or device.roles.get(Role.COMMAND)
        register = None if name is None else device.register(name)
    except ConfigurationError:
        return []
    if register is None:
        return []
    words = range(register.address, register.address + register.words)
    return [(command.bus, command.device_id, register.table, word) for word in words]


def _check_point(
    findings: Findings,
    key: Key,
    role: str,
    point: Point,
    *,
    buses: Mapping[str, BusAddress],
    declared: Collection[str],
    maps: Mapping[str, RegisterMap | None],
) -> None:
    address = buses.get(point.bus)
    if address is None and point.bus not in declared:
        findings.add(
            (*key, "bus"),
            point.bus,
            say("no_bus_of_name", "no bus has this name"),
            say("choose_one_of", "choose one of {known:, }", known=tuple(declared)),
        )
    elif isinstance(address, GaugeAddress):
        if role != "position":
            findings.add(
                (*key, "bus"),
                point.bus,
                say("gauge_measures_positions", "a gauge measures positions, not the {role}", role=role),
                say("name_modbus_bus", "name a Modbus bus"),
            )
        elif point.map is not None:
            findings.add(
                (*key, "map"),
                point.map,
                say("gauge_has_no_registers", "bus {bus} is a gauge, it has no registers", bus=point.bus),
                say("remove_it", "remove it"),
            )
    elif address is not None and point.device_id is None:
        findings.add(
            (*key, "map"),
            None,
            say("modbus_has_registers", "bus {bus} is Modbus, its device has registers", bus=point.bus),
            say("name_device_and_map", "name device_id and map"),
        )
    elif address is not None and point.device_id is not None:
        fault = address.device_id_fault(point.device_id)
        if fault:
            findings.add_error(
                (*key, "device_id"),
                ConfigurationError(say("fault_of_bus", "bus {bus}: {fault}", bus=point.bus, fault=fault)),
            )
    if point.map is None or maps.get(point.map, ...) is None:
        return  # a gauge, or a map that is wrong in itself, which is told there
    try:
        chosen = register_map(point.map, without_wrong(maps))
    except ConfigurationError as error:
        findings.add_error((*key, "map"), error)
        return
    for name in (point.register, point.readback_register):
        if name is not None:
            try:
                chosen.register(name)
            except ConfigurationError as error:
                findings.add_error((*key, "map"), error)


def _check_limits(findings: Findings, key: Key, limits: MotionLimits, signal: Transducer) -> None:
    (low_pa, high_pa), (signal_low_pa, signal_high_pa) = limits.pressure_pa, signal.range_pa
    slack_pa = 1.0e-9 * (signal_high_pa - signal_low_pa)
    if low_pa < signal_low_pa - slack_pa or high_pa > signal_high_pa + slack_pa:
        findings.add(
            key,
            list(limits.pressure_pa),
            say("ip_gives", "the I/P gives {low:g in Pa} to {high:g Pa}", low=signal_low_pa, high=signal_high_pa),
            say("stay_inside_range", "stay inside {limits}", limits="signal.range_pa"),
        )
