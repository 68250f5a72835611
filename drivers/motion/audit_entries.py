"""Entries of the audit log as text: one JSON object a line, each holding the hash of the one before.

::

    {"n": 1, "at": "2026-11-21T03:15:02.120431+00:00", "event": "motion.armed", "who": "anna", "valve": "FV-101",
     "test": "20261121T031502Z-9f3c01ab", "details": {...}, "previous": HASH, "hash": HASH}

``hash`` is SHA-256 (hex) over ``previous``, a line feed and the canonical JSON (keys sorted, no spaces, UTF-8) of all
other members. The first entry's ``previous`` is the hash of the chain's name, so that no chain passes for another's.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

SCHEMA: Final = "breakaway/audit/1"
_MEMBERS: Final = frozenset({"n", "at", "event", "who", "valve", "test", "details", "previous", "hash"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One thing that was done. ``n`` counts from 1 within a chain; ``valve`` and ``test`` may be empty."""

    n: int
    at: str
    event: str
    who: str
    valve: str
    test: str
    details: Mapping[str, Any]
    previous: str

    @property
    def hash(self) -> str:
        """SHA-256 (hex) of the entry behind the one before."""
        members = asdict(self)
        previous = members.pop("previous")
        return hashlib.sha256(f"{previous}\n{canonical(members)}".encode()).hexdigest()

    @property
    def line(self) -> bytes:
        """The entry as it stands in the file."""
        return f"{canonical({**asdict(self), 'hash': self.hash})}\n".encode()


def canonical(document: Mapping[str, Any]) -> str:
    """Return JSON that is the same text for the same content. Raises ValueError or TypeError for what JSON lacks."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def chain_start(name: str) -> str:
    """Return what the first entry of the chain ``name`` holds as the hash before it."""
    return hashlib.sha256(f"{SCHEMA} {name}".encode()).hexdigest()


def read_entry(line: bytes) -> tuple[Entry, str]:
    """Return an entry and the hash that stands in it. Raises ValueError where the line is no entry."""
    document = json.loads(line)
    if not isinstance(document, dict) or document.keys() != _MEMBERS:
        raise ValueError("its members are not those of an entry")
    stated = document.pop("hash")
    entry = Entry(**document)
    if entry.line.rstrip(b"\n") != line.rstrip(b"\n") and stated == entry.hash:
        raise ValueError("it is not written as this service writes it")
    return entry, str(stated)
