"""The container files: what can be told of them without a container engine."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.addresses import TcpAddress
from service.settings import Plant, load_plant
from valve.parameter_sets import PARAMETER_SETS

PROJECT = Path(__file__).resolve().parents[2]
PLANT_FILE = PROJECT / "deploy" / "compose" / "plant.toml"


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    content = yaml.safe_load((PROJECT / "docker-compose.yml").read_text(encoding="utf-8"))
    assert isinstance(content, dict)
    return content


@pytest.fixture(scope="module")
def plant() -> Plant:
    return load_plant(PLANT_FILE)


def test_service_and_plant_are_two_containers_of_one_image(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert set(services) == {"service", "plant"}
    assert services["service"]["image"] == services["plant"]["image"]
    assert services["service"]["command"][0] == "serve"
    assert services["plant"]["command"][0] == "simulate"


def test_both_containers_read_the_plant_file_where_their_command_looks(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        source, target, mode = service["volumes"][0].split(":")
        assert (PROJECT / source).resolve() == PLANT_FILE, name
        assert service["command"][1:] == ["--config", target], name
        assert mode == "ro"


def test_only_this_machine_reaches_the_published_port(compose: dict[str, Any], plant: Plant) -> None:
    assert compose["services"]["service"]["ports"] == [f"127.0.0.1:{plant.service.port}:{plant.service.port}"]
    assert "ports" not in compose["services"]["plant"]


def test_every_bus_leads_to_the_simulated_plant(compose: dict[str, Any], plant: Plant) -> None:
    assert plant.buses
    for bus in plant.buses.values():
        assert isinstance(bus, TcpAddress)
        assert bus.host in compose["services"]


def test_the_store_lies_on_the_volume(compose: dict[str, Any], plant: Plant) -> None:
    volume, mounted = compose["services"]["service"]["volumes"][1].split(":")
    assert volume in compose["volumes"]
    assert plant.service.store == Path(mounted)


def test_every_valve_of_the_plant_is_simulated_from_a_published_set() -> None:
    valves = tomllib.loads(PLANT_FILE.read_text(encoding="utf-8"))["valves"]
    assert {valve["simulation"]["parameter_set"] for valve in valves} == {"vendor", "nominal", "rough"}
    for valve in valves:
        plate = PARAMETER_SETS[valve["simulation"]["parameter_set"]].nameplate.actuator
        assert valve["actuator"]["travel_m"] == plate.travel_m
        assert valve["actuator"]["diaphragm_area_m2"] == plate.diaphragm_area_m2


def test_the_image_runs_without_privileges_and_installs_by_hash(compose: dict[str, Any]) -> None:
    text = (PROJECT / "Dockerfile").read_text(encoding="utf-8")
    assert re.findall(r"^FROM (\S+)", text, re.MULTILINE) == ["docker.io/library/python:3.13-slim"] * 2
    assert re.findall(r"^USER (\S+)", text, re.MULTILINE) == ["breakaway"]
    assert text.index("\nUSER ") < text.index("\nENTRYPOINT ")
    assert "--require-hashes" in text
    assert "HEALTHCHECK" in text
    for service in compose["services"].values():
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]


def test_every_package_of_the_project_is_in_the_image() -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    copied = re.findall(r"^COPY (\w+) \1$", (PROJECT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(copied) == set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"])
    allowed = (PROJECT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {f"!{name}" for name in copied} <= set(allowed)
