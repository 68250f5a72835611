"""Sentences put together and taken apart: a message (``valve.messages``) stays one, and so does a text."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from typing import Final

from valve.messages import Message, Value, formed, joined, left_out, parts_of, say

#: How a verdict without a fault is said; what follows it says how friction varies.
NO_FAULT: Final = say("no_fault_found", "No fault found.")
_SENTENCE_END: Final = re.compile(r"(?<=\.) (?=[A-Z])")  # of texts that are no messages


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
