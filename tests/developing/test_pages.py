"""The pages are true: links lead somewhere, and commands, benchmarks, routes, files and keys are there."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import pytest
from pydantic import BaseModel
from typer.main import get_command

from drivers.addresses import GaugeAddress, MotionLimits, RtuAddress, TcpAddress, TlsAddress
from drivers.permissive_rules import PermissiveRules
from service.cli import app
from service.cli.simulated_instruments import HuntingSection, PackingSection, PositionSection, PressureSection
from service.cli.simulated_plant import SimulationSection
from service.config.maps import CanarySection, MapSection, RegisterSection, WatchdogSection
from service.config.mqtt import MqttSection
from service.config.nightly import GatewaySection, GroupSection, RetentionSection, ScheduleSection
from service.config.settings import PlantSection, ServiceSection
from service.config.valves import ValveSection
from service.config.watching import WatchSection
from service.model.health_limits import HealthLimits
from tests.bench.benchmarks.__main__ import BENCHMARKS, COUNTED
from tests.service.access.signed_in import signed_in

_ROOT: Final = Path(__file__).parents[2]
_PAGES: Final = [_ROOT / "README.md", *sorted((_ROOT / "docs").rglob("*.md"))]
_LINK: Final = re.compile(r"\]\((?!\w+:)([^)#\s]*)(?:#([^)\s]+))?\)")
_BLOCK: Final = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_CALL: Final = r"(?:\.venv/bin/)?breakaway ([a-z][^`\n|>#$]*)"  # up to a pipe, a comment or the end of the quote
_ROUTE: Final = re.compile(r"`(GET|POST|PATCH|PUT|DELETE) (/[^\s`?]*)")
_MENTION: Final = re.compile(
    r"`((?:valve|estimators|discrepancy|drivers|simulator|service|tests|deploy|examples)/[\w./-]+)`"
)


def _text(page: Path) -> str:
    return page.read_text("utf-8")


def _named(page: Path) -> str:
    return page.relative_to(_ROOT).as_posix()


def _anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", _BLOCK.sub("", _text(page)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def _broken(page: Path) -> list[str]:
    broken = []
    for path, anchor in _LINK.findall(_BLOCK.sub("", _text(page))):
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            broken.append(f"{path}#{anchor}" if anchor else path)
    return broken


@pytest.mark.parametrize("page", _PAGES, ids=_named)
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    assert _broken(page) == []


@pytest.mark.parametrize("page", _PAGES, ids=_named)
def test_every_file_that_a_page_names_is_there(page: Path) -> None:
    assert [path for path in _MENTION.findall(_text(page)) if not (_ROOT / path).exists()] == []


def test_the_index_names_every_page() -> None:
    index = _text(_ROOT / "docs" / "README.md")
    pages = [page.name for page in _PAGES[1:] if page.parent.name != "decisions" and page.name != "README.md"]
    assert [name for name in pages if f"{name})" not in index] == []


def test_what_the_program_calls_a_page_is_there() -> None:
    named = {
        name
        for room in ("service", "drivers", "simulator", "discrepancy", "estimators", "valve", "deploy", "examples")
        for file in (_ROOT / room).rglob("*")
        if file.suffix in {".py", ".toml", ".yml", ".service"}
        for name in re.findall(r"docs/[\w/-]+\.md", _text(file))
    }
    assert len(named) > 3
    assert [name for name in sorted(named) if not (_ROOT / name).exists()] == []


def _unknown_in(words: list[str]) -> str:
    """Return the first command or option that the command line does not have; "" where it has all."""
    command: Any = get_command(app)
    context: Any = command.make_context("breakaway", [], resilient_parsing=True)
    while words and hasattr(command, "resolve_command") and re.match(r"[a-z]", words[0]):
        found = command.resolve_command(context, list(words))[1]
        if found is None:
            return words[0]
        command, words = found, words[1:]
    options = {name for parameter in command.get_params(context) for name in parameter.opts + parameter.secondary_opts}
    asked = [word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)]
    return next((option for option in asked if option not in options | {"--help"}), "")


@pytest.mark.parametrize("page", _PAGES, ids=_named)
def test_every_command_of_a_page_is_one(page: Path) -> None:
    text = _text(page).replace("\\\n", " ")
    blocks = "\n".join([*_BLOCK.findall(text), *re.findall(r"^    .*$", text, re.MULTILINE)])
    asked = [*re.findall(rf"`{_CALL}", _BLOCK.sub("", text)), *re.findall(rf"^ *{_CALL}", blocks, re.MULTILINE)]
    faults = {line: _unknown_in([word.strip("[]().,;:'\"") for word in line.split()]) for line in asked}
    assert {line: fault for line, fault in faults.items() if fault} == {}


def test_every_benchmark_that_a_page_names_is_one() -> None:
    known = {*BENCHMARKS, *COUNTED}
    asked = {
        (_named(page), word)
        for page in _PAGES
        for quoted, bare in re.findall(r'make bench ARGS=(?:"([^"]+)"|(\w+))', _text(page))
        for word in (quoted or bare).split()
    }
    assert len(asked) > 10
    assert [one for one in sorted(asked) if re.match(r"[a-z]", one[1]) and one[1] not in known] == []


async def test_every_route_that_a_page_names_is_one(quick_path: Path) -> None:
    async with signed_in(quick_path, "admin") as served:
        document = (await served.client.get("/openapi.json", headers=next(iter(served.tokens.values())))).json()
    known = {
        (method.upper(), re.sub(r"{[^}]*}", "*", path)) for path, ways in document["paths"].items() for method in ways
    }
    for page in _PAGES:
        for method, path in _ROUTE.findall(_text(page)):
            asked = re.sub(r"{[^}]*}|\b[A-Z]{2,}[-\d]*\b", "*", path)
            assert asked == "/" or (method, asked) in known, f"{_named(page)}: {method} {path}"


def _keys(section: Any) -> set[str]:
    if isinstance(section, type) and issubclass(section, BaseModel):
        return {one.alias or name for name, one in section.model_fields.items()}
    return {one.name for one in fields(section)}


@pytest.mark.parametrize(
    ("section", "page"),
    [
        *((one, "plant.md") for one in (PlantSection, ServiceSection, ValveSection, RetentionSection, ScheduleSection)),
        *((one, "plant.md") for one in (GatewaySection, GroupSection, MqttSection)),
        *((one, "plant.md") for one in (TcpAddress, TlsAddress, RtuAddress, GaugeAddress)),
        *((one, "plant.md") for one in (MotionLimits, PermissiveRules)),
        *((one, "plant.md") for one in (CanarySection, MapSection, RegisterSection, WatchdogSection)),
        *((one, "plant.md") for one in (SimulationSection, PackingSection, PositionSection, PressureSection)),
        *((one, "plant.md") for one in (HuntingSection, WatchSection)),
        (HealthLimits, "health.md"),
    ],
)
def test_every_key_of_a_section_is_explained(section: Any, page: str) -> None:
    words = set(re.findall(r"\w+", _text(_ROOT / "docs" / page)))
    assert _keys(section) - words == set()


def test_the_changelog_begins_with_the_version_of_this_tree() -> None:
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    newest = re.search(r"^## (\S+)", (_ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    assert newest[1] == project["version"]
