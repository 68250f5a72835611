"""Passwords: what may be one, and Argon2id (RFC 9106) over it."""

from __future__ import annotations

import secrets
from functools import cache
from typing import Final

from argon2 import PasswordHasher
from argon2.exceptions import Argon2Error, InvalidHashError

from valve.errors import RequestError
from valve.messages import say

SHORTEST: Final = 12  # characters; without a second factor a shorter one is guessed
LONGEST: Final = 256
# One lane, so that a sign-in takes one core from a running test and not all: about 0.1 s, 46 MiB.
_HASHER: Final = PasswordHasher(time_cost=2, memory_cost=47_104, parallelism=1)


def hashed(name: str, password: str) -> str:
    """Return what is stored of a password. Raises RequestError where it is too short, too long or the name."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise RequestError(
            say(
                "password_length",
                "user {name}: the password has {count} characters, it needs {shortest} to {longest}: choose another, "
                "a sentence for instance",
                name=name,
                count=len(password),
                shortest=SHORTEST,
                longest=LONGEST,
            )
        )
    if len(set(password)) < 5 or name.casefold() in password.casefold():
        raise RequestError(
            say(
                "password_guessable",
                "user {name}: the password is easily guessed: choose one without the name, of more letters",
                name=name,
            )
        )
    return _HASHER.hash(password.encode("utf-8", "surrogatepass"))


@cache
def _nobody() -> str:
    """Compared with where a name is unknown: the answer takes as long as for one that is known."""
    return _HASHER.hash(secrets.token_urlsafe(32))


def fits(stored: str | None, password: str) -> bool:
    """Return whether a password is the one that is stored; as slow where none is."""
    nobody = _nobody()
    try:
        _HASHER.verify(nobody if stored is None else stored, password.encode("utf-8", "surrogatepass"))
    except (Argon2Error, InvalidHashError):
        return False
    return stored is not None


def random_password() -> str:
    """Return a password of 120 bits."""
    return secrets.token_urlsafe(15)
