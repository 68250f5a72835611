"""Who reads: in which units, by which clock and in which language."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import tzinfo
from typing import Any

from service.words.languages import Language
from service.words.messages import in_units
from service.words.units import ShownUnit, UnitSystem, measured, quantity, shown_unit
from valve.messages import Message


@dataclass(frozen=True, slots=True)
class Reader:
    """What a person reads in; ``zone`` is the plant's, None for this machine's own."""

    system: UnitSystem = UnitSystem.SI
    zone: tzinfo | None = None
    language: Language = Language.ENGLISH

    def told(self, text: str) -> str:
        """Return a sentence as this person reads it."""
        return in_units(text, self.system, self.zone, self.language)

    def shown(self, text: str) -> str:
        """Return a message as this person reads it; any other text, which may be somebody's own words, as it is."""
        return self.told(text) if isinstance(text, Message) else text

    def all_told(self, content: Any) -> Any:
        """Return ``content`` (texts in lists and mappings) with every text as this person reads it."""
        if isinstance(content, str):
            return self.told(content)
        if isinstance(content, Mapping):
            return {key: self.all_told(value) for key, value in content.items()}
        if isinstance(content, list | tuple):
            return [self.all_told(value) for value in content]
        return content

    def unit(self, si_unit: str) -> ShownUnit:
        """Return the unit in which this person reads a quantity of this SI unit."""
        return shown_unit(si_unit, self.system)

    def quantity(self, value_si: float | None, si_unit: str, digits: int = 4) -> str:
        """A value that was set, with its unit; a dash where there is none."""
        return quantity(value_si, si_unit, self.system, digits)

    def measured(self, value_si: float | None, ci95: list[float] | tuple[float, float] | None, si_unit: str) -> str:
        """A measured value with half of its 95 % interval and its unit; a dash where it is None."""
        return measured(value_si, ci95, si_unit, self.system)
