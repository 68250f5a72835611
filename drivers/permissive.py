"""One condition that must hold before a valve moves, and what to do where it does not."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from valve.errors import PermissiveError
from valve.messages import joined, say


@dataclass(frozen=True, slots=True)
class Permissive:
    """One condition. ``met`` is None where the plant has no way to show it and does not ask for it."""

    name: str
    met: bool | None
    value: str
    limit: str
    remedy: str = ""

    def to_json(self) -> dict[str, bool | str | None]:
        """Return it as the interface shows it."""
        remedy = self.remedy if self.met is False else ""
        return {"name": self.name, "met": self.met, "value": self.value, "limit": self.limit, "remedy": remedy}


def require_met(tag: str, permissives: Iterable[Permissive]) -> None:
    """Raise PermissiveError that names every missing one with its remedy."""
    missing = missing_words(permissives)
    if missing:
        raise PermissiveError(say("nothing_was_moved", "{tag}: nothing was moved: {why}", tag=tag, why=missing))


def missing_words(permissives: Iterable[Permissive]) -> str:
    """Return every missing one with its value, its limit and its remedy; "" where none is missing."""
    missing = [
        say(
            "permissive_missing",
            "{name}: {value}, {limit} is needed: {remedy}",
            name=one.name,
            value=one.value,
            limit=one.limit,
            remedy=one.remedy,
        )
        for one in permissives
        if one.met is False
    ]
    return joined("; ", missing) if missing else ""
