"""The tablet's script: written by thing, sent as one file, so that a page has all of it or nothing."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Final

from service.words.languages import Language, catalogue
from service.words.names import NAMES

_FOLDER: Final = Path(__file__).parent / "script_parts"
#: In the order in which they use each other.
PARTS: Final = (
    "requests",
    "connection",
    "forms",
    "permissives",
    "start",
    "stop",
    "estimates",
    "live",
    "signature",
    "recordings",
    "valves",
    "begin",
)


#: Where a part says something, in quotes: ``t("The connection is back.")``.
_SAID: Final = re.compile(r"""\bt\(("(?:[^"\\]|\\.)*")""")
_NAMES: Final = {language: f"tablet.{language.value}.js" for language in Language}


def script_name(language: Language) -> str:
    """Return the file name of the script in a language."""
    return _NAMES[language]


def script_language(name: str) -> Language | None:
    """Return the language of the script with this file name; None for any other file."""
    return next((language for language, own in _NAMES.items() if own == name), None)


def sentences() -> list[str]:
    """Return what the parts say, in English, in their order."""
    return list(dict.fromkeys(json.loads(one) for one in _SAID.findall(_parts())))


@cache
def script(language: Language) -> bytes:
    """Return all parts in one scope of their own, with what they say in a language."""
    said = catalogue(language)
    words = {english: said.text(english) for english in (*sentences(), *NAMES)}
    listed = json.dumps({english: own for english, own in words.items() if own != english}, ensure_ascii=False)
    return f'"use strict";\n(() => {{\nconst WORDS = {listed};\n{_parts()}}})();\n'.encode()


def _parts() -> str:
    return "\n".join((_FOLDER / f"{name}.js").read_text(encoding="utf-8") for name in PARTS)
