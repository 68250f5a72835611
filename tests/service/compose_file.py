"""Reads the part of YAML that docker-compose.yml keeps to: nested mappings, lists of scalars, flow lists."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_SCALAR = re.compile(r'"(?P<quoted>[^"]*)"|(?P<bare>[^\s",\[\]{}#][^",\[\]{}#]*?)')


def _value(text: str) -> Any:
    if text == "{}":
        return {}
    if text.startswith("["):
        assert text.endswith("]"), text
        inner = text[1:-1].strip()
        return [_value(part) for part in re.findall(r'"[^"]*"|[^\s,]+', inner)]
    match = _SCALAR.fullmatch(text)
    assert match is not None, f"not in the part of YAML that is read here: {text!r}"
    return match["quoted"] if match["quoted"] is not None else match["bare"]


def _lines(text: str) -> list[tuple[int, str]]:
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        bare = re.sub(r"(^|\s)#.*$", "", line).rstrip()
        assert "\t" not in bare, f"line {number} has a tab"
        if bare:
            lines.append((len(bare) - len(bare.lstrip()), bare.lstrip()))
    return lines


def _block(lines: list[tuple[int, str]], indent: int) -> Any:
    if lines and lines[0][1].startswith("- "):
        items = []
        while lines and lines[0] >= (indent, "") and lines[0][1].startswith("- "):
            items.append(_value(lines.pop(0)[1][2:]))
        return items
    mapping: dict[str, Any] = {}
    while lines and lines[0][0] == indent:
        key, colon, rest = lines.pop(0)[1].partition(":")
        assert colon, f"no key: {key}"
        assert key not in mapping, f"doubled key: {key}"
        mapping[key] = _value(rest.strip()) if rest.strip() else _block(lines, lines[0][0])
    assert not lines or lines[0][0] < indent, f"wrong indentation: {lines[0][1]}"
    return mapping


def read_compose_file(path: Path) -> dict[str, Any]:
    """Return the file's content. Raises AssertionError where it is not of the part of YAML that is read here."""
    lines = _lines(path.read_text(encoding="utf-8"))
    content = _block(lines, 0)
    assert not lines
    assert isinstance(content, dict)
    return content
