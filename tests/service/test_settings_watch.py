"""``[valves.watch]`` in plant.toml: what it becomes, and each fault with key, value, limit and remedy."""

from __future__ import annotations

from datetime import time
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from service.config.settings import load_plant
from tests.support.plants import bus_text, service_text, valve_text
from valve.errors import ConfigurationError

LINE = '[[buses]]\nname = "line-1"\nkind = "modbus_rtu"\nserial_port = "/dev/ttyS7"\nbaud_rate = 9600\nparity = "N"\n'


def plant_file(folder: Path, watch: str, *, bus: str = "plc-1", valves: int = 1) -> Path:
    text = service_text('zone = "Europe/Berlin"') + bus_text("plc-1", 5020) + LINE
    text += "".join(
        valve_text(f"FV-{one}", bus, one, more=f"[valves.watch]\n{watch}\n") for one in range(1, valves + 1)
    )
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_watched_valve_has_its_rules_by_the_clock_of_the_plant(quick_path: Path) -> None:
    path = plant_file(quick_path, 'period = "100 ms"\nfrom = "22:00"\nuntil = "05:30"\nkeep_days = 14')
    rules = load_plant(path).valves["FV-1"].wiring.watch
    assert rules is not None
    assert (rules.period_s, rules.begins, rules.ends, rules.keep_days) == (0.1, time(22), time(5, 30), 14)
    assert rules.zone == ZoneInfo("Europe/Berlin")


def test_an_empty_section_reads_all_day_ten_times_a_second(quick_path: Path) -> None:
    rules = load_plant(plant_file(quick_path, "")).valves["FV-1"].wiring.watch
    assert rules is not None
    assert (rules.period_s, rules.begins, rules.ends, rules.keep_days) == (0.1, None, None, 7)


@pytest.mark.parametrize(
    ("watch", "said"),
    [
        ("period_s = 0.001", ["valves[0].watch.period_s = 0.001", "greater than or equal to 0.02"]),
        ('period_s = "quick"', ["valves[0].watch.period_s", "quick", "number"]),
        ("period_s = 60.0", ["valves[0].watch.period_s = 60.0", "10"]),
        ('from = "22:00"', ["valves[0].watch", "watch.from and watch.until belong together"]),
        ('from = "22:00"\nuntil = "22:00"', ["valves[0].watch", "both 22:00", "neither for all day"]),
        ('from = "10 pm"\nuntil = "05:00"', ["valves[0].watch.from", "10 pm"]),
        ("keep_days = 0", ["valves[0].watch.keep_days = 0"]),
        ("keep = 7", ["valves[0].watch.keep = 7", "unknown", "keep_days"]),
        ("every_s = 1.0", ["valves[0].watch.every_s = 1.0", "unknown", "period_s"]),
    ],
)
def test_a_wrong_section_is_refused_with_its_key(quick_path: Path, watch: str, said: list[str]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file(quick_path, watch))
    assert all(part in str(caught.value) for part in said), str(caught.value)


def test_a_section_that_is_no_table_is_refused(quick_path: Path) -> None:
    path = plant_file(quick_path, "")
    path.write_text(path.read_text().replace("[valves.watch]", "").replace('tag = "FV-1"', 'tag = "FV-1"\nwatch = 3'))
    with pytest.raises(ConfigurationError, match=r"valves\[0\]\.watch = 3"):
        load_plant(path)


@pytest.mark.parametrize("bus", ["plc-1", "line-1"])
def test_a_bus_that_has_no_time_for_all_its_valves_is_told(quick_path: Path, bus: str) -> None:
    valves = 40 if bus == "plc-1" else 2
    with pytest.raises(ConfigurationError) as caught:
        load_plant(plant_file(quick_path, "period_s = 0.1", bus=bus, valves=valves))
    (said,) = str(caught.value).splitlines()
    assert f"the {valves} valves watched on bus {bus} need" in said
    assert "70 % can be had" in said
    assert "read each of them every" in said
    every_s = float(said.partition("read each of them every ")[2].partition(" s")[0])
    load_plant(plant_file(quick_path, f"period_s = {every_s}", bus=bus, valves=valves))
