"""The command line called in the test's own process: what a command loads is loaded once, not for each call.

Code, output and error output are those of ``breakaway``. Signals, and what is loaded when, need a process of its own.
"""

from __future__ import annotations

import contextlib
import io
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from service.cli import main


@dataclass(frozen=True, slots=True)
class Called:
    """How a command ended, with what it wrote; the names are those of subprocess.CompletedProcess."""

    returncode: int
    stdout: str
    stderr: str


def called(*arguments: str, folder: Path | None = None, columns: int = 80) -> Called:
    """Call ``breakaway`` with these arguments in a folder (by default the current one), its output so wide."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder or Path.cwd()),
        mock.patch.object(sys, "argv", ["breakaway", *arguments]),
        mock.patch.dict("os.environ", COLUMNS=str(columns)),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        return Called(_code(), out.getvalue(), err.getvalue())


def _code() -> int:
    try:
        main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0
