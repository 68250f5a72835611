"""Samples of valves that nobody watches any more: they go a week after that was seen first, never at once."""

from __future__ import annotations

from collections.abc import Collection
from datetime import date, timedelta
from pathlib import Path
from typing import Final

import structlog

from drivers.motion.watch_file import SUFFIX, folder_of

_LOG = structlog.get_logger(__name__)
_KEPT: Final = timedelta(days=7)
_NOTE: Final = "not-watched-since"  # a file with that day: a plant file that lacks a valve by mistake costs no samples


def tidy_left(folder: Path, watched: Collection[str], unjudged: Collection[Path], today: date) -> None:
    """Remove the samples in ``folder`` of valves that are not ``watched``, where their week is over. Blocks.

    Files that are still to be judged stay.
    """
    kept = {folder_of(folder, tag) for tag in watched}
    for home in sorted(folder.iterdir()) if folder.is_dir() else ():
        if not home.is_dir():
            continue
        try:
            if home in kept:
                (home / _NOTE).unlink(missing_ok=True)
            elif today - _since(home / _NOTE, today) > _KEPT:
                _remove(home, unjudged)
        except OSError as error:
            _LOG.warning("samples of a valve that is not watched not removed", folder=home.name, error=str(error))


def _since(note: Path, today: date) -> date:
    """Return since when a valve is not watched, and note it where that is new, or lies ahead of the clock."""
    try:
        since = date.fromisoformat(note.read_text(encoding="ascii"))
    except (FileNotFoundError, ValueError):
        since = date.max
    if since > today:
        note.write_text(today.isoformat(), encoding="ascii")
        return today
    return since


def _remove(home: Path, unjudged: Collection[Path]) -> None:
    for path in home.glob(f"*{SUFFIX}*"):
        if path not in unjudged:
            path.unlink(missing_ok=True)
    if [path.name for path in home.iterdir()] == [_NOTE]:
        (home / _NOTE).unlink()
        home.rmdir()
