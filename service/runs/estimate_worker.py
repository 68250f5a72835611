"""The process that estimates what running tests show so far (its owner: ``service.runs.live_estimates``).

A job is ``{"journal": "...", "nameplate": {...}}``, its answer ``{"so_far": {...} | null}``; otherwise as
``service.workers.analysis_worker``. It is a process of its own, as an analysis takes 20 s of its worker and an
estimate 0.1 s.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any, TextIO

from drivers.motion.journal import recording_from_journal
from service.config.nameplates import nameplate_from_mapping
from service.runs.so_far import estimate_so_far
from service.workers.priority import end_with_parent
from valve.errors import ValveError
from valve.motion import simulate_waveform
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import Recording
from valve.waveform import triangle


def main() -> None:
    """Work until standard input closes."""
    end_with_parent()
    with os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8") as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no answer
        _warm_up()
        with contextlib.suppress(BrokenPipeError):  # the owner may be gone: then there is nobody left to tell
            _answer(answers, {"ready": True})
            for line in sys.stdin:
                _answer(answers, {"so_far": _so_far(json.loads(line))})


def _so_far(job: dict[str, Any]) -> dict[str, Any] | None:
    try:
        recording = recording_from_journal(Path(job["journal"]))
        if recording is None:
            return None
        return estimate_so_far(recording, nameplate_from_mapping(job["nameplate"], "nameplate"))
    except (OSError, ValveError):  # the test has ended and its journal is gone, or it shows nothing yet
        return None


def _warm_up() -> None:
    """Estimate a short simulated test, so that what is compiled at first use is there."""
    valve = PARAMETER_SETS["nominal"]
    area_m2 = valve.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    waveform = triangle(4.0, 2, 0.0, 82737.0)
    motion = simulate_waveform(valve.parameters, waveform, area_m2, 0.02)
    recording = Recording(motion.time_s, motion.position_m, pressure_pa=waveform.at(motion.time_s))
    estimate_so_far(recording, valve.nameplate)


def _answer(answers: TextIO, message: dict[str, Any]) -> None:
    answers.write(json.dumps(message, allow_nan=False) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
