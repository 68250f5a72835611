"""Where things are on the wire: buses, the points on them, and how one valve is wired. Data only, no connection."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal, TypeAlias

from drivers.permissive_rules import PermissiveRules
from drivers.points import Point as Point  # noqa: PLC0414  - an address too, and asked for here
from drivers.register_map import RegisterMap
from drivers.stands_at import RestRules
from drivers.watch_rules import WatchRules
from valve.errors import ConfigurationError, refuse
from valve.messages import message_of, say
from valve.units import SI_FACTORS


def _timeout_of(bus: str) -> str:
    return say("timeout_of_bus", "bus {bus}: {key}", bus=bus, key="timeout_s")


def _not_positive(key: str, value: float, unit: str) -> str:
    if math.isfinite(value) and value > 0.0:
        return ""
    return say(
        "number_not_positive",
        "{key} is {value:g} {unit}, it must be above 0: correct it",
        key=key,
        value=value,
        unit=unit,
    )


def _no_port(bus: str, port: int) -> str:
    if 1 <= port <= 65535:
        return ""
    return say("port_outside", "bus {bus}: port {port} is outside 1 to 65535, correct it", bus=bus, port=port)


def _network_device_id_fault(device_id: int) -> str:
    # 248 to 254 are reserved; 0 and 255 are the device at the address itself (Messaging on TCP/IP 1.0b, 4.4.1.2).
    if 0 <= device_id <= 247 or device_id == 255:
        return ""
    return say(
        "network_device_id_outside",
        "device_id {device_id} is none of 0 to 247 and 255, which a network address has: correct it",
        device_id=device_id,
    )


def _no_baud_rate(bus: str, baud_rate: int) -> str:
    if 300 <= baud_rate <= 4_000_000:
        return ""
    return say(
        "baud_rate_outside",
        "bus {bus}: baud_rate {baud_rate} is outside 300 to 4000000, correct it",
        bus=bus,
        baud_rate=baud_rate,
    )


class Parity(StrEnum):
    """Parity of a serial line."""

    NONE = "N"
    EVEN = "E"
    ODD = "O"


@dataclass(frozen=True, slots=True)
class TcpAddress:
    """A Modbus TCP server. ``timeout_s`` is the deadline of one transaction."""

    name: str
    host: str
    port: int = 502
    timeout_s: float = 0.5
    kind: Literal["modbus_tcp"] = "modbus_tcp"

    def device_id_fault(self, device_id: int) -> str:
        """Return why there can be no such device at this address; "" where there can."""
        return _network_device_id_fault(device_id)

    def __post_init__(self) -> None:
        faults = _no_port(self.name, self.port), _not_positive(_timeout_of(self.name), self.timeout_s, "s")
        refuse(ConfigurationError, faults)


@dataclass(frozen=True, slots=True)
class TlsAddress:
    """A Modbus/TCP Security server (port 802): both sides show a certificate.

    ``ca_file`` signs the server's certificate, which must be made out to ``server_name`` (the host where empty);
    ``certificate_file`` and ``key_file`` are ours, where the server asks for one.
    """

    name: str
    host: str
    ca_file: str
    port: int = 802
    certificate_file: str | None = None
    key_file: str | None = None
    server_name: str | None = None
    timeout_s: float = 0.5
    kind: Literal["modbus_tls"] = "modbus_tls"

    def device_id_fault(self, device_id: int) -> str:
        """Return why there can be no such device at this address; "" where there can."""
        return _network_device_id_fault(device_id)

    def __post_init__(self) -> None:
        faults = [_no_port(self.name, self.port), _not_positive(_timeout_of(self.name), self.timeout_s, "s")]
        if (self.certificate_file is None) != (self.key_file is None):
            faults.append(
                say(
                    "certificate_without_key",
                    "bus {bus}: certificate_file and key_file belong together, give both",
                    bus=self.name,
                )
            )
        refuse(ConfigurationError, faults)


@dataclass(frozen=True, slots=True)
class RtuAddress:
    """A serial line with Modbus RTU slaves.

    ``timeout_s`` is what a slave may take; the time of the frames on the line comes on top. ``worst_latency_s`` is
    the latest moment after a request at which its answer may still arrive: after a timeout the line is left to
    itself until then. ``echo``: the adapter returns every byte that it sends, before the answer (two-wire RS-485).
    """

    name: str
    serial_port: str
    baud_rate: int = 19200
    parity: Parity = Parity.EVEN
    stop_bits: Literal[1, 2] = 1
    timeout_s: float = 0.5
    worst_latency_s: float = 1.0
    echo: bool = False
    kind: Literal["modbus_rtu"] = "modbus_rtu"

    def device_id_fault(self, device_id: int) -> str:
        """Return why there can be no such device on this line; "" where there can."""
        # 0 is a broadcast: every device on the line obeys and none answers.
        if 1 <= device_id <= 247:
            return ""
        return say(
            "serial_device_id_outside",
            "device_id {device_id} is outside 1 to 247, which a serial line has: correct it",
            device_id=device_id,
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "parity", Parity(self.parity))
        faults = [_no_baud_rate(self.name, self.baud_rate)]
        faults.append(_not_positive(_timeout_of(self.name), self.timeout_s, "s"))
        faults.append(
            _not_positive(
                say("latency_of_bus", "bus {bus}: {key}", bus=self.name, key="worst_latency_s"),
                self.worst_latency_s,
                "s",
            )
        )
        refuse(ConfigurationError, faults)


@dataclass(frozen=True, slots=True)
class GaugeAddress:
    """A displacement gauge on a serial line that answers an ASCII request.

    ``pattern`` is a regular expression with a group ``value``; ``unit`` is what the number counts.
    """

    name: str
    serial_port: str
    request: str
    pattern: str
    terminator: str = "\r\n"
    unit: str = "mm"
    baud_rate: int = 9600
    parity: Parity = Parity.NONE
    stop_bits: Literal[1, 2] = 1
    timeout_s: float = 0.5
    kind: Literal["serial_gauge"] = "serial_gauge"

    def __post_init__(self) -> None:
        object.__setattr__(self, "parity", Parity(self.parity))
        faults = [_no_baud_rate(self.name, self.baud_rate)]
        faults.append(_not_positive(_timeout_of(self.name), self.timeout_s, "s"))
        if not self.terminator:
            faults.append(
                say(
                    "gauge_terminator_empty",
                    'bus {bus}: terminator is empty, give the end of an answer such as "\\r\\n"',
                    bus=self.name,
                )
            )
        if not self.request.isascii() or not self.terminator.isascii():
            faults.append(
                say(
                    "gauge_text_not_ascii",
                    "bus {bus}: request and terminator go over the line as ASCII, remove other characters",
                    bus=self.name,
                )
            )
        faults.append(self._pattern_fault)
        if SI_FACTORS.get(self.unit, ("", 0.0))[0] != "m":
            faults.append(
                say(
                    "gauge_unit_unknown",
                    "bus {bus}: unit {unit} is no length, give m, mm, um or inch",
                    bus=self.name,
                    unit=repr(self.unit),
                )
            )
        refuse(ConfigurationError, faults)

    @property
    def _pattern_fault(self) -> str:
        try:
            pattern = re.compile(self.pattern)
        except re.error as error:
            return say(
                "gauge_pattern_bad",
                "bus {bus}: pattern {pattern} is no regular expression ({why}), correct it",
                bus=self.name,
                pattern=repr(self.pattern),
                why=message_of(error),
            )
        if "value" in pattern.groupindex:
            return ""
        return say(
            "gauge_pattern_without_group",
            "bus {bus}: pattern has no group (?P<value>...), put it round the number",
            bus=self.name,
        )


BusAddress: TypeAlias = TcpAddress | TlsAddress | RtuAddress | GaugeAddress


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """What a test may do to a valve: pressures (Pa), their rate (Pa/s), its length (s), and where the stem may be.

    A waveform that is steeper than the rate is refused, steps included unless ``steps_allowed``. ``band_m``: how far
    the stem may leave where it stood before the test. ``breakaway_pa``: the change of pressure within which a healthy
    stem moves; by default 0.95 of the limits' span, which even a stem with 90 % of dead band does.
    ``end_out_of_family``: a polled test ends, by its usual ramp, at a breakaway that takes twice the last one's force.
    """

    pressure_pa: tuple[float, float]
    pressure_rate_pa_per_s: float
    longest_test_s: float
    steps_allowed: bool = False
    position_m: tuple[float, float] | None = None
    band_m: float | None = None
    breakaway_pa: float | None = None
    end_out_of_family: bool = False

    def __post_init__(self) -> None:
        faults = [
            _not_positive("limits.pressure_rate_pa_per_s", self.pressure_rate_pa_per_s, "Pa/s"),
            _not_positive("limits.longest_test_s", self.longest_test_s, "s"),
            "" if self.band_m is None else _not_positive("limits.band_m", self.band_m, "m"),
            "" if self.breakaway_pa is None else _not_positive("limits.breakaway_pa", self.breakaway_pa, "Pa"),
        ]
        if not self.pressure_pa[0] < self.pressure_pa[1]:
            faults.append(
                say(
                    "pressure_limits_do_not_rise",
                    "{key} is {low:g in Pa} to {high:g Pa}, it must rise: correct it",
                    key="limits.pressure_pa",
                    low=self.pressure_pa[0],
                    high=self.pressure_pa[1],
                )
            )
        if self.position_m is not None and not self.position_m[0] < self.position_m[1]:
            faults.append(
                say(
                    "position_limits_do_not_rise",
                    "{key} must rise: give the lower position first",
                    key="limits.position_m",
                )
            )
        refuse(ConfigurationError, faults)


class Mode(StrEnum):
    """How the samples of a test are taken."""

    POLLED = "polled"
    CAPTURED = "captured"


@dataclass(frozen=True, slots=True)
class Sampling:
    """``[valves.acquisition]``: how the samples are taken, and how far apart (s)."""

    mode: Mode
    period_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "mode", Mode(self.mode))
        refuse(ConfigurationError, [_not_positive("acquisition.period_s", self.period_s, "s")])


@dataclass(frozen=True, slots=True)
class WatchdogChoice:
    """``[valves.watchdog]``: the device's watchdog and its timeout (s), or why there is none."""

    timeout_s: float | None = None
    waived: str = ""

    def __post_init__(self) -> None:
        faults = ["" if self.timeout_s is None else _not_positive("watchdog.timeout_s", self.timeout_s, "s")]
        if (self.timeout_s is None) == (self.waived == ""):
            faults.append(
                say(
                    "watchdog_and_waiver",
                    "watchdog: give either {key} or, for a device that has none, waived = a reason",
                    key="timeout_s",
                )
            )
        refuse(ConfigurationError, faults)


@dataclass(frozen=True, slots=True)
class ValveWiring:
    """How one valve is wired. ``safe_value_pa`` is a pressure, or "entry": what was commanded before the test.

    ``maps`` are the register maps that its plant file describes, by name, beside those of ``drivers.maps``; ``watch``
    says how it is read in service, None where it is not.
    """

    tag: str
    command: Point
    safe_value_pa: float | Literal["entry"]
    limits: MotionLimits
    acquisition: Sampling
    position: Point | None = None
    pressure: Point | None = None
    watchdog: WatchdogChoice = field(default_factory=lambda: WatchdogChoice(timeout_s=2.0))
    permissives: PermissiveRules = field(default_factory=PermissiveRules)
    rest: RestRules = field(default_factory=RestRules)
    maps: Mapping[str, RegisterMap] = field(default_factory=dict, hash=False)
    watch: WatchRules | None = None

    def __post_init__(self) -> None:
        refuse(ConfigurationError, [safe_value_fault(self.tag, self.safe_value_pa, self.limits)])

    @property
    def buses(self) -> frozenset[str]:
        """Names of the buses that a test of this valve needs."""
        points = (self.command, self.position, self.pressure, *self.permissives.points)
        return frozenset(point.bus for point in points if point is not None)


def safe_value_fault(tag: str, safe_value_pa: float | Literal["entry"], limits: MotionLimits) -> str:
    """Return why a safe value does not fit the limits; "" where it does."""
    low_pa, high_pa = limits.pressure_pa
    if safe_value_pa == "entry" or low_pa <= safe_value_pa <= high_pa:
        return ""
    return say(
        "safe_value_outside_limits",
        "{tag}: {key} {value:g Pa} is outside {limits} {low:g in Pa} to {high:g Pa}, correct one of them",
        tag=tag,
        key="safe_value_pa",
        limits="limits.pressure_pa",
        value=safe_value_pa,
        low=low_pa,
        high=high_pa,
    )
