"""``breakaway check``: everything that is wrong with a plant file, and with what its devices show."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.output import STANDARD_OUTPUT, write_json
from valve.errors import ConfigurationError, EquipmentError
from valve.messages import Message, joined, say

if TYPE_CHECKING:
    from drivers.inspection import ValveSeen
    from service.config.errors import Fault
    from service.config.plant import Plant
    from service.config.plant_check import CheckedValve


def check(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    live: Annotated[
        bool, typer.Option("--live", help="Read every device too and show what it says. Nothing is written.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of lines.")] = False,
) -> None:
    """Say all faults of a plant file at once; nothing is started. Exit code 0 where there is none, 1 otherwise."""
    from service.config.settings import faults_of

    plant, faults = faults_of(config)
    if any(fault.key for fault in faults) or plant is not None:  # it is TOML
        faults += _simulation_faults(config)
    if plant is not None and plant.mqtt is not None:
        from service.mqtt.broker import client_fault

        fault = client_fault(plant)
        faults += () if fault is None else (fault,)
    document: dict[str, Any] = {
        "file": str(config),
        "right": not faults,
        "faults": [fault.to_json() for fault in faults],
    }
    if plant is None or faults:
        if as_json:
            write_json(STANDARD_OUTPUT, document)
        else:
            sys.stdout.writelines(f"{fault}\n" for fault in faults)
        number: str = faults_counted(len(faults))
        if live:
            number = say("none_read", "{number}, no device was read", number=number)
        raise ConfigurationError(
            say(
                "correct_and_check",
                "{config}: {number}: correct the file, then check it again",
                config=str(config),
                number=number,
            )
        )
    if not live:
        if as_json:
            write_json(STANDARD_OUTPUT, document)
        else:
            print(say("no_fault_in_file", "{config}: no fault: {counted}", config=str(config), counted=_counted(plant)))
        return
    import uvloop

    checked = uvloop.run(_looked(plant, silent=as_json))
    wrong = [valve.tag for valve in checked if not valve.is_right]
    document |= {"right": not wrong, "valves": [valve.to_json() for valve in checked]}
    if as_json:
        write_json(STANDARD_OUTPUT, document)
    if wrong:
        shown = joined(", ", wrong[:10])
        if len(wrong) > 10:
            shown = say("and_more", "{shown} and {n} more", shown=shown, n=len(wrong) - 10)
        raise EquipmentError(
            say(
                "valves_not_right",
                "{count} of {all} valves are not right: {shown}: do what their lines say",
                count=len(wrong),
                all=len(checked),
                shown=shown,
            )
        )
    if not as_json:
        print(
            say(
                "no_fault_and_devices",
                "{config}: no fault, and every device shows what it should: {counted}",
                config=str(config),
                counted=_counted(plant),
            )
        )


def faults_counted(number: int) -> Message:
    """Return how many faults a file has."""
    return say("one_fault", "1 fault") if number == 1 else say("faults", "{n} faults", n=number)


def _simulation_faults(config: Path) -> tuple[Fault, ...]:
    """Return what is wrong with what ``breakaway simulate`` reads; its modules are loaded where there is any."""
    from service.config.errors import read_toml

    valves = read_toml(config).get("valves")
    if not isinstance(valves, list) or not any(isinstance(one, dict) and "simulation" in one for one in valves):
        return ()
    from service.cli.simulated_plant import simulation_faults

    return simulation_faults(config)


def _counted(plant: Plant) -> str:
    counts = {"valve": len(plant.valves), "bus": len(plant.buses), "schedule": len(plant.schedules)}
    plural = {"valve": "valves", "bus": "buses", "schedule": "schedules"}
    return ", ".join(f"{count} {name if count == 1 else plural[name]}" for name, count in counts.items())


async def _looked(plant: Plant, *, silent: bool) -> list[CheckedValve]:
    from service.config.plant_check import look_at_plant

    checked = []
    async for valve in look_at_plant(plant):
        checked.append(valve)
        if not silent:
            sys.stdout.writelines(f"{line}\n" for line in _lines(valve))
            sys.stdout.flush()
    return checked


def _lines(valve: CheckedValve) -> list[str]:
    """Return what is told of a valve: who answers, what it shows, and what is not right."""
    if valve.seen is None:
        return [
            say(
                "check_at_gateway",
                "{tag}: gateway {gateway} drives it: check it there",
                tag=valve.tag,
                gateway=valve.elsewhere,
            )
        ]
    seen = valve.seen
    devices = [
        f"{one.map or ''} {one.subject}".strip() + ("" if one.number is None else f", number {one.number}")
        for one in seen.devices
        if not one.fault
    ]
    lines = [f"{valve.tag}: {'right' if valve.is_right else 'NOT RIGHT'}"]
    if devices:
        lines.append(f"  answers: {'; '.join(devices)}")
    shown = [*_measured(valve, seen), *_conditions(seen)]
    if shown:
        lines.append(f"  shows: {', '.join(shown)}")
    if seen.permissives:
        said = {True: "hold", None: "shown by nothing", False: "missing"}
        told = [
            f"{word}: {', '.join(one.name for one in seen.permissives if one.met is met)}" for met, word in said.items()
        ]
        lines.append(f"  permissives: {'; '.join(one for one in told if not one.endswith(': '))}")
    return lines + [say("not_right", "  not right: {fault}", fault=fault) for fault in seen.faults]


def _measured(valve: CheckedValve, seen: ValveSeen) -> list[str]:
    shown = []
    if seen.position_m is not None:
        shown.append(f"stem {1e3 * seen.position_m:.3f} mm ({valve.position_percent:.1f} %)")
    named = (("output", seen.output_pa), ("pressure", seen.pressure_pa), ("supply", seen.supply_pa))
    shown += [f"{name} {1e-3 * value_pa:.2f} kPa" for name, value_pa in named if value_pa is not None]
    return shown


def _conditions(seen: ValveSeen) -> list[str]:
    shown = []
    if seen.loop_in_manual is not None:
        shown.append("loop in manual" if seen.loop_in_manual else "loop not in manual")
    if seen.interlock is not None:
        shown.append("interlock active" if seen.interlock else "no interlock")
    if seen.owner is not None:
        shown.append("owned by nobody" if seen.owner == 0 else say("shown_owner", "owned by run {run}", run=seen.owner))
    if seen.watchdog is not None:
        shown.append(f"watchdog {seen.watchdog}")
    return shown
