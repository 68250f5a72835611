"""Files that are there whole or not at all, also after a power cut."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")


def sync_file(path: Path) -> None:
    """Force a file's or a folder's content onto the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_atomically(path: Path, write: Callable[[Path], Result]) -> Result:
    """Let ``write`` fill a neighbour of ``path``, force it onto the disk and rename it; return what it returned.

    ``write`` gets a path with the same suffix in the same folder. Whatever it raises leaves ``path`` as it was.
    """
    draft = path.with_name(f".draft-{path.name}")
    try:
        result = write(draft)
        sync_file(draft)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    sync_file(path.parent)
    return result
