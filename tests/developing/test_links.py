"""Every link between the pages leads to a page and a heading that are there, and the index names every page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest

_ROOT: Final = Path(__file__).parents[2]
_PAGES: Final = [_ROOT / "README.md", *sorted((_ROOT / "docs").rglob("*.md"))]
_LINK: Final = re.compile(r"\]\((?!\w+:)([^)#\s]*)(?:#([^)\s]+))?\)")
_CODE: Final = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def _anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", _CODE.sub("", page.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def _broken(page: Path) -> list[str]:
    broken = []
    for path, anchor in _LINK.findall(_CODE.sub("", page.read_text("utf-8"))):
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            broken.append(f"{path}#{anchor}" if anchor else path)
    return broken


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: page.relative_to(_ROOT).as_posix())
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    assert _broken(page) == []


def test_the_index_names_every_page() -> None:
    index = (_ROOT / "docs" / "README.md").read_text("utf-8")
    pages = [page.name for page in _PAGES[1:] if page.parent.name != "decisions" and page.name != "README.md"]
    assert [name for name in pages if f"{name})" not in index] == []


def test_what_the_program_calls_a_page_is_there() -> None:
    named = {
        name
        for room in ("service", "drivers", "simulator", "discrepancy", "estimators", "valve", "deploy", "examples")
        for file in (_ROOT / room).rglob("*")
        if file.suffix in {".py", ".toml", ".yml", ".service"}
        for name in re.findall(r"docs/[\w/-]+\.md", file.read_text("utf-8"))
    }
    assert len(named) > 3
    assert [name for name in sorted(named) if not (_ROOT / name).exists()] == []
