"""A password in a file of its own: nothing but its owner may read it, and no message holds what stands in it."""

from __future__ import annotations

import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from valve.errors import ConfigurationError
from valve.messages import say

_OTHERS: Final = 0o077
_WRONG_FILE: Final = say("name_existing_file", "name a file that holds the password")


@dataclass(frozen=True, slots=True)
class SecretFault:
    """Why a file is not taken for a secret, and what to do."""

    reason: str
    remedy: str


def secret_fault(path: Path) -> SecretFault | None:
    """Return what is wrong with the file of a secret before it is read: it is not there, or others may read it."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        return SecretFault(_unread(str(error.strerror)), _WRONG_FILE)
    if mode & _OTHERS:
        return SecretFault(
            say("readable_by_others", "others may read it (mode {mode:04o})", mode=mode),
            say("chmod_file", "chmod 600 that file"),
        )
    return None


def _unread(reason: str) -> str:
    return say("it_is_unreadable", "it cannot be read ({reason})", reason=reason)


def read_secret(path: Path, key: str) -> str:
    """Return the password in a file, without the white space around it; ``key`` of plant.toml names the file.

    Raises ConfigurationError where others may read the file, or where it cannot be read or is empty.
    """
    fault = secret_fault(path)
    text = ""
    if fault is None:
        try:
            text = path.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or say("it_is_no_text", "it is no text")
            fault = SecretFault(_unread(reason), _WRONG_FILE)
    if fault is None and not text:
        fault = SecretFault(say("it_is_empty", "it is empty"), say("write_password", "write the password into it"))
    if fault is not None:
        raise ConfigurationError(
            say(
                "secret_file_fault",
                "{path}: {key}: {reason}: {remedy}",
                path=str(path),
                key=key,
                reason=fault.reason,
                remedy=fault.remedy,
            )
        )
    return text
