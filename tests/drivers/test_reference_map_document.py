"""The register table of docs/reference-map.md is the map's, line by line."""

from __future__ import annotations

import re
from pathlib import Path

from drivers.maps.reference import (
    CORNER_CAPACITY,
    CORNERS_ADDRESS,
    MAP,
    WINDOW_ADDRESS,
    WINDOW_SAMPLES,
    WINDOW_WORDS,
)
from drivers.registers import Register

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference-map.md"
PROGRAM = Path(__file__).parents[2] / "docs" / "plc" / "breakaway_reference.st"


def row(register: Register) -> str:
    unit = register.unit if register.scale == 1.0 else f"{register.scale:g} {register.unit}"
    last = register.address + register.words - 1
    place = f"{register.address}" if register.words == 1 else f"{register.address}-{last}"
    return f"| {place} | `{register.name}` | {register.kind} | {unit} | {register.meaning} |"


def table() -> list[str]:
    return [row(register) for register in sorted(MAP.registers, key=lambda r: r.address)]


def test_the_documents_table_is_the_maps() -> None:
    written = [line for line in DOCUMENT.read_text("utf-8").splitlines() if re.match(r"\| \d+(-\d+)? \| `", line)]
    assert written == table(), "put this into the document:\n" + "\n".join(table())


def test_the_document_tells_the_tables_beside_the_registers() -> None:
    text = DOCUMENT.read_text("utf-8")
    for number in (CORNERS_ADDRESS, CORNER_CAPACITY, WINDOW_ADDRESS, WINDOW_SAMPLES, WINDOW_WORDS):
        assert re.search(rf"\b{number}\b", text), number


def test_the_frames_in_the_document_are_the_maps_golden_ones() -> None:
    text = DOCUMENT.read_text("utf-8")
    for frame in MAP.golden:
        for data in (frame.request, frame.answer):
            assert data.hex(" ").upper() in text


def test_the_plc_program_places_every_register_at_its_address() -> None:
    text = PROGRAM.read_text("utf-8")
    placed = {name: int(address) for name, address in re.findall(r"\bA_([A-Z_0-9]+)\s*: UINT := (\d+);", text)}
    expected = {register.name.upper(): register.address for register in MAP.registers}
    assert placed == expected | {"CORNERS": CORNERS_ADDRESS, "WINDOW": WINDOW_ADDRESS}
