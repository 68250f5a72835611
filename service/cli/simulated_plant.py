"""From plant.toml to a simulated plant: every valve behind the buses and registers that the service is told of."""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from drivers.addresses import BusAddress, GaugeAddress, Point, RtuAddress, TcpAddress, ValveWiring
from drivers.capabilities import Role
from drivers.maps import reference, register_map
from drivers.register_map import RegisterMap
from drivers.registers import Register
from service.cli.hidden_effects import check_effect, hidden_effect
from service.cli.simulated_instruments import (
    INSTRUMENTS,
    HuntingSection,
    PackingSection,
    PositionSection,
    PressureSection,
    hunting_from,
    packing_from,
    position_from,
    pressure_from,
)
from service.config.errors import Fault, Findings, Key, read_toml
from service.config.plant import Plant, PlantValve
from simulator.assembly import SimulatedChannel, SimulatedPlant, SimulatedUnit, warm_up_for
from simulator.clock import RunningClock
from simulator.gauge import GaugeListener
from simulator.listeners import Listener, RtuListener, TcpListener
from simulator.simulated_valve import SimulatedValve
from simulator.transducer import Transducer
from simulator.unit import Quantity
from valve.effects import Effect, ValveScale
from valve.errors import ConfigurationError, ValveError, refuse
from valve.messages import message_of, say
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops, ValveParameters, parameters_from_symbols

# A sensor is chosen a little wider than what it measures.
_MARGIN: Final = 0.05


@dataclass(frozen=True, slots=True)
class ServerCertificate:
    """What a simulated TLS device shows: its certificate and key."""

    certificate_file: Path
    key_file: Path


class SimulationSection(BaseModel):
    """``[valves.simulation]``: the truth about a simulated valve, by a published set or by the paper's symbols."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
    parameter_set: str | None = None
    parameters: dict[str, float] | None = None
    position_noise_m: float | None = None
    pressure_noise_pa: float | None = None
    seed: int | None = None  # by default one that the tag gives
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    supply_pa: float = 140.0e3
    dac_bits: int = 16
    dead_band_pa: float = 0.0
    hysteresis_pa: float = 0.0
    adc_bits: int | None = None
    travel_stops_m: tuple[float, float] | None = None
    packing: PackingSection | None = None
    position_sensor: PositionSection | None = None
    pressure_sensor: PressureSection | None = None
    hunting: HuntingSection | None = None
    effects: tuple[dict[str, str | float], ...] = ()


def plant_from_settings(
    settings: Plant, speed: float = 1.0, certificate: ServerCertificate | None = None
) -> SimulatedPlant:
    """Build the plant that ``settings`` describe; its clock runs ``speed`` times faster and starts now.

    Raises ConfigurationError where the file does not say enough to simulate it.
    """
    sections, faults = _simulation_sections(settings.file, required=True)
    refuse(ConfigurationError, map(str, faults))
    valves = [_valve(valve, sections[tag]) for tag, valve in settings.valves.items()]
    units: dict[str, dict[int, list[tuple[str, SimulatedChannel]]]] = defaultdict(lambda: defaultdict(list))
    gauges: dict[GaugeListener, str] = {}
    for tag, valve in settings.valves.items():
        for point, channel in _channels(tag, valve.wiring):
            units[point.bus][point.device_id or 0].append((point.map or "", channel))
        position = valve.wiring.position
        address = None if position is None else settings.buses[position.bus]
        if isinstance(address, GaugeAddress):
            listener = GaugeListener(
                Path(address.serial_port), address.request, address.pattern, address.terminator, address.unit
            )
            if listener in gauges:
                raise ConfigurationError(
                    say(
                        "gauge_shared",
                        "bus {bus}: {other} and {tag} share a gauge, give each one",
                        bus=address.name,
                        other=gauges[listener],
                        tag=tag,
                    )
                )
            gauges[listener] = tag
    listeners: dict[Listener, list[SimulatedUnit]] = {}
    for bus, on_bus in units.items():
        served_on = _listener(settings.buses[bus], certificate)
        if served_on in listeners:
            raise ConfigurationError(
                say("bus_address_twice", "bus {bus}: another bus has its address, name one bus for both", bus=bus)
            )
        listeners[served_on] = [_unit(bus, device_id, of, settings.maps) for device_id, of in on_bus.items()]
    # before the clock: what is compiled must not take simulated time
    warm_up_for(valves)
    return SimulatedPlant(valves, listeners, RunningClock(speed), gauges)


def simulation_faults(file: Path) -> tuple[Fault, ...]:
    """Return what is wrong with the ``[valves.simulation]`` that a plant file has; one that has none needs none."""
    return _simulation_sections(file, required=False)[1]


def _simulation_sections(file: Path, *, required: bool) -> tuple[dict[str, SimulationSection], tuple[Fault, ...]]:
    """Every valve's ``[valves.simulation]``, by tag, with their faults; nothing of the rest of the file is judged."""
    findings = Findings(file.name)
    sections: dict[str, SimulationSection] = {}
    valves = read_toml(file).get("valves")
    for index, raw in enumerate(valves if isinstance(valves, list) else []):
        key = ("valves", index, "simulation")
        simulation: dict[str, Any] | None = raw.get("simulation") if isinstance(raw, dict) else None
        section = _section(simulation, key, findings) if isinstance(simulation, dict) else None
        if simulation is None and required:
            findings.add(
                key,
                None,
                say("valve_not_simulated", "a valve without it cannot be simulated"),
                say("add_parameter_set", 'add it with parameter_set = "nominal"'),
            )
        elif section is not None:
            if (section.parameter_set is None) == (section.parameters is None):
                findings.add(
                    key,
                    simulation,
                    say("parameters_given_twice", "its parameters are given twice or not at all"),
                    say("give_one_of_two", "give one of the two"),
                )
            for place, given in enumerate(section.effects):
                check_effect(given, (*key, "effects", place), findings)
            sections[str(raw.get("tag"))] = section
    return sections, findings.faults


def _section(raw: dict[str, Any], key: Key, findings: Findings) -> SimulationSection | None:
    """Return one section; its tables are looked at one by one, so that a wrong key is compared with their own."""
    section = findings.model(SimulationSection, {name: raw[name] for name in raw if name not in INSTRUMENTS}, key)
    tables: dict[str, Any] = {}
    for name, kind in INSTRUMENTS.items():
        if name not in raw:
            continue
        if not isinstance(raw[name], dict):
            findings.add(
                (*key, name),
                raw[name],
                say("no_table", "it is no table"),
                say("give_preset_table", 'give a table such as {{ preset = "usual" }}'),
            )
            continue
        tables[name] = findings.model(kind, raw[name], (*key, name))
    try:
        packing_from(tables.get("packing"))
    except ValveError as error:
        findings.add_error((*key, "packing"), error)
    return None if section is None else section.model_copy(update=tables)


def _wider(span: tuple[float, float]) -> tuple[float, float]:
    margin = _MARGIN * (span[1] - span[0])
    return span[0] - margin, span[1] + margin


def _parameters(section: SimulationSection) -> ValveParameters:
    if section.parameters is not None:
        return parameters_from_symbols(section.parameters)
    assert section.parameter_set is not None  # one of the two was asked for
    return parameter_set(section.parameter_set).parameters


def _valve(valve: PlantValve, section: SimulationSection) -> SimulatedValve:
    nameplate: Nameplate = valve.nameplate
    signal, stops = nameplate.signal, section.travel_stops_m
    range_pa = valve.wiring.limits.pressure_pa if signal is None else signal.range_pa
    seed = zlib.crc32(nameplate.tag.encode()) if section.seed is None else section.seed
    travel_m = nameplate.actuator.travel_m
    try:
        parameters = _parameters(section)
        full_force_n = (nameplate.actuator.diaphragm_area_m2 or 0.0) * range_pa[1]
        effects: tuple[Effect, ...] = ()
        if section.effects and full_force_n > 0.0:
            scale = ValveScale.of(parameters, travel_m, full_force_n)
            effects = tuple(hidden_effect(given, scale) for given in section.effects)
        return SimulatedValve(
            nameplate.tag,
            parameters,
            nameplate,
            Transducer(
                range_pa,
                section.lag_s,
                section.dead_time_s,
                section.supply_pa,
                section.dac_bits,
                hunting=hunting_from(section.hunting, section.packing, range_pa, seed),
                dead_band_pa=section.dead_band_pa,
                hysteresis_pa=section.hysteresis_pa,
            ),
            position_from(
                section.position_sensor,
                section.packing,
                span_m=_wider((0.0, travel_m)),
                travel_m=travel_m,
                noise_rms=section.position_noise_m,
                adc_bits=section.adc_bits,
                seed=2 * seed,
            ),
            pressure_from(
                section.pressure_sensor,
                section.packing,
                span_pa=_wider(range_pa),
                range_pa=range_pa,
                noise_rms=section.pressure_noise_pa,
                adc_bits=section.adc_bits,
                seed=2 * seed + 1,
            ),
            TravelStops() if stops is None else TravelStops(*stops),
            effects=effects,
            packing=packing_from(section.packing),
            packing_seed=seed,
        )
    except ValveError as error:
        raise ConfigurationError(
            say("simulation_refused", "{tag}: [valves.simulation]: {why}", tag=nameplate.tag, why=message_of(error))
        ) from error


def _channels(tag: str, wiring: ValveWiring) -> list[tuple[Point, SimulatedChannel]]:
    """Every register that shows or moves one valve, with its place."""
    command = wiring.command
    assert command.map is not None  # checked with the rest of the file
    device = register_map(command.map, wiring.maps)
    name = _register_name(tag, command, Role.COMMAND, wiring.maps)
    channels = [(command, _channel(tag, Quantity.COMMAND, command, device.register(name)))]
    readback = command.readback_register or device.readbacks.get(name)
    if readback is not None and command.map != reference.MAP.name:
        channels.append((command, _channel(tag, Quantity.OUTPUT, command, device.register(readback))))
    own = Point(command.bus, command.device_id, command.map)
    for role, given in ((Role.POSITION, wiring.position), (Role.PRESSURE, wiring.pressure)):
        if given is None and role is Role.PRESSURE and device.own_pressure is None:
            continue
        point = own if given is None else given
        if point.map is None:
            continue  # a gauge
        register = register_map(point.map, wiring.maps).register(_register_name(tag, point, role, wiring.maps))
        channels.append((point, _channel(tag, Quantity(role), point, register)))
    return channels


def _register_name(tag: str, point: Point, role: Role, maps: Mapping[str, RegisterMap]) -> str:
    assert point.map is not None  # checked with the rest of the file
    name = point.register or register_map(point.map, maps).roles.get(role)
    if name is None:
        raise ConfigurationError(
            say(
                "role_not_in_map",
                "{tag}: map {map} has no {role} of its own, name the register",
                tag=tag,
                map=point.map,
                role=role,
            )
        )
    return name


def _channel(tag: str, quantity: Quantity, point: Point, register: Register) -> SimulatedChannel:
    si_unit = "m" if quantity is Quantity.POSITION else "Pa"
    if point.signal is not None and point.quantity is not None:
        register = register.spanning(point.signal, point.quantity, si_unit)
    if register.unit != si_unit:
        raise ConfigurationError(
            say(
                "quantity_of_other_unit",
                "{tag}: the {quantity} stands in {register} in {unit}, not in {si_unit}: say by signal and quantity "
                "what it means",
                tag=tag,
                quantity=quantity,
                register=register.name,
                unit=register.unit,
                si_unit=si_unit,
            )
        )
    return SimulatedChannel(tag, quantity, register)


def _unit(
    bus: str, device_id: int, channels: list[tuple[str, SimulatedChannel]], own: Mapping[str, RegisterMap]
) -> SimulatedUnit:
    maps = {name for name, _ in channels}
    if len(maps) > 1:
        raise ConfigurationError(
            say(
                "device_of_two_maps",
                "bus {bus}: device {device_id} has the maps {maps: and }, a device has one: correct it",
                bus=bus,
                device_id=device_id,
                maps=tuple(sorted(maps)),
            )
        )
    return SimulatedUnit(device_id, register_map(maps.pop(), own), tuple(channel for _, channel in channels))


def _listener(address: BusAddress, certificate: ServerCertificate | None) -> Listener:
    if isinstance(address, TcpAddress):
        return TcpListener(address.host, address.port)
    if isinstance(address, RtuAddress):
        return RtuListener(Path(address.serial_port))
    assert not isinstance(address, GaugeAddress)  # its points have no map
    if certificate is None:
        raise ConfigurationError(
            say(
                "simulated_tls",
                "bus {bus}: a simulated TLS device needs a certificate, give --tls-certificate and --tls-key",
                bus=address.name,
            )
        )
    client_ca = Path(address.ca_file) if address.certificate_file is not None else None
    return TcpListener(address.host, address.port, certificate.certificate_file, certificate.key_file, client_ca)
