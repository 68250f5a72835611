"""The tablet's script: written by thing, sent as one file, so that a page has all of it or nothing."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

NAME: Final = "tablet.js"
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


@cache
def script() -> bytes:
    """Return all parts in one scope of their own."""
    parts = "\n".join((_FOLDER / f"{name}.js").read_text(encoding="utf-8") for name in PARTS)
    return f'"use strict";\n(() => {{\n{parts}}})();\n'.encode()
