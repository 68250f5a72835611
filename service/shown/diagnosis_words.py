"""What every edge says of a diagnosis in the same words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from service.words.names import named
from service.words.sentences import NO_FAULT, sentences_of
from valve.messages import Message, say

UNEXPLAINED: Final = say("unexplained_by_catalogue", "Something is there that no cause of the catalogue explains.")


def plain_cause(name: str) -> Message:
    """Return what people call a cause, ``local friction``."""
    return named(name)


def beside_no_fault(message: str) -> list[str]:
    """Return the sentences of a verdict's message beside ``NO_FAULT``, which the headline says."""
    if isinstance(message, Message) and message.code == "no_fault":
        return [value for value in message.values.values() if isinstance(value, str)]
    return [sentence for sentence in sentences_of(message) if sentence != NO_FAULT]


def cause_line(cause: Mapping[str, Any], name: str) -> Message:
    """Return a cause by its name, with its sentence and what to do."""
    return say(
        "cause_and_remedy",
        "{cause}: {sentence} What to do: {action}",
        cause=name,
        sentence=cause["sentence"],
        action=cause["action"],
    )


def seen_without_matter(sentence: str) -> Message:
    """Return what is said of a cause that was seen and does not matter yet."""
    return say("seen_does_not_matter", "Seen, does not matter yet: {sentence}", sentence=sentence)


def to_tell_apart(sentence: str) -> Message:
    """Return what is said of the test that tells causes apart."""
    return say("to_tell_apart", "To tell them apart: {sentence}", sentence=sentence)
