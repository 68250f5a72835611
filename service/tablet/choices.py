"""How a person narrows a list: chips that choose by what was found, and words that a valve is found by."""

from __future__ import annotations

from dataclasses import dataclass

from service.config.plant import PlantValve


@dataclass(frozen=True, slots=True)
class Chip:
    """One choice: its words, how many valves it would show, and where it leads."""

    value: str
    words: str
    count: int
    is_chosen: bool
    address: str


def found_by(tag: str, valve: PlantValve) -> str:
    """Return what a valve is found by; words are looked for in each part by itself."""
    one = valve.identity
    parts = (tag, one.description, one.area, one.service, one.serial_number)
    return "\n".join(part for part in parts if part is not None).lower()
