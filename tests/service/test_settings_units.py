"""Values with units in plant.toml and nameplates: what they become, and how a wrong one is told."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from drivers.addresses import MotionLimits, RtuAddress, Sampling, WatchdogChoice
from drivers.permissive_rules import PermissiveRules
from service.cli.simulated_plant import simulation_faults
from service.config.errors import Findings
from service.config.nameplates import nameplate_from_toml
from service.config.nightly import RetentionSection
from service.config.settings import faults_of, load_plant
from service.config.units import Written, in_own_words, in_si, own_names
from service.config.valves import ValveParts, valve_parts
from service.model.health_limits import HealthLimits
from valve.errors import ConfigurationError
from valve.messages import Message, lines_of, message_of, say
from valve.nameplate import Action, Actuator, Signal
from valve.units import PASCAL_PER_PSI

PLATE = """\
tag = "FV-101"
[actuator]
diaphragm_area = "100 in2"
travel = "4 in"
action = "spring"
moving_mass = "3 lb"
bench_set = ["3 psi", "15 psi"]
[signal]
range_ma = [4.0, 20.0]
range = ["3 psi", "15 psi"]
"""
SPAN_PA = (20684.2718795, 103421.359398)


def test_a_nameplate_in_the_units_of_its_owner_is_the_one_in_si() -> None:
    plate = nameplate_from_toml(PLATE.encode(), "fv-101.toml")
    assert plate.signal is not None
    assert plate.actuator == Actuator(0.1016, 0.064516, Action.SPRING, 1.36077711, SPAN_PA)
    assert plate.signal == Signal((4.0, 20.0), SPAN_PA)


@pytest.mark.parametrize(
    ("key", "text", "si"),
    [
        ("pressure_pa", "0.4 bar", 40.0e3),
        ("pressure_pa", "6psig", 41368.543759),
        ("pressure_pa", "1 kg/cm2", 98066.5),
        ("pressure_pa", "0.1 MPa", 100.0e3),
        ("pressure_pa", "10 inH2O", 2490.8891),
        ("pressure_rate_pa_per_s", "5 psi/s", 34473.7864658),
        ("pressure_rate_pa_per_s", "0.3 bar/min", 500.0),
        ("longest_test_s", "5 min", 300.0),
        ("longest_test_s", "500 ms", 0.5),
        ("band_m", '4"', 0.1016),
        ("band_m", "4 inches", 0.1016),
        ("band_m", "4e1 mm", 0.04),
        ("band_m", "-.5 cm", -0.005),
    ],
)
def test_units_are_read_as_people_spell_them(key: str, text: str, si: float) -> None:
    own = next(name for name, keys in own_names(MotionLimits).items() if keys == (key,))
    table = in_si(MotionLimits, {own: text})
    assert not table.faults
    assert table.values == {key: pytest.approx(si, rel=1e-9)}


@pytest.mark.parametrize(
    "text", ["100 in2", "100 in^2", "100 in²", "100 sq in", "100 in**2", "645.16 cm2", "64516 mm²"]
)
def test_an_area_is_read_in_every_spelling(text: str) -> None:
    assert in_si(Actuator, {"diaphragm_area": text}).values == {"diaphragm_area_m2": pytest.approx(0.064516)}


@pytest.mark.parametrize("text", ["3 lb", "3 lbs", "1.36077711 kg", "1360.77711 g"])
def test_a_mass_is_no_force(text: str) -> None:
    assert in_si(Actuator, {"moving_mass": text}).values == {"moving_mass_kg": pytest.approx(1.36077711)}


def test_percent_days_and_whole_numbers_have_units_too() -> None:
    limits = {"dead_band": "20 %", "stale": "5 weeks", "response_slower": "200 ms"}
    assert in_si(HealthLimits, limits).values == {
        "dead_band_percent": 20.0,
        "stale_days": 35.0,
        "response_slower_s": 0.2,
    }
    assert in_si(HealthLimits, {"response_slower": "40 %"}).values == {"response_slower_percent": 40.0}
    whole = in_si(RetentionSection, {"recordings": "12 weeks"}).values["recordings_days"]
    assert (whole, type(whole)) == (84, int)


@pytest.mark.parametrize(
    "kind",
    [Actuator, Signal, MotionLimits, PermissiveRules, HealthLimits, Sampling, WatchdogChoice, RtuAddress],
)
def test_every_key_that_ends_in_a_unit_has_a_name_without_it(kind: Any) -> None:
    ends = ("_pa", "_pa_per_s", "_m", "_m2", "_kg", "_ma", "_s", "_percent", "_days")
    suffixed = {one.name for one in fields(kind) if one.name.endswith(ends)}
    taken = {name for names in own_names(kind).values() for name in names}
    assert suffixed - taken == ({"supply_pa"} if kind is PermissiveRules else set())  # supply is a table


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"4 in"', '"4 psi"', 'actuator.travel = "4 psi": psi is no length: .*such as in, mm, cm or m, .*"6 in"'),
        ('"100 in2"', '"100 in"', 'actuator.diaphragm_area = "100 in": in is no area: .*in2, cm2, mm2 or m2'),
        ('"4 in"', '"4 inchez"', "travel = .*the unit inchez is unknown: .*in, mm, cm or m"),
        ('"4 in"', '"4"', 'travel = "4": it has no unit: write it with'),
        ('"4 in"', "4", "actuator.travel = 4: a number alone, its unit is unknown: .*, or give travel_m"),
        ('"4 in"', '"four in"', 'travel = "four in": it is no decimal number with a unit'),
        ('"4 in"', '"1 1/2 in"', "travel = .*no decimal number with a unit"),
        ('"4 in"', '"4,5 in"', "travel = .*no decimal number with a unit"),
        ('"4 in"', '"-4 in"', r'actuator.travel \("-4 in"\) is -0.1016 m, it must be above 0'),
        ('"4 in"', '"4000 in"', r'actuator.travel \("4000 in"\) is 101.6 m, no valve has more than 3: correct it'),
        ('["3 psi", "15 psi"]\n[', '["3 psia", "15 psia"]\n[', "bench_set = .*psia counts from vacuum"),
        ('["3 psi", "15 psi"]\n[', '["15 psi", "3 psi"]\n[', r"bench_set \(.*\) is 103421 to 20684.3 Pa, it must rise"),
        ('["3 psi", "15 psi"]\n[', '["3 psi", 15]\n[', "bench_set = .*a number alone, its unit is unknown"),
        ('range = ["3 psi', 'range = ["3 in', "signal.range = .*in is no current and no pressure: .*mA, A, psi, bar"),
    ],
)
def test_a_value_that_cannot_be_taken_is_told_by_the_owners_key_and_value(old: str, new: str, says: str) -> None:
    assert old in PLATE
    with pytest.raises(ConfigurationError, match=says) as caught:
        nameplate_from_toml(PLATE.replace(old, new, 1).encode(), "fv-101.toml")
    assert str(caught.value).startswith("fv-101.toml: ")
    assert "\n" not in str(caught.value)


def test_a_reason_by_the_owners_key_keeps_its_code_and_its_values() -> None:
    with pytest.raises(ConfigurationError) as caught:
        nameplate_from_toml(PLATE.replace('"4 in"', '"4000 in"', 1).encode(), "fv-101.toml")
    (said,) = lines_of(message_of(caught.value))
    assert isinstance(said, Message)
    assert said.code == "larger_than_any"
    assert said.values["key"] == 'actuator.travel ("4000 in")'
    assert said.values["value"] == pytest.approx(101.6)


def test_the_words_of_a_message_are_not_searched_for_keys() -> None:
    written = [(("actuator", "travel_m"), Written("travel", "4 in"))]
    said = say("some", "{key} in travel_m: {why}", key="actuator.travel_m", why="travel_m is wrong")
    told = in_own_words(said, written)
    assert isinstance(told, Message)
    assert told.template == said.template
    assert told.values == {"key": 'actuator.travel ("4 in")', "why": "travel_m is wrong"}


def test_a_value_that_stands_twice_is_refused_with_both_keys() -> None:
    text = PLATE.replace("[signal]", "travel_m = 0.1\n[signal]")
    with pytest.raises(ConfigurationError, match=r'actuator.travel = "4 in": travel_m is given too: give one of'):
        nameplate_from_toml(text.encode(), "fv-101.toml")


def with_units(plant_text: str) -> str:
    """The plant of these tests with the first valve in psi and inch."""
    first, second = plant_text.rsplit("[[valves]]", 1)
    for old, new in (
        ("safe_value_pa = 0.0", 'safe_value = "0 psi"\nsafe_position = "0.1 in"'),
        ("stem_read_after_s = 0.0", 'stem_read_after = "0 s"'),
        ("diaphragm_area_m2 = 0.06452", 'diaphragm_area = "100 in2"'),
        ("travel_m = 0.1016", 'travel = "4 in"'),
        ("range_pa = [0.0, 82737.0]", 'range = ["0 psi", "12 psi"]'),
        ("\npressure_pa = [0.0, 82737.0]", '\npressure = ["0 psi", "12 psi"]'),
        ("pressure_rate_pa_per_s = 30000.0", 'pressure_rate = "4 psi/s"'),
        ("longest_test_s = 300.0", 'longest_test = "5 min"'),
        ("period_s = 0.001", 'period = "1 ms"'),
    ):
        assert old in first, old
        first = first.replace(old, new, 1)
    return f'{first}[valves.health]\ndead_band = "20 %"\n[[valves]]{second}'.replace(
        'host = "127.0.0.1"\n', 'host = "127.0.0.1"\ntimeout = "400 ms"\n', 1
    )


def test_a_plant_file_in_psi_and_inch_is_the_one_in_si(plant_file: Path, plant_text: str) -> None:
    plant_file.write_text(with_units(plant_text), encoding="utf-8")
    plant = load_plant(plant_file)
    valve, twelve_pa = plant.valves["FV-101"], 82737.087518
    assert (valve.nameplate.actuator.travel_m, valve.nameplate.actuator.diaphragm_area_m2) == (0.1016, 0.064516)
    assert valve.nameplate.signal is not None
    assert valve.nameplate.signal.range_pa == (0.0, twelve_pa)
    limits, rest = valve.wiring.limits, valve.wiring.rest
    assert (limits.pressure_pa, limits.longest_test_s) == ((0.0, twelve_pa), 300.0)
    assert limits.pressure_rate_pa_per_s == pytest.approx(4.0 * PASCAL_PER_PSI)
    assert (valve.wiring.safe_value_pa, rest.position_m, rest.after_s) == (0.0, 0.00254, 0.0)
    assert valve.wiring.acquisition.period_s == 0.001
    assert valve.health.dead_band_percent == 20.0
    assert plant.buses["plc-1"].timeout_s == 0.4


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"0 psi"\nsafe', '"50 psi"\nsafe', ['FV-101: safe_value ("50 psi") 344738 Pa is outside limits.pressure (']),
        ('"0 psi"\nsafe', '"open"\nsafe', ['valves[0].safe_value = "open"', 'in quotes: "6 psi", or "entry"']),
        (
            '"0 psi"\nsafe',
            '"0 in"\nsafe',
            ['valves[0].safe_value = "0 in"', "in is no pressure", "psi, bar, kPa or Pa"],
        ),
        ('travel = "4 in"', 'travel = "4 kg"', ['valves[0].actuator.travel = "4 kg"', "kg is no length"]),
        ('travel = "4 in"', 'travle = "4 in"', ['valves[0].actuator.travle = "4 in"', "unknown", "write travel"]),
        ('pressure = ["0', 'pressure = ["-9', ['valves[0].limits.pressure = ["-9 psi", "12 psi"]', "inside"]),
        ('pressure = ["0 psi", "12 psi"]', 'pressure = "12 psi"', ['limits.pressure = "12 psi"', "give a list"]),
        ('period = "1 ms"', 'period = "1 ms"\nperiod_s = 1.0', ["acquisition.period", "period_s is given too"]),
        ('timeout = "400 ms"', 'timeout = "400 mm"', ['buses[0].timeout = "400 mm"', "mm is no time"]),
        ('dead_band = "20 %"', 'dead_band = "20 psi"', ["valves[0].health.dead_band", "psi is no percentage", "%"]),
    ],
)
def test_a_wrong_unit_in_a_plant_file_is_told_once_with_its_own_key(
    plant_file: Path, plant_text: str, old: str, new: str, says: list[str]
) -> None:
    text = with_units(plant_text)
    assert old in text
    plant_file.write_text(text.replace(old, new, 1), encoding="utf-8")
    _, faults = faults_of(plant_file)
    told = [str(fault) for fault in faults if says[0] in str(fault)]
    assert len(told) == 1, [str(fault) for fault in faults]
    assert told[0].startswith("plant.toml: ")
    for part in says:
        assert part in told[0]
    assert "travle" in new or not any("missing" in fault.reason for fault in faults)


def test_what_a_register_stands_for_is_a_pressure_or_the_length_of_a_position() -> None:
    def seen(quantity: list[str]) -> tuple[ValveParts, list[str]]:
        findings = Findings("plant.toml")
        point = {"bus": "io-1", "device_id": 1, "map": "advantech_adam_6024", "signal": [0.004, 0.02]}
        command, position = point | {"quantity": ["3 psi", "15 psi"]}, point | {"quantity": quantity}
        supply = {"supply": point | {"quantity": ["0 bar", "7 bar"]}, "supply_pa": [2.0e5, 7.0e5]}
        raw = {
            "tag": "FV-101",
            "actuator": {"travel": "4 in"},
            "command": command,
            "position": position,
            "permissives": supply,
        }
        parts = valve_parts(findings, raw, ("valves", 0))
        return parts, [str(one) for one in findings.faults if "quantity" in one.key]

    parts, faults = seen(["0 in", "4 in"])
    assert not faults
    assert parts.points["command"].quantity == SPAN_PA
    assert parts.points["position"].quantity == (0.0, 0.1016)
    assert parts.permissives is not None
    assert parts.permissives.supply is not None
    assert parts.permissives.supply.quantity == (0.0, 7.0e5)
    _, faults = seen(["0 psi", "4 psi"])
    assert len(faults) == 1
    assert 'valves[0].position.quantity = ["0 psi", "4 psi"]: psi is no length: write it' in faults[0]


def test_a_simulated_valve_takes_units_too(plant_file: Path, plant_text: str) -> None:
    good = plant_text + 'supply = "30 psi"\nlag = "200 ms"\n[valves.simulation.packing]\nwander_time = "2 min"\n'
    plant_file.write_text(good, encoding="utf-8")
    assert not simulation_faults(plant_file)
    plant_file.write_text(good.replace("30 psi", "30 in"), encoding="utf-8")
    assert [fault.key for fault in simulation_faults(plant_file)] == ["valves[1].simulation.supply"]
