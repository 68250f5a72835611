"""plant.toml: read, checked as a whole, and made into the ``Plant`` that the rest uses."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final
from zoneinfo import ZoneInfo

from pydantic import BaseModel, ConfigDict, Field

from drivers.addresses import BusAddress, GaugeAddress, RtuAddress, TcpAddress, TlsAddress, ValveWiring
from service.config.access import AccessSection, access_settings
from service.config.checks import check_schedules, check_wiring
from service.config.database import database_address
from service.config.errors import Fault, Findings, read_toml
from service.config.health import health_limits
from service.config.maps import own_maps, without_wrong
from service.config.mqtt import mqtt_settings
from service.config.nightly import (
    RetentionSection,
    gateway_of_bus,
    gateways,
    groups_by_name,
    name_gateway,
    schedules,
    zone_named,
)
from service.config.plant import Plant, PlantValve, Retention, ServiceSettings, zone_of
from service.config.valves import ValveParts, valve_parts
from service.config.watching import by_clock_of, check_watching
from valve.errors import ConfigurationError
from valve.messages import message_of, say
from valve.nameplate import Nameplate

STRICT: Final = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)

_BUS_KINDS: Final[dict[str, type[BusAddress]]] = {
    "modbus_tcp": TcpAddress,
    "modbus_tls": TlsAddress,
    "modbus_rtu": RtuAddress,
    "serial_gauge": GaugeAddress,
}


class ServiceSection(AccessSection):
    """``[service]``."""

    model_config = STRICT
    store: str = Field(min_length=1)
    bind: str = "127.0.0.1"
    port: int = Field(default=8321, ge=0, le=65535)
    database: str | None = None
    database_password_file: str | None = None
    gateway: str | None = None
    zone: str | None = None
    plant: str = Field(default="", max_length=200)
    retention: RetentionSection | None = None


class PlantSection(BaseModel):
    """The whole file."""

    model_config = STRICT
    service: dict[str, Any]
    buses: Annotated[list[dict[str, Any]], Field(min_length=1)]
    valves: Annotated[list[dict[str, Any]], Field(min_length=1)]
    groups: list[dict[str, Any]] = []
    schedules: list[dict[str, Any]] = []
    gateways: list[dict[str, Any]] = []
    mqtt: dict[str, Any] | None = None
    maps: list[dict[str, Any]] = []
    classes: dict[str, dict[str, Any]] = {}


def load_plant(path: Path) -> Plant:
    """Read a plant file. Raises ConfigurationError that names file, key, value, reason and remedy, one line a fault."""
    plant, findings = read_plant(path)
    if plant is None:
        raise findings.error()
    return plant


def faults_of(path: Path, text: str | None = None) -> tuple[Plant | None, tuple[Fault, ...]]:
    """Return the plant of a file, or None with everything that is wrong with it; no TOML is one fault.

    ``text`` is what the file would have: it is judged instead, and the file need not be there.
    """
    try:
        plant, findings = read_plant(path, text)
    except ConfigurationError as error:
        return None, (Fault("", "", None, message_of(error)),)
    return plant, findings.faults


def read_plant(path: Path, text: str | None = None) -> tuple[Plant | None, Findings]:
    """Read a plant file: the plant, or None where something was found. Raises ConfigurationError where it is no TOML.

    A part that is wrong is left out of what follows, so that each fault is told once and the rest is judged all the
    same.
    """
    findings = Findings(path.name)
    raw = read_toml(path, text)
    findings.model(PlantSection, raw, ())
    service_part = raw.get("service")
    service_part = service_part if isinstance(service_part, dict) else None
    own: object = None
    if service_part is not None:
        name_gateway(service_part)
        own = service_part.get("gateway")
    service, approved = _service(findings, service_part, path.parent)
    urls = gateways(findings, _tables(raw, "gateways"), own if isinstance(own, str) else None)
    buses, bus_gateways = _buses(findings, _tables(raw, "buses"), urls)
    sections = _tables(raw, "valves")
    maps = own_maps(findings, _tables(raw, "maps"))
    valves = [valve_parts(findings, one, ("valves", index), maps) for index, one in enumerate(sections)]
    health = health_limits(findings, sections, _named_tables(raw, "classes"))
    tags = {valve.tag for valve in valves}
    groups = groups_by_name(findings, _tables(raw, "groups"), tags)
    checks = schedules(findings, _tables(raw, "schedules"), groups, tags)
    broker_part = raw.get("mqtt")
    broker = mqtt_settings(findings, broker_part if isinstance(broker_part, dict) else None, path.parent)
    wired = check_wiring(findings, buses, valves, bus_gateways)
    check_schedules(findings, checks, {valve.tag: valve for valve in valves}, wired, approved)
    check_watching(findings, [(valve.key, valve.wiring) for valve in valves], wired, buses)
    if findings or service is None:
        return None, findings
    zone = zone_of(service, checks.values())
    return Plant(
        path,
        service,
        {address.name: address for address in buses.values() if address is not None},
        {
            valve.tag: PlantValve(*_whole(valve, zone), health[valve.tag], valve.identity, valve.limits_class)
            for valve in valves
        },
        {name: tags_of or () for name, tags_of in groups.items()},
        tuple(checks.values()),
        urls,
        bus_gateways,
        broker,
        without_wrong(maps),
    ), findings


def _whole(valve: ValveParts, zone: ZoneInfo | None) -> tuple[Nameplate, ValveWiring]:
    assert valve.nameplate is not None  # where nothing was found, nothing is missing
    assert valve.wiring is not None
    return valve.nameplate, by_clock_of(valve.wiring, zone)


def _tables(raw: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """Return an array of tables; nothing where the file has something else there, which is told with the whole."""
    value = raw.get(key)
    is_list = isinstance(value, list) and all(isinstance(one, dict) for one in value)
    return value if isinstance(value, list) and is_list else []


def _named_tables(raw: Mapping[str, Any], key: str) -> dict[str, dict[str, Any]]:
    """Return tables by their names; nothing where the file has something else there, which is told with the whole."""
    value = raw.get(key)
    return value if isinstance(value, dict) and all(isinstance(one, dict) for one in value.values()) else {}


def _service(
    findings: Findings, raw: dict[str, Any] | None, folder: Path
) -> tuple[ServiceSettings | None, list[str] | None]:
    """Return ``[service]``, and the sequences that it approves, None for all."""
    section = None if raw is None else findings.model(ServiceSection, raw, ("service",))
    if section is None:
        return None, None
    loopback: bool | None = None
    try:
        loopback = ipaddress.ip_address(section.bind).is_loopback
    except ValueError:
        findings.add(
            ("service", "bind"),
            section.bind,
            say("no_ip_address", "it is no IP address"),
            say("give_ip_address", "give one such as 127.0.0.1"),
        )
    zone = None if section.zone is None else zone_named(findings, ("service", "zone"), section.zone)
    database = database_address(findings, section.database, section.database_password_file, folder)
    # an address that is none is reached by nobody: what else is wrong with the access is still found
    access = access_settings(
        findings, section, bind=section.bind, loopback=True if loopback is None else loopback, folder=folder
    )
    if access is None or loopback is None:
        return None, section.approved_sequences
    return ServiceSettings(
        (folder / section.store).resolve(),
        section.bind,
        section.port,
        database,
        section.gateway or "",
        None if section.retention is None else Retention(**section.retention.model_dump()),
        access,
        zone,
        section.plant,
    ), section.approved_sequences


def _buses(
    findings: Findings, sections: list[dict[str, Any]], known: Mapping[str, str]
) -> tuple[dict[int, BusAddress | None], dict[str, str]]:
    """Return the buses by their place in the file, None where one is wrong, and by the name of each whose it is."""
    buses: dict[int, BusAddress | None] = {}
    owners: dict[str, str] = {}
    for index, raw in enumerate(sections):
        key = ("buses", index)
        kind, name = raw.get("kind"), raw.get("name")
        gateway = gateway_of_bus(findings, key, raw.get("gateway"), known)
        if not isinstance(kind, str) or kind not in _BUS_KINDS:
            findings.add(
                (*key, "kind"),
                kind,
                say("no_kind_of_bus", "it is no kind of bus"),
                say("choose_one_of", "choose one of {known:, }", known=tuple(_BUS_KINDS)),
            )
            buses[index] = None
        else:
            parts = {name: raw[name] for name in raw if name != "gateway"}
            buses[index] = findings.part(_BUS_KINDS[kind], parts, key)
        if isinstance(name, str):
            owners.setdefault(name, gateway)
    return buses, owners
