"""What plant.toml says, as the rest of the service has it. ``settings`` reads the file into it."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final
from zoneinfo import ZoneInfo

from drivers.addresses import BusAddress, ValveWiring
from drivers.motion.local_socket import NAME
from drivers.register_map import RegisterMap
from service.config.secret_file import read_secret
from service.model.health_limits import HealthLimits
from service.model.schedule import Schedule
from valve.nameplate import Nameplate

if TYPE_CHECKING:
    from sqlalchemy import URL

PASSWORD_VARIABLE: Final = "BREAKAWAY_DATABASE_PASSWORD"


@dataclass(frozen=True, slots=True)
class DatabaseAddress:
    """A PostgreSQL database, without its password, and the file that holds it, if any."""

    url: str
    password_file: Path | None = None

    def with_password(self, environment: Mapping[str, str] = os.environ) -> URL:
        """Return the address with its password: of the file, else of the environment, else without one.

        Raises ConfigurationError where the file cannot be read or others may read it; no message holds the password.
        """
        from sqlalchemy import make_url

        url = make_url(self.url)
        if "client_encoding" not in url.query:  # a server whose own is SQL_ASCII would answer in bytes
            url = url.update_query_dict({"client_encoding": "utf8"})
        if self.password_file is None:
            password = environment.get(PASSWORD_VARIABLE)
        else:
            password = read_secret(self.password_file, "service.database_password_file")
        return url.set(password=password) if password else url


@dataclass(frozen=True, slots=True)
class Retention:
    """How long recordings are kept; results stay for ever."""

    recordings_days: int
    keep_baselines: bool
    keep_last: int


@dataclass(frozen=True, slots=True)
class AccessSettings:
    """``sign_in`` False: every caller is ``local`` and may do all but administer.

    ``approved_sequences`` are those that operators and schedules may run, None where all of them are;
    ``allowed_hosts`` are the names that the service answers to beside the loopback's.
    """

    sign_in: bool = False
    loopback: bool = True
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    behind_proxy: bool = False
    proxy_addresses: tuple[str, ...] = ()
    approved_sequences: frozenset[str] | None = None
    allowed_hosts: tuple[str, ...] = ()

    @property
    def encrypted(self) -> bool:
        """Whether browsers see https, so that a cookie may be for https alone."""
        return self.tls_certificate is not None or self.behind_proxy


@dataclass(frozen=True, slots=True)
class ServiceSettings:
    """The service's own settings. ``bind`` is an address; port 0 means any free one.

    ``gateway`` is this service's name among several, "" where it is the only one; ``zone`` is None where none is named;
    ``plant`` is what reports call the plant.
    """

    store: Path
    bind: str
    port: int
    database: DatabaseAddress | None = None
    gateway: str = ""
    retention: Retention | None = None
    access: AccessSettings = field(default_factory=AccessSettings)
    zone: ZoneInfo | None = None
    plant: str = ""

    @property
    def motion_socket(self) -> Path:
        """Where the process that moves valves answers, on this machine alone."""
        return self.store / NAME


@dataclass(frozen=True, slots=True)
class Identity:
    """What people know a valve by beside its tag; None where the plant file does not say it."""

    description: str | None = None
    area: str | None = None
    service: str | None = None
    manufacturer: str | None = None
    model: str | None = None
    serial_number: str | None = None


@dataclass(frozen=True, slots=True)
class PlantValve:
    """One valve: what it is, how it is wired, what is asked of it and what people know it by.

    ``limits_class`` is the class that its limits come from, "" without one.
    """

    nameplate: Nameplate
    wiring: ValveWiring
    health: HealthLimits = field(default_factory=HealthLimits)
    identity: Identity = field(default_factory=Identity)
    limits_class: str = ""

    @property
    def buses(self) -> frozenset[str]:
        """Names of the buses that a test of this valve needs."""
        return self.wiring.buses


@dataclass(frozen=True, slots=True)
class MqttSettings:
    """A broker and how to sign in to it; the password is read from its file when it is needed."""

    host: str
    port: int
    prefix: str
    username: str | None = None
    password_file: Path | None = None
    tls: bool = False
    ca_file: Path | None = None

    def password(self) -> str | None:
        """Return the password. Raises ConfigurationError; no message holds it."""
        return None if self.password_file is None else read_secret(self.password_file, "mqtt.password_file")

    def tls_context(self) -> ssl.SSLContext | None:
        """Return how the broker is proven: by ``ca_file``, else by the certificates that this machine trusts."""
        return ssl.create_default_context(cafile=self.ca_file) if self.tls else None


@dataclass(slots=True)
class Plant:
    """Everything that plant.toml says. A reload alone changes it, on the event loop (``service.reload``)."""

    file: Path
    service: ServiceSettings
    buses: dict[str, BusAddress]
    valves: Mapping[str, PlantValve]
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    schedules: tuple[Schedule, ...] = ()
    gateways: Mapping[str, str] = field(default_factory=dict)
    bus_gateways: Mapping[str, str] = field(default_factory=dict)
    mqtt: MqttSettings | None = None
    maps: Mapping[str, RegisterMap] = field(default_factory=dict)

    @property
    def zone(self) -> ZoneInfo | None:
        """The plant's time zone: ``service.zone``, else the one of all schedules; None for this machine's own."""
        return zone_of(self.service, self.schedules)

    def take_over(self, fresh: Plant, kept: Mapping[str, PlantValve]) -> None:
        """Become what a fresh file says of valves, groups, schedules, zone and approved sequences.

        ``kept`` valves stay as they are. Buses are added, and none is changed: the caller sees to that.
        """
        self.buses.update({name: address for name, address in fresh.buses.items() if name not in self.buses})
        self.bus_gateways = {**self.bus_gateways, **fresh.bus_gateways}
        self.valves = {**fresh.valves, **kept}
        self.groups = fresh.groups
        self.schedules = fresh.schedules if self.schedules else ()
        approved = fresh.service.access.approved_sequences
        access = replace(self.service.access, approved_sequences=approved)
        self.service = replace(self.service, zone=fresh.service.zone, access=access)

    def set_valve(self, tag: str, valve: PlantValve | None) -> None:
        """Give one valve another configuration, or take it out of the plant."""
        valves = dict(self.valves)
        if valve is None:
            valves.pop(tag, None)
        else:
            valves[tag] = valve
        self.valves = valves

    def gateway_of(self, tag: str) -> str:
        """Return the name of the gateway that drives a valve; "" in a plant of one gateway."""
        return self.bus_gateways.get(self.valves[tag].wiring.command.bus, "")

    def is_ours(self, tag: str) -> bool:
        """Whether this service drives the valve."""
        return self.gateway_of(tag) == self.service.gateway


def zone_of(service: ServiceSettings, schedules: Iterable[Schedule]) -> ZoneInfo | None:
    """Return ``service.zone``, else the zone of all schedules; None for this machine's own."""
    of_schedules = {schedule.zone.key: schedule.zone for schedule in schedules}
    return service.zone or (next(iter(of_schedules.values())) if len(of_schedules) == 1 else None)
