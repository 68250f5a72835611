"""The languages that people read, and what each says where English says something: one catalogue (PO file) a language.

A message is looked up by its code, a text of a page by its English words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final

import polib

from valve.messages import Message

_HERE: Final = Path(__file__).parent
#: The code of messages that are a name of data, which is looked up as a text.
NAME: Final = "name"


class Language(StrEnum):
    """What a person chose to read."""

    ENGLISH = "en"
    GERMAN = "de"

    @property
    def label(self) -> str:
        """What the switch calls it: its own name of itself."""
        return {"en": "English", "de": "Deutsch"}[self.value]

    @classmethod
    def of(cls, name: str | None) -> Language | None:
        """Return the language of this name; None for any other."""
        return cls(name) if name in list(cls) else None

    @classmethod
    def wished(cls, header: str | None) -> Language:
        """Return the language that an ``Accept-Language`` header likes best, English where it names none of ours."""
        best, best_weight = cls.ENGLISH, 0.0
        for one in (header or "").split(","):
            name, _, weight_text = one.strip().partition(";q=")
            language, weight = cls.of(name.strip().lower().partition("-")[0]), _weight(weight_text)
            if language is not None and weight > best_weight:
                best, best_weight = language, weight
        return best


@dataclass(frozen=True, slots=True)
class Catalogue:
    """What a language says: ``messages`` by code as (English, own) templates, ``texts`` by their English words."""

    messages: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)

    def template(self, message: Message) -> str:
        """Return a message's template; the English one where it is of another time than the catalogue."""
        if message.code == NAME:
            return self.text(message.template)
        english, own = self.messages.get(message.code, ("", ""))
        return own if own and english == message.template else message.template

    def text(self, english: str) -> str:
        """Return what a page says."""
        return self.texts.get(english, english)


@cache
def catalogue(language: Language) -> Catalogue:
    """Return the catalogue of a language; English has none of its own."""
    path = path_of(language)
    if path is None:
        return Catalogue()
    done = [one for one in polib.pofile(str(path)) if one.msgstr and not one.obsolete and not one.fuzzy]
    return Catalogue(
        {one.msgctxt: (one.msgid, one.msgstr) for one in done if one.msgctxt},
        {one.msgid: one.msgstr for one in done if not one.msgctxt},
    )


def path_of(language: Language) -> Path | None:
    """Return the file of a language's catalogue, None for English."""
    return None if language is Language.ENGLISH else _HERE / f"{language.name.lower()}.po"


def _weight(text: str) -> float:
    try:
        return float(text or 1.0)
    except ValueError:
        return 0.0
