"""Who asks for a test: it is written down with the test and in the audit log."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final


class RequesterKind(StrEnum):
    """What kind of caller it is."""

    PERSON = "person"
    MACHINE = "machine"
    SCHEDULE = "schedule"
    LOCAL = "local"


@dataclass(frozen=True, slots=True)
class Requester:
    """A caller, by the name that it signed in with."""

    name: str
    kind: RequesterKind


#: A command on the gateway itself, where no sign-in is configured.
LOCAL: Final = Requester("local", RequesterKind.LOCAL)


def person_of(name: str) -> str:
    """Return the name of whoever asked for something as people read it: "" where nobody signs in."""
    return "" if name == LOCAL.name else name
