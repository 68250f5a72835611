"""The container files: what can be told of them without a container engine."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from sqlalchemy import make_url

from drivers.addresses import TcpAddress
from drivers.motion.precedence import LOOP
from service.config.nightly import GATEWAY_VARIABLE
from service.config.plant import PASSWORD_VARIABLE, Plant
from service.config.settings import load_plant
from valve.parameter_sets import PARAMETER_SETS

PROJECT = Path(__file__).resolve().parents[2]
PLANT_FILE = PROJECT / "deploy" / "compose" / "plant.toml"
LARGE_PLANT_FILE = PROJECT / "deploy" / "compose" / "large_plant.toml"


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    content = yaml.safe_load((PROJECT / "docker-compose.yml").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


@pytest.fixture(scope="module")
def plants() -> dict[str, Plant]:
    single = load_plant(PLANT_FILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(GATEWAY_VARIABLE, "north")
        return {"plant": single, "valves": load_plant(LARGE_PLANT_FILE)}


GATEWAYS = {"service": "plant", "north": "valves", "south": "valves"}
MOTIONS = {"service": "motion", "north": "north-motion", "south": "south-motion"}


def test_all_parts_but_the_database_are_containers_of_one_image(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert set(services) == {*GATEWAYS, *GATEWAYS.values(), *MOTIONS.values(), "database"}
    assert {service["image"] for name, service in services.items() if name != "database"} == {"breakaway:local"}
    assert {services[name]["command"][0] for name in GATEWAYS} == {"serve"}
    assert {services[name]["command"][0] for name in GATEWAYS.values()} == {"simulate"}
    assert {services[name]["command"][0] for name in MOTIONS.values()} == {"motion"}


def test_without_a_profile_one_gateway_and_its_plant_start(compose: dict[str, Any]) -> None:
    of_none = {name for name, service in compose["services"].items() if "profiles" not in service}
    assert of_none == {"service", "motion", "plant"}


def test_containers_read_the_plant_file_where_their_command_looks(compose: dict[str, Any]) -> None:
    for gateway, simulation in GATEWAYS.items():
        for name in (gateway, MOTIONS[gateway], simulation):
            source, target, mode = compose["services"][name]["volumes"][0].split(":")
            expected = PLANT_FILE if simulation == "plant" else LARGE_PLANT_FILE
            assert (PROJECT / source).resolve() == expected, name
            assert compose["services"][name]["command"][1:] == ["--config", target], name
            assert mode == "ro"


def test_only_this_machine_reaches_the_published_ports(compose: dict[str, Any], plants: dict[str, Plant]) -> None:
    for name, service in compose["services"].items():
        if name in GATEWAYS:
            (port,) = service["ports"]
            inside = plants[GATEWAYS[name]].service.port
            assert re.fullmatch(rf"127\.0\.0\.1:\$\{{\w+:-83\d\d\}}:{inside}", port), port
        else:
            assert "ports" not in service, name


def test_every_bus_leads_to_the_simulated_plant(plants: dict[str, Plant]) -> None:
    for name, plant in plants.items():
        assert plant.buses
        for bus in plant.buses.values():
            assert isinstance(bus, TcpAddress)
            assert bus.host == name


def test_the_store_lies_on_a_volume_of_its_own(compose: dict[str, Any], plants: dict[str, Plant]) -> None:
    used = set()
    for name, simulation in GATEWAYS.items():
        volume, mounted = compose["services"][name]["volumes"][1].split(":")
        assert volume in compose["volumes"]
        assert plants[simulation].service.store == Path(mounted)
        assert compose["services"][MOTIONS[name]]["volumes"] == compose["services"][name]["volumes"], "one socket"
        assert MOTIONS[name] in compose["services"][name]["depends_on"]
        used.add(volume)
    assert len(used) == len(GATEWAYS)


def test_the_large_plant_has_twenty_valves_on_four_buses_of_two_gateways(
    compose: dict[str, Any], plants: dict[str, Plant]
) -> None:
    plant = plants["valves"]
    assert (len(plant.valves), len(plant.buses)) == (20, 4)
    assert sorted(plant.bus_gateways.values()) == ["north", "north", "south", "south"]
    for name in plant.gateways:
        assert compose["services"][name]["environment"][GATEWAY_VARIABLE] == name
        assert compose["services"][MOTIONS[name]]["environment"][GATEWAY_VARIABLE] == name
    assert plant.service.database is not None
    assert make_url(plant.service.database.url).host == "database"


def test_no_password_stands_in_a_file(compose: dict[str, Any]) -> None:
    assert compose["services"]["database"]["environment"]["POSTGRES_PASSWORD"] == f"${{{PASSWORD_VARIABLE}:-}}"


def test_every_valve_of_the_plant_is_simulated_from_a_published_set() -> None:
    valves = tomllib.loads(PLANT_FILE.read_text(encoding="utf-8"))["valves"]
    assert {valve["simulation"]["parameter_set"] for valve in valves} == {"vendor", "nominal", "rough"}
    for valve in valves:
        plate = PARAMETER_SETS[valve["simulation"]["parameter_set"]].nameplate.actuator
        assert valve["actuator"]["travel_m"] == plate.travel_m
        assert valve["actuator"]["diaphragm_area_m2"] == plate.diaphragm_area_m2


def test_the_image_runs_without_privileges_and_installs_by_hash(compose: dict[str, Any]) -> None:
    text = (PROJECT / "Dockerfile").read_text(encoding="utf-8")
    assert re.findall(r"^FROM (\S+)", text, re.MULTILINE) == ["python:3.13-slim"] * 2
    assert re.findall(r"^USER (\S+)", text, re.MULTILINE) == ["breakaway"]
    assert text.index("\nUSER ") < text.index("\nENTRYPOINT ")
    assert "--require-hashes" in text
    assert "HEALTHCHECK" in text
    for name, service in compose["services"].items():
        if name != "database":  # it drops its rights by itself, which needs some at the start
            assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]


def test_the_file_for_precedence_gives_what_moves_valves_the_limit_and_nobody_else() -> None:
    text = (PROJECT / "deploy" / "compose" / "precedence.yml").read_text(encoding="utf-8")
    assert yaml.safe_load(text)["services"] == {name: {"ulimits": {"rtprio": LOOP}} for name in MOTIONS.values()}


def test_every_package_of_the_project_is_in_the_image() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    copied = re.findall(r"^COPY (\w+) \1$", (PROJECT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(copied) == set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])
    allowed = (PROJECT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {f"!{name}" for name in copied} <= set(allowed)


def test_no_file_names_a_registry_of_images(compose: dict[str, Any]) -> None:
    """Where an image comes from is the engine's setting: a plant without the internet has a registry of its own."""
    named = {service["image"] for service in compose["services"].values()}
    named |= set(re.findall(r"^FROM (\S+)", (PROJECT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE))
    assert not {image for image in named if "/" in image}
