"""Which valves the list shows: found by words, by state, by area, by what changed; and the chips that choose them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from typing import Annotated, Final
from urllib.parse import urlencode

from pydantic import BaseModel, Field

from service.config.plant import PlantValve
from service.shown.words import Change
from service.tablet.choices import Chip, found_by
from service.tablet.valve_stands import Stand
from valve.messages import say

_ROWS: Final = 50  # on one page
_ALL_ROWS: Final = 1000  # on the one that is printed
_STATES: Final = {
    "alarm": say("chip_alarm", "Alarm"),
    "F": say("state_failure", "Failure"),
    "bad": say("chip_ended_badly", "Ended badly"),
    "S": say("state_out_of_specification", "Out of specification"),
    "M": say("state_maintenance", "Maintenance required"),
    "C": say("state_function_check", "Function check"),
    "none": say("chip_not_known", "Not known"),
    "N": say("state_normal", "Normal"),
}
_ALWAYS: Final = (Change.WORSE, Change.NOT_TESTED, Change.UNCHANGED)  # that there is none is worth saying

_Choice = Annotated[list[Annotated[str, Field(max_length=200)]], Field(max_length=100)]


class Wish(BaseModel):
    """What the address of the list asks for; what is empty asks for nothing."""

    find: str = Field("", max_length=64)
    state: _Choice = []
    area: _Choice = []
    since: _Choice = []
    page: int = Field(1, ge=1, le=10_000)
    whole: bool = False

    def address(self, **changes: object) -> str:
        """Return the address of the list with these changes; what was chosen stays otherwise, on its first page."""
        asked = {"find": self.find, "state": self.state, "area": self.area, "since": self.since, **changes}
        given = {key: value for key, value in asked.items() if value}
        return f"/?{urlencode(given, doseq=True)}" if given else "/"


class ValveList:
    """The valves that a wish asks for, worst first."""

    def __init__(
        self,
        valves: Mapping[str, PlantValve],
        stands: Mapping[str, Stand],
        changes: Mapping[str, Change],
        wish: Wish,
    ) -> None:
        self._wish = wish
        self._facets: dict[str, tuple[Collection[str], Callable[[str], str]]] = {
            "state": (wish.state, lambda tag: stands[tag].condition.code),
            "area": (wish.area, lambda tag: valves[tag].identity.area or ""),
            "since": (wish.since, lambda tag: changes[tag].value),
        }
        words = wish.find.lower().split()
        self._found = (
            [tag for tag in stands if all(word in found_by(tag, valves[tag]) for word in words)] if words else [*stands]
        )
        self._areas = sorted({valve.identity.area for valve in valves.values() if valve.identity.area is not None})

    @cached_property
    def tags(self) -> list[str]:
        """All that fit."""
        return self._fitting("")

    @property
    def pages(self) -> int:
        """How many pages they fill."""
        return 1 if self._wish.whole else max(1, -(-len(self.tags) // _ROWS))

    @property
    def number(self) -> int:
        """The page that is shown."""
        return min(self._wish.page, self.pages)

    @property
    def shown(self) -> list[str]:
        """The valves on it."""
        if self._wish.whole:
            return self.tags[:_ALL_ROWS]
        return self.tags[(self.number - 1) * _ROWS : self.number * _ROWS]

    def chips(self) -> dict[str, list[Chip]]:
        """Return the choices by what they choose, each with how many valves it has beside the other choices made."""
        named: dict[str, Mapping[str, str]] = {
            "since": {change.value: change.words for change in Change},
            "state": _STATES,
            "area": {area: area for area in self._areas},
        }
        return {name: list(self._chips(name, words)) for name, words in named.items()}

    def _chips(self, name: str, words: Mapping[str, str]) -> Iterator[Chip]:
        chosen, value_of = self._facets[name]
        counts = Counter(value_of(tag) for tag in self._fitting(name))
        for value, said in words.items():
            is_chosen = value in chosen
            if counts[value] or is_chosen or name == "area" or value in _ALWAYS:
                others = [one for one in chosen if one != value]
                address = self._wish.address(**{name: others if is_chosen else [*others, value]})
                yield Chip(value, said, counts[value], is_chosen, address)

    def _fitting(self, leave_out: str) -> list[str]:
        asked = [(chosen, value) for name, (chosen, value) in self._facets.items() if chosen and name != leave_out]
        if not asked:
            return self._found
        return [tag for tag in self._found if all(value(tag) in chosen for chosen, value in asked)]
