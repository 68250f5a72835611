"""Where a command's JSON goes: a file, or standard output for ``-``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

from valve.errors import RequestError
from valve.messages import say

STANDARD_OUTPUT: Final = "-"


def require_writable(target: str | None) -> None:
    """Raise RequestError where JSON cannot be written to ``target``: said before the work is done, not after."""
    if target is None or target == STANDARD_OUTPUT:
        return
    path = Path(target)
    if path.is_dir():
        raise RequestError(
            say(
                "json_needs_file",
                "{target}: it is a folder, the JSON needs a file: give a file name",
                target=str(target),
            )
        )
    if not path.parent.is_dir():
        raise RequestError(
            say(
                "no_folder",
                "{target}: there is no folder {parent}: make it, or give another file name",
                target=str(target),
                parent=str(path.parent),
            )
        )


def write_json(target: str, document: dict[str, Any]) -> None:
    """Write ``document`` to the file ``target``, or to standard output for ``-``. Raises RequestError."""
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    if target == STANDARD_OUTPUT:
        sys.stdout.write(text)
        return
    try:
        Path(target).write_text(text, encoding="utf-8")
    except OSError as error:
        raise RequestError(
            say(
                "output_unwritable",
                "{target}: it cannot be written ({reason}): give another file name",
                target=str(target),
                reason=str(error.strerror),
            )
        ) from None
