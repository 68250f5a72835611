"""plant.toml: read, validated into the dataclasses that the rest uses, and checked as a whole."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field

from drivers.addresses import (
    BusAddress,
    GaugeAddress,
    MotionLimits,
    Point,
    RtuAddress,
    Sampling,
    TcpAddress,
    TlsAddress,
    ValveWiring,
    WatchdogChoice,
)
from drivers.permissive_rules import PermissiveRules
from service.health.limits import HealthLimits
from service.nameplates import nameplate_from_mapping
from service.settings_access import AccessSection, AccessSettings, access_settings
from service.settings_checks import check_schedules, check_wiring
from service.settings_database import DatabaseAddress, database_address
from service.settings_errors import Findings, read_toml
from service.settings_health import health_limits
from service.settings_mqtt import MqttSettings, mqtt_settings
from service.settings_nightly import (
    Retention,
    RetentionSection,
    Schedule,
    gateway_of_bus,
    gateways,
    groups_by_name,
    name_gateway,
    schedules,
)
from service.settings_permissives import stem_rules_of
from service.settings_safe_value import SafeValue
from valve.errors import ConfigurationError, ValveError
from valve.nameplate import Actuator, Nameplate, Signal

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
    retention: RetentionSection | None = None


class ValveSection(BaseModel):
    """One ``[[valves]]``, its parts still as they stand in the file."""

    model_config = STRICT
    tag: Annotated[str, Field(min_length=1, max_length=64)]
    safe_value_pa: SafeValue
    actuator: dict[str, Any]
    limits: dict[str, Any]
    command: dict[str, Any]
    acquisition: dict[str, Any]
    signal: dict[str, Any] | None = None
    position: dict[str, Any] | None = None
    pressure: dict[str, Any] | None = None
    watchdog: dict[str, Any] | None = None
    permissives: dict[str, Any] | None = None
    health: dict[str, Any] | None = None
    simulation: dict[str, Any] | None = None  # for `breakaway simulate` alone: a service has no use for it


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


@dataclass(frozen=True, slots=True)
class ServiceSettings:
    """The service's own settings. ``bind`` is an address; port 0 means any free one.

    ``gateway`` is this service's name among several, "" where it is the only one.
    """

    store: Path
    bind: str
    port: int
    database: DatabaseAddress | None = None
    gateway: str = ""
    retention: Retention | None = None
    access: AccessSettings = field(default_factory=AccessSettings)


@dataclass(frozen=True, slots=True)
class PlantValve:
    """One valve: what it is and how it is wired."""

    nameplate: Nameplate
    wiring: ValveWiring
    health: HealthLimits = field(default_factory=HealthLimits)

    @property
    def buses(self) -> frozenset[str]:
        """Names of the buses that a test of this valve needs."""
        points = (self.wiring.command, self.wiring.position, self.wiring.pressure, *self.wiring.permissives.points)
        return frozenset(point.bus for point in points if point is not None)


@dataclass(frozen=True, slots=True)
class Plant:
    """Everything that plant.toml says."""

    file: Path
    service: ServiceSettings
    buses: Mapping[str, BusAddress]
    valves: Mapping[str, PlantValve]
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    schedules: tuple[Schedule, ...] = ()
    gateways: Mapping[str, str] = field(default_factory=dict)
    bus_gateways: Mapping[str, str] = field(default_factory=dict)
    mqtt: MqttSettings | None = None

    def gateway_of(self, tag: str) -> str:
        """Return the name of the gateway that drives a valve; "" in a plant of one gateway."""
        return self.bus_gateways.get(self.valves[tag].wiring.command.bus, "")

    def is_ours(self, tag: str) -> bool:
        """Whether this service drives the valve."""
        return self.gateway_of(tag) == self.service.gateway


def load_plant(path: Path) -> Plant:
    """Read a plant file. Raises ConfigurationError that names file, key, value, reason and remedy, one line a fault."""
    findings = Findings(path.name)
    top = findings.model(PlantSection, read_toml(path), ())
    if top is None:
        raise findings.error()
    name_gateway(top.service)
    service = _service(findings, top.service, path.parent)
    own = top.service.get("gateway")
    urls = gateways(findings, top.gateways, own if isinstance(own, str) else None)
    buses, bus_gateways = _buses(findings, top.buses, urls)
    valves = _valves(findings, top.valves)
    health = health_limits(findings, top.valves)
    tags = {nameplate.tag for nameplate, _ in valves}
    groups, checks = _nightly(findings, top, tags)
    broker = mqtt_settings(findings, top.mqtt, path.parent)
    if not findings:  # cross-checks on half a plant would only repeat what is said already
        check_wiring(findings, buses, valves, bus_gateways)
        check_schedules(findings, checks, valves, None if service is None else service.access.approved_sequences)
    if findings or service is None:
        raise findings.error()
    return Plant(
        path,
        service,
        {address.name: address for address in buses},
        {nameplate.tag: PlantValve(nameplate, wiring, health[nameplate.tag]) for nameplate, wiring in valves},
        groups,
        checks,
        urls,
        bus_gateways,
        broker,
    )


def _nightly(
    findings: Findings, top: PlantSection, tags: set[str]
) -> tuple[dict[str, tuple[str, ...]], tuple[Schedule, ...]]:
    if len(findings):  # a valve with a fault of its own would be missed here too
        return {}, ()
    groups = groups_by_name(findings, top.groups, tags)
    return groups, schedules(findings, top.schedules, groups, tags)


def _service(findings: Findings, raw: dict[str, Any], folder: Path) -> ServiceSettings | None:
    section = findings.model(ServiceSection, raw, ("service",))
    if section is None:
        return None
    try:
        loopback = ipaddress.ip_address(section.bind).is_loopback
    except ValueError:
        findings.add(("service", "bind"), section.bind, "it is no IP address", "give one such as 127.0.0.1")
        return None
    access = access_settings(findings, section, bind=section.bind, loopback=loopback, folder=folder)
    if access is None:
        return None
    return ServiceSettings(
        (folder / section.store).resolve(),
        section.bind,
        section.port,
        database_address(findings, section.database, section.database_password_file, folder),
        section.gateway or "",
        None if section.retention is None else Retention(**section.retention.model_dump()),
        access,
    )


def _buses(
    findings: Findings, sections: list[dict[str, Any]], known: Mapping[str, str]
) -> tuple[list[BusAddress], dict[str, str]]:
    """Return the buses, and by the name of each whose it is."""
    buses: list[BusAddress] = []
    owners: dict[str, str] = {}
    for index, raw in enumerate(sections):
        key = ("buses", index)
        kind = raw.get("kind")
        if not isinstance(kind, str) or kind not in _BUS_KINDS:
            findings.add((*key, "kind"), kind, "it is no kind of bus", f"choose one of {', '.join(_BUS_KINDS)}")
            continue
        gateway = gateway_of_bus(findings, key, raw.get("gateway"), known)
        address = findings.part(_BUS_KINDS[kind], {name: raw[name] for name in raw if name != "gateway"}, key)
        if address is not None:
            buses.append(address)
            owners.setdefault(address.name, gateway)
    return buses, owners


def _valves(findings: Findings, sections: list[dict[str, Any]]) -> list[tuple[Nameplate, ValveWiring]]:
    valves: list[tuple[Nameplate, ValveWiring]] = []
    for index, raw in enumerate(sections):
        section = findings.model(ValveSection, raw, ("valves", index))
        valve = None if section is None else _valve(findings, section, ("valves", index))
        if valve is not None:
            valves.append(valve)
    return valves


def _valve(
    findings: Findings, section: ValveSection, key: tuple[str | int, ...]
) -> tuple[Nameplate, ValveWiring] | None:
    before = len(findings)
    findings.part(Actuator, section.actuator, (*key, "actuator"))
    findings.optional(Signal, section.signal, (*key, "signal"))
    limits = findings.part(MotionLimits, section.limits, (*key, "limits"))
    command = findings.part(Point, section.command, (*key, "command"))
    position = findings.optional(Point, section.position, (*key, "position"))
    pressure = findings.optional(Point, section.pressure, (*key, "pressure"))
    sampling = findings.part(Sampling, section.acquisition, (*key, "acquisition"))
    watchdog = findings.optional(WatchdogChoice, section.watchdog, (*key, "watchdog"))
    permissives = findings.part(PermissiveRules, section.permissives or {}, (*key, "permissives"))
    if len(findings) > before or limits is None or command is None or sampling is None or permissives is None:
        return None
    plate = {"tag": section.tag, "actuator": section.actuator}
    try:
        nameplate = nameplate_from_mapping(
            plate if section.signal is None else {**plate, "signal": section.signal}, section.tag
        )
        return nameplate, ValveWiring(
            section.tag,
            command,
            section.safe_value_pa,
            limits,
            sampling,
            position,
            pressure,
            WatchdogChoice(timeout_s=2.0) if watchdog is None else watchdog,
            stem_rules_of(permissives, nameplate),
        )
    except ValveError as error:
        findings.add_error(key, error)
        return None


__all__ = ["ConfigurationError", "Plant", "PlantValve", "ServiceSettings", "load_plant"]
