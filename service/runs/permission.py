"""Whether a valve may be tested now: what its device shows, the disk, and how its last test ended."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from drivers.permissive import Permissive
from valve.messages import message_of, say

#: A test's journal and recording take 40 MB at most (300 s at 1 kHz), its analysis a few more.
LEAST_FREE_BYTES: Final = 200_000_000


@dataclass(frozen=True, slots=True)
class Permission:
    """The permissives of one valve as they were read at an instant, with the work permit that was named, if any."""

    permissives: tuple[Permissive, ...]
    read_at: datetime
    permit: str | None = None

    @property
    def may_start(self) -> bool:
        """Whether none is missing."""
        return all(one.met is not False for one in self.permissives)

    def to_json(self) -> dict[str, Any]:
        """Return it as the store and the interface have it."""
        shown = [one.to_json() for one in self.permissives]
        about = {"read_at": self.read_at.isoformat(), "may_start": self.may_start, "permit": self.permit}
        return {**about, "permissives": shown}


def _size(size: float) -> str:
    if size >= 1e10:
        return say("gigabytes", "{n:.0f} GB", n=size / 1e9)
    return say("megabytes", "{n:.0f} MB", n=size / 1e6)


def free_disk(folder: Path) -> Permissive:
    """Return the permissive that the store's disk is. Blocks."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return Permissive(
            "disk",
            False,
            say("disk_unreadable", "it cannot be read ({why})", why=error.strerror or message_of(error)),
            say("a_disk", "a disk"),
            say("look_at_disk", "look at the store's disk"),
        )
    limit = say("disk_at_least_free", "at least {size} free", size=_size(LEAST_FREE_BYTES))
    remedy = say("free_disk_space", "free some space on the store's disk, or name another service.store")
    return Permissive(
        "disk", free >= LEAST_FREE_BYTES, say("disk_free", "{size} free", size=_size(free)), limit, remedy
    )
