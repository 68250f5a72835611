"""Instants as people read them: by the plant's clock, with its zone."""

from __future__ import annotations

import re
from datetime import UTC, datetime, tzinfo
from typing import Final

_IN_UTC: Final = re.compile(r"\b(\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01]) (?:[01]\d|2[0-3]):[0-5]\d) UTC\b")


def instant_words(at: datetime | None, zone: tzinfo | None) -> str:
    """Return an instant by the plant's clock, with its zone; a dash for none. Without ``zone``, by this machine's."""
    return "–" if at is None else f"{at.astimezone(zone):%Y-%m-%d %H:%M %Z}"


def short_instant(at: datetime, zone: tzinfo | None) -> str:
    """Return an instant by the plant's clock where a label has no room for its zone."""
    return f"{at.astimezone(zone):%Y-%m-%d %H:%M}"


def zone_words(at: datetime, zone: tzinfo | None) -> str:
    """Return what a zone is called, such as Europe/Berlin; without ``zone``, what this machine calls its own then."""
    return f"{at.astimezone():%Z}" if zone is None else str(zone)


def by_the_plants_clock(sentence: str, zone: tzinfo | None) -> str:
    """Return a sentence with the instants that it tells in UTC by the plant's clock: a row has one clock."""

    def told(found: re.Match[str]) -> str:
        return instant_words(datetime.fromisoformat(found[1]).replace(tzinfo=UTC), zone)

    return _IN_UTC.sub(told, sentence)
