"""The text of a plant.toml, for tests that drive a valve or load a plant: the paper's actuator on the reference map."""

from __future__ import annotations

from pathlib import Path

PRESSURE_PA = (0.0, 82737.0)


def service_text(more: str = "", *, store: str | Path = "plant-data", port: int = 0) -> str:
    """Return the settings of a service; ``more`` are further keys of it."""
    return f'[service]\nstore = "{store}"\nport = {port}\n{more}\n'


def bus_text(name: str, port: int | str, more: str = "") -> str:
    """Return a Modbus TCP bus on this machine."""
    return f'[[buses]]\nname = "{name}"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\nport = {port}\n{more}\n'


def valve_text(
    tag: str,
    bus: str,
    device_id: int = 1,
    *,
    safe: str = "0.0",
    stem: str = "stem_read_after_s = 0.0",
    actuator: tuple[float, float] = (0.06452, 0.1016),
    signal: bool = True,
    pressure_pa: tuple[float, float] = PRESSURE_PA,
    rate_pa_per_s: float = 30000.0,
    mode: str = "captured",
    period_s: float = 0.001,
    watchdog_s: float | None = None,
    more: str = "",
) -> str:
    """Return a valve: ``actuator`` is diaphragm area (m2) and travel (m), ``more`` are further tables of it.

    ``stem`` is when its stem is looked at and where it should be: by default at once and nowhere.
    """
    signalled = f"[valves.signal]\nrange_ma = [4.0, 20.0]\nrange_pa = {list(pressure_pa)}\n" if signal else ""
    watchdog = "" if watchdog_s is None else f"[valves.watchdog]\ntimeout_s = {watchdog_s}\n"
    return f"""\
[[valves]]
tag = "{tag}"
safe_value_pa = {safe}
{stem}
[valves.actuator]
diaphragm_area_m2 = {actuator[0]}
travel_m = {actuator[1]}
{signalled}[valves.limits]
pressure_pa = {list(pressure_pa)}
pressure_rate_pa_per_s = {rate_pa_per_s}
longest_test_s = 300.0
[valves.command]
bus = "{bus}"
device_id = {device_id}
map = "reference"
[valves.acquisition]
mode = "{mode}"
period_s = {period_s}
{watchdog}{more}
"""
