"""What is wrong with a key or a value that somebody gave, beside what was meant or is allowed."""

from __future__ import annotations

import difflib
from collections.abc import Collection
from dataclasses import fields, is_dataclass
from typing import Any, Final

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from valve.messages import Message, say

_LONGEST_SHOWN: Final = 60  # characters of a wrong value


def nearest(word: str, known: Collection[str]) -> str | None:
    """Return the known name that ``word`` is likely meant to be; None where none is near."""
    close = difflib.get_close_matches(word, known, n=1)
    return close[0] if close else None


def known_keys(kind: Any) -> list[str]:
    """Return the keys that a dataclass or a pydantic model takes; none of anything else."""
    if is_dataclass(kind):
        return [one.name for one in fields(kind)]
    if not (isinstance(kind, type) and issubclass(kind, BaseModel)):
        return []
    return [one.alias or name for name, one in kind.model_fields.items()]


def unknown_key(word: str, known: Collection[str]) -> Message:
    """Return why a key is refused: unknown, with the one that was meant or, where none is near, all that there are."""
    close = nearest(word, known)
    if close is not None:
        return say("key_meant", "this key is unknown, did you mean {close}?", close=close)
    if known:
        return say("keys_known", "this key is unknown, known here are {known:, }", known=tuple(known))
    return say("key_unknown", "this key is unknown")


def lowered(text: str) -> str:
    """Return one of pydantic's texts to stand within a sentence."""
    return text[:1].lower() + text[1:]


def fault_of(found: ErrorDetails, known: Collection[str]) -> str:
    """Return one of pydantic's findings in words: a value beside its limit, or which of the ``known`` was meant."""
    key = ".".join(str(part) for part in found["loc"])[:80]
    if found["type"] == "extra_forbidden":
        return say("fault_of_key", "{key}: {why}", key=key, why=unknown_key(key, known))
    shown = repr(found["input"])
    shown = shown if len(shown) <= _LONGEST_SHOWN else f"{shown[: _LONGEST_SHOWN - 3]}..."
    return say("fault_of_value", "{key} is {shown}: {why}", key=key, shown=shown, why=lowered(found["msg"]))
