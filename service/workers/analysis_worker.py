"""The analysis process: takes one job a line on standard input, answers in lines on standard output, until it closes.

A job is ``{"recordings": [...], "held_out": [[name, file], ...], "nameplate": {...}, "accepted": {...} | null,
"room": {...} | null, "most_rows": 2000000 | null, "most_memory_bytes": ... | null, "mapping": {...} | null}``:
``most_rows`` and ``most_memory_bytes`` bound what an upload may take; with a mapping, also an empty one, the recordings
are files as their owners have them (``service.own_files``). A job ``{"watched": FILE, "nameplate": {...}}`` is a day
of a valve in service.
Answers are ``{"ready": true}`` once everything is compiled, ``{"progress": 0.4, "phase": "..."}``,
``{"estimated": {...}}`` (the analysis before it is diagnosed), and at last ``{"analysis": {...}}`` or
``{"error": "RecordingError", "message": "..."}``. Any other failure ends the process with its traceback on standard
error; its owner starts another.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
from pathlib import Path
from typing import Any, TextIO

from service.analysis.analysis import analyze_recordings
from service.config.nameplates import nameplate_from_mapping
from service.own_files.understood import Reading, with_understood
from service.workers.priority import end_with_parent
from service.workers.warm_up import warm_up
from valve.errors import RecordingError, ValveError
from valve.messages import message_of, say, with_table
from valve.nameplate import Nameplate
from valve.recording_files import read_recording


def main() -> None:
    """Work until standard input closes."""
    end_with_parent()
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
        _answer(answers, with_table({"progress": share, "phase": phase}))

    def keep(analysis: dict[str, Any]) -> None:
        _answer(answers, {"estimated": with_table(analysis)})

    try:
        nameplate = nameplate_from_mapping(job["nameplate"], "nameplate")
        if "watched" in job:
            _answer(answers, {"analysis": with_table(_judged(Path(job["watched"]), nameplate))})
            return
        _bound_memory(job["most_memory_bytes"])
        left, mapping = job["most_rows"], job["mapping"]
        read: list[Reading] = []
        for path in (*job["recordings"], *(path for _, path in job["held_out"])):
            read.append(_read(path, nameplate, mapping, left))
            left = None if left is None else left - read[-1].recording.samples
        readings = read[: len(job["recordings"])]
        tried = [(name, one) for (name, _), one in zip(job["held_out"], read[len(readings) :], strict=True)]
        analysis = analyze_recordings(
            [one.recording for one in readings],
            nameplate,
            held_out=[(name, one.recording) for name, one in tried],
            accepted=job["accepted"],
            room=job["room"],
            progress=progress,
            keep=keep,
        )
        _answer(answers, {"analysis": with_table(with_understood(analysis, read))})
    except ValveError as error:
        _answer(answers, with_table({"error": type(error).__name__, "message": message_of(error)}))
    except MemoryError:
        if job["most_memory_bytes"] is None:
            raise
        said = say(
            "needs_more_memory",
            "the recordings need more than {most:g} GB of memory: send fewer samples",
            most=job["most_memory_bytes"] / 1e9,
        )
        _answer(answers, with_table({"error": RecordingError.__name__, "message": said}))


def _judged(path: Path, nameplate: Nameplate) -> dict[str, Any]:
    from service.watching.day import judge_day  # noqa: PLC0415  - most plants watch no valve

    try:
        return judge_day(path, nameplate).to_json()
    except OSError as error:
        raise RecordingError(
            say(
                "day_on_disk_unreadable",
                "{file}: it cannot be read ({why}): look at the disk",
                file=path.name,
                why=error.strerror or message_of(error),
            )
        ) from error


def _read(path: str, nameplate: Nameplate, mapping: dict[str, str] | None, most_rows: int | None) -> Reading:
    if mapping is None:
        return Reading(read_recording(Path(path), nameplate, most_rows=most_rows))
    from service.own_files.reader import read_own  # noqa: PLC0415  - most jobs need none of its libraries

    return read_own(path, nameplate, mapping, most_rows=most_rows)


def _bound_memory(most_bytes: int | None) -> None:
    """Let this process take no more memory than it has now and ``most_bytes``: a file may unpack to any size."""
    if most_bytes is None:
        return
    own = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (own + most_bytes, hard))


def _answer(answers: TextIO, message: dict[str, Any]) -> None:
    answers.write(json.dumps(message, allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
