"""Sentences as people read them: the quantities in them in the units that a person chose.

A message (``valve.messages``) is made anew from its values. A text that is none, such as one that an earlier version
kept, stays as it was said: English and SI.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable, Iterable
from dataclasses import dataclass, field
from datetime import tzinfo
from functools import lru_cache
from typing import Final

from service.words.languages import Language
from service.words.messages import Telling
from service.words.plain_numbers import as_read
from service.words.units import UnitSystem
from valve.messages import Message, Value, formed, joined, left_out, parts_of, say

#: How a verdict without a fault is said; what follows it says how friction varies.
NO_FAULT: Final = say("no_fault_found", "No fault found.")
_KEPT: Final = 8192  # so many messages are kept as they were told
_SENTENCE_END: Final = re.compile(r"(?<=\.) (?=[A-Z])")  # of texts that are no messages


def in_units(text: str, system: UnitSystem, zone: tzinfo | None = None, language: Language = Language.ENGLISH) -> str:
    """Return a message in the units of ``system``, its instants by ``zone``, in a language; ``+-`` is read as ``±``."""
    if isinstance(text, Message):
        return _told(_Made(text, _key(text)), system, zone, language)
    return as_read(text)


@dataclass(frozen=True, slots=True)
class _Made:
    """A message that is the same as another if it was made of the same: equal texts may hide other digits and codes."""

    message: Message = field(compare=False)
    key: Hashable


def _key(value: Value) -> Hashable:
    if isinstance(value, Message):
        return value.code, value.template, value.form, tuple((name, _key(one)) for name, one in value.values.items())
    return tuple(map(_key, value)) if isinstance(value, tuple) else value


@lru_cache(maxsize=_KEPT)
def _told(made: _Made, system: UnitSystem, zone: tzinfo | None, language: Language) -> str:
    """Lists say the same again and again."""
    return Telling(system, zone, language, as_read).shown(made.message)


def as_sentence(text: str) -> str:
    """Return ``text`` with a capital at its begin and a stop at its end; "" stays, and a message stays one."""
    return text.formed("sentence") if isinstance(text, Message) else formed(text, "sentence")


def as_clause(text: str) -> str:
    """Return ``text`` to stand within a sentence: no capital, no stop; a message stays one."""
    return text.formed("clause") if isinstance(text, Message) else formed(text, "clause")


def without_stop(text: str) -> str:
    """Return ``text`` with no stop at its end, to stand in a list; a message stays one."""
    return text.formed("entry") if isinstance(text, Message) else formed(text, "entry")


def as_heading(text: str) -> str:
    """Return ``text`` with a capital and no stop, as a row of a table begins; a message stays one."""
    return text.formed("heading") if isinstance(text, Message) else formed(text, "heading")


def sentences_of(text: str) -> list[str]:
    """Return the sentences of a text: the parts of a message, and those of a text that is none."""
    found = [[part] if isinstance(part, Message) else _SENTENCE_END.split(part) for part in parts_of(text)]
    return [sentence.strip() if type(sentence) is str else sentence for part in found for sentence in part if sentence]


def together(sentences: Iterable[str], between: str = " ") -> str:
    """Return sentences one after the other, without those that are ""; one alone as it is, "" for none."""
    said = [sentence for sentence in sentences if sentence]
    return joined(between, said) if len(said) > 1 else next(iter(said), "")


def without(text: str, subject: str, *parts: str) -> str:
    """Return a text without what stands beside it: its ``subject`` where it begins with that, ``parts`` in its lists.

    ``FV-101: travel spans 0.4 %`` becomes ``travel spans 0.4 %`` on the page of FV-101.
    """
    if not isinstance(text, Message):
        for part in parts:
            text = text.replace(f"{part}; ", "").replace(f"; {part}", "")
        return text.replace(f"{subject}: ", "")
    return "" if text in parts else _untold(text, (subject, *parts))


def without_end(text: str, told: Collection[str]) -> str:
    """Return a text without its end after a colon where that is one of the sentences that were told already."""
    if isinstance(text, Message):
        for name, value in text.values.items():
            end = f": {{{name}}}"
            if value in told and text.template.endswith(end):
                return left_out(text, (name,))
        return text
    head, _, tail = text.partition(": ")
    return head if tail and tail in told else text


def _untold(message: Message, told: Collection[str]) -> Message:
    """A template about a subject begins with its field and a colon."""
    values = {name: _left(value, told) for name, value in message.values.items()}
    subjects = [
        name for name, value in message.values.items() if value in told and message.template.startswith(f"{{{name}}}: ")
    ]
    return left_out(Message(message.code, message.template, values, message.form), subjects)


def _left(value: Value, told: Collection[str]) -> Value:
    if isinstance(value, tuple):
        return tuple(_part(one, told) for one in value if one not in told)
    return _untold(value, told) if isinstance(value, Message) and value not in told else value


def _part(one: Value, told: Collection[str]) -> Value:
    if isinstance(one, Message) or not isinstance(one, str):
        return _left(one, told)
    for subject in told:
        one = one.removeprefix(f"{subject}: ")
    return one
