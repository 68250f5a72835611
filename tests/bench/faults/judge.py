"""The verdict on one case, by the simulated valve's own record and never by what the service thinks of itself."""

from __future__ import annotations

import contextlib
import json
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.maps.reference import FULL_SCALE, MISSING_SAMPLE, WINDOW_ADDRESS, WINDOW_SAMPLES, WINDOW_WORDS
from drivers.motion.journal import read_journal
from drivers.stands_at import StemVerdict
from simulator.record import Happening
from tests.bench.faults.station import POSITION, PRESSURE, SAFE_M, SAFE_PA, TOLERANCE_M, Station
from tests.bench.faults.surroundings import ENDING, HEEDED_S, LAST_PAGE_S, STOPPED_S, TOLD_S
from tests.bench.faults.wire_faults import PlantFault
from valve.errors import RecordingError
from valve.recording import Acquisition, Recording
from valve.recording_files import read_recording

_MOTIONS: Final = (Happening.COMMANDED, Happening.CAPTURE_STARTED)
_SURE: Final = (StemVerdict.THERE, StemVerdict.NOT_THERE)
_CLOCK_S: Final = 0.01  # between the proxy's, the simulator's and the service's look at one clock
_OUTPUT_PA: Final = 100.0  # a thousandth of the range: what the driver itself takes for the same


@dataclass(slots=True)
class Verdict:
    """What went wrong, each a count that must be 0; ``outcome`` says in a word how the test ended."""

    outcome: str = ""
    unsafe: int = 0  # the valve does not stand at its safe value
    unreported: int = 0  # and nobody is told, or the test never ended
    lost_samples: int = 0
    wrong_values: int = 0
    late_writes: int = 0
    doubled_writes: int = 0
    unheeded: int = 0  # the motion went on for long after what must end it
    misjudged: int = 0  # what is said of signal or stem is not so
    broken_off: int = 0  # the service ended, what moves the valve did not, and the test did not complete
    detail: str = ""

    @property
    def good(self) -> bool:
        """Whether nothing went wrong."""
        return not any(getattr(self, f.name) for f in fields(self) if f.type == "int")


def told_by(path: Path) -> list[dict[str, Any]]:
    """What a service told the outside."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]


def judge(station: Station, told: list[dict[str, Any]], *, safe: bool) -> Verdict:
    """Judge a case that is over; ``safe``: whether the valve came to its safe value."""
    verdict = Verdict()
    ends = [line for line in told if line["kind"] == "end"]
    refused = [line for line in told if line["kind"] == "refused"]
    accepted = [line for line in told if line["kind"] == "accepted"]
    end = ends[-1] if ends else None
    verdict.outcome = "refused" if refused else "silent" if end is None else end["state"]
    verdict.detail = (refused or [end or {"error": ""}])[-1]["error"]
    if end is None and (accepted or not (refused or station.may_die_early)):
        verdict.unreported = 1  # also a service that died before it said anything, and was not killed
    if not safe:
        verdict.unsafe = 1
        verdict.unreported = int(end is None or end["safe_confirmed"] is not False)
    if end is not None:
        verdict.late_writes = sum(
            at_s > end["mono_s"] + _CLOCK_S and event.happening in _MOTIONS for at_s, event in station.events
        )
    verdict.unheeded = _unheeded(station, end)
    was_moving = any(at_s < station.struck_s and event.happening in _MOTIONS for at_s, event in station.events)
    if station.outlives_its_service and was_moving:
        verdict.broken_off = int(end is None or end["state"] != "completed")
    if safe and end is not None and end["safe_confirmed"] is False and station.around.fault is not None:
        verdict.misjudged = 1  # its own wire was well: the output could be read
    if end is not None and end["stem"] in _SURE and station.around.fault is not PlantFault.FLAPPING:
        is_there = abs(station.looks[-1][1] - SAFE_M) <= TOLERANCE_M
        verdict.misjudged += is_there != (end["stem"] == StemVerdict.THERE)
    verdict.doubled_writes = _doubled(station.wire.requests)
    store = station.plant_file.parent / "store"
    recording: Recording | None = None
    kept: set[float] = set()
    if accepted:
        path = store / "recordings" / f"{accepted[0]['id']}.parquet"
        if path.exists():
            with contextlib.suppress(RecordingError):  # nothing but gaps
                recording = read_recording(path)
                kept = set(recording.time_s.tolist())
        journal = store / "journals" / f"{accepted[0]['id']}.journal"
        if journal.exists():  # too little for a recording: it stays as it is
            with contextlib.suppress(RecordingError):  # killed before it had its first line
                kept |= set(read_journal(journal)[1][:, 0].tolist())
    if station.mode == "polled":
        blocks = [line for line in told if line["kind"] == "samples"]
        seen = [
            time_s
            for block in blocks
            for time_s, position_m in zip(block["time_s"], block["position_m"], strict=True)
            if position_m is not None  # a gap is no sample
        ]
        lost = [time_s for time_s in seen if not any(abs(time_s - one) < 2.0e-6 for one in kept)]
        verdict.lost_samples = len(lost)
        if lost:
            verdict.detail += f"; lost {lost}, kept {sorted(kept)}"
    if recording is not None and station.around.fault is not PlantFault.FLAPPING:  # there the sensor itself is wrong
        _judge_values(verdict, station, told, recording)
    return verdict


def _unheeded(station: Station, end: dict[str, Any] | None) -> int:
    """Whether the valve was driven for long after a fault that must end its test, or the end says nothing of it."""
    fault = station.around.fault
    if station.asked_to_end:
        return int(end is not None and end["state"] == "interrupted")
    if fault is PlantFault.STUCK_STEM or (fault is None and not station.is_watched):
        return 0  # a stem that sticks within a healthy dead band, nobody can see
    if fault is PlantFault.FULL_DISK and station.mode == "captured":  # nothing is written before the stroke is over
        return 0
    stopped = station.is_watched or fault is PlantFault.DARK_DATABASE
    driven_s = [at_s for at_s, _, _, asked_pa in station.looks if abs(asked_pa - SAFE_PA) > _OUTPUT_PA]
    after_s = max(driven_s, default=0.0) - station.struck_s  # minus infinity where the fault never came
    heeded_s = HEEDED_S + (LAST_PAGE_S if fault is PlantFault.FULL_DISK else 0.0)
    if after_s > (STOPPED_S if stopped else heeded_s):
        return 1
    return int(fault in ENDING and after_s > TOLD_S and end is not None and end["state"] == "completed")


def _doubled(requests: list[bytes]) -> int:
    """Motion writes that the service sent twice: one value after the other, but for the safe one; a second start."""
    commands, doubled, starts = [], 0, 0
    safe = np.array([SAFE_PA], dtype=">f4").tobytes()
    for frame in requests:
        write = frame.find(b"\x10\x00\x20\x00\x04\x08")  # function 16, the command's block
        if write >= 0:
            commands.append(frame[write + 6 : write + 14])
        begin = frame.find(b"\x10\x00\x34\x00\x09\x12")  # the capture's block
        starts += begin >= 0 and frame[begin + 10 : begin + 12] == b"\x00\x02"
    for before, after in pairwise(commands):
        doubled += before == after and after[4:] != safe
    return doubled + max(0, starts - 1)


def _judge_values(verdict: Verdict, station: Station, told: list[dict[str, Any]], recording: Recording) -> None:
    started = [line["start_s"] for line in told if line["kind"] == "waveform"]
    if station.mode == "polled" and started:
        verdict.wrong_values = _wrong_polled(station, recording, started[0])
    elif recording.provenance.acquisition is Acquisition.CAPTURED:
        verdict.wrong_values = _wrong_captured(station, recording)


def _wrong_polled(station: Station, recording: Recording, start_s: float) -> int:
    """Samples that no look of the device within the sample's own interval shows."""
    assert recording.sent_s is not None
    assert recording.received_s is not None
    at_s = [look[0] for look in station.looks]
    wrong = 0
    for i in range(recording.samples):
        if not np.isfinite(recording.position_m[i]):
            continue
        first = bisect_left(at_s, start_s + float(recording.sent_s[i]) - _CLOCK_S)
        last = bisect_right(at_s, start_s + float(recording.received_s[i]) + _CLOCK_S)
        wrong += not any(_fits(look, recording, i) for look in station.looks[first:last])
    return wrong


def _fits(look: tuple[float, float, float, float], recording: Recording, i: int) -> bool:
    pressure_pa, command_pa = recording.pressure_pa, recording.command_pa
    return (
        abs(look[1] - recording.position_m[i]) <= POSITION.resolution
        and (pressure_pa is None or abs(look[2] - pressure_pa[i]) <= PRESSURE.resolution)
        and (command_pa is None or not np.isfinite(command_pa[i]) or abs(look[3] - command_pa[i]) <= _OUTPUT_PA)
    )


def _wrong_captured(station: Station, recording: Recording) -> int:
    """Captured samples that differ from what the device itself keeps."""
    low_m, high_m = POSITION.span
    wrong = 0
    for first in range(0, recording.samples, WINDOW_SAMPLES):
        station.write(80, [first >> 16, first & 0xFFFF])
        words = station.read(WINDOW_ADDRESS, WINDOW_WORDS)
        rows = np.array(words[2:-1], dtype=np.float64).reshape(-1, 3)[: recording.samples - first]
        kept_m = low_m + (high_m - low_m) / FULL_SCALE * rows[:, 0]
        part = recording.position_m[first : first + len(rows)]
        missing = rows[:, 0] == MISSING_SAMPLE
        wrong += int(np.sum(np.isfinite(part) & (missing | (np.abs(part - kept_m) > POSITION.resolution))))
    return wrong
