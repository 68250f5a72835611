"""Instants as people read them: by the plant's clock, with its zone."""

from __future__ import annotations

from datetime import datetime, tzinfo


def instant_words(at: datetime | None, zone: tzinfo | None) -> str:
    """Return an instant by the plant's clock, with its zone; a dash for none. Without ``zone``, by this machine's."""
    return "–" if at is None else f"{at.astimezone(zone):%Y-%m-%d %H:%M %Z}"


def short_instant(at: datetime, zone: tzinfo | None) -> str:
    """Return an instant by the plant's clock where a label has no room for its zone."""
    return f"{at.astimezone(zone):%Y-%m-%d %H:%M}"


def zone_words(at: datetime, zone: tzinfo | None) -> str:
    """Return what a zone is called, such as Europe/Berlin; without ``zone``, what this machine calls its own then."""
    return f"{at.astimezone():%Z}" if zone is None else str(zone)
