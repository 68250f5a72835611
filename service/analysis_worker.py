"""The analysis process: takes one job a line on standard input, answers in lines on standard output, until it closes.

A job is ``{"recordings": [...], "held_out": [[name, file], ...], "nameplate": {...}, "accepted": {...} | null,
"room": {...} | null}``.
Answers are ``{"ready": true}`` once everything is compiled, ``{"progress": 0.4, "phase": "..."}``,
``{"estimated": {...}}`` (the analysis before it is diagnosed), and at last ``{"analysis": {...}}`` or
``{"error": "RecordingError", "message": "..."}``. Any other failure ends the process with its traceback on standard
error; its owner starts another.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any, TextIO

from service.analysis import analyze_recordings
from service.nameplates import nameplate_from_mapping
from service.warm_up import warm_up
from valve.errors import ValveError
from valve.recording_files import read_recording


def main() -> None:
    """Work until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches the whole group: the owner decides
    with os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8") as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
        warm_up()
        # the owner may be gone: then there is nobody left to tell
        with contextlib.suppress(BrokenPipeError):
            _answer(answers, {"ready": True})
            for line in sys.stdin:
                _work(json.loads(line), answers)


def _work(job: dict[str, Any], answers: TextIO) -> None:
    def progress(share: float, phase: str) -> None:
        _answer(answers, {"progress": share, "phase": phase})

    def keep(analysis: dict[str, Any]) -> None:
        _answer(answers, {"estimated": analysis})

    try:
        nameplate = nameplate_from_mapping(job["nameplate"], "nameplate")
        recordings = [read_recording(Path(path), nameplate) for path in job["recordings"]]
        held_out = [(name, read_recording(Path(path), nameplate)) for name, path in job["held_out"]]
        analysis = analyze_recordings(
            recordings,
            nameplate,
            held_out=held_out,
            accepted=job["accepted"],
            room=job["room"],
            progress=progress,
            keep=keep,
        )
        _answer(answers, {"analysis": analysis})
    except ValveError as error:
        _answer(answers, {"error": type(error).__name__, "message": str(error)})


def _answer(answers: TextIO, message: dict[str, Any]) -> None:
    answers.write(json.dumps(message, allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
