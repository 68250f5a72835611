"""What happened in the simulated plant, with simulated times: for tests to judge by. Its memory is bounded."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Final, TextIO

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

MOST_EVENTS: Final = 20_000  # a valve; older ones are dropped
MOST_POSITIONS: Final = 4_096  # a valve: 128 KiB


class Happening(StrEnum):
    """What happened to a valve's device."""

    COMMANDED = "commanded"  # a command was written and counts
    FENCED = "fenced"  # a command was written by a run that does not own the device
    IGNORED = "ignored"  # a write was acknowledged and, by a fault, not executed
    REFUSED = "refused"  # a write was answered with an exception
    WRITTEN = "written"  # another register was written
    CAPTURE_STARTED = "capture_started"
    CAPTURE_ENDED = "capture_ended"
    CAPTURE_ABORTED = "capture_aborted"
    WATCHDOG_TRIPPED = "watchdog_tripped"
    OUTPUT_RESET = "output_reset"
    RESTARTED = "restarted"


@dataclass(frozen=True, slots=True)
class Event:
    """One event: the simulated time, and for a write the unit, the address, its words and the run that wrote."""

    time_s: float
    tag: str
    happening: Happening
    device_id: int | None = None
    address: int | None = None
    words: tuple[int, ...] = ()
    pressure_pa: float | None = None
    run: int | None = None


@dataclass(frozen=True, slots=True)
class Track:
    """What the plant was found to be at each look, all of shape (n,): simulated time, truth without any sensor."""

    time_s: FloatArray
    position_m: FloatArray
    pressure_pa: FloatArray
    asked_pa: FloatArray


class ValveRecord:
    """Events and positions of one valve; ``sink`` gets each event and each position as it happens."""

    def __init__(self, tag: str, *, events: int = MOST_EVENTS, positions: int = MOST_POSITIONS) -> None:
        self.tag = tag
        self.sink: Callable[[Event | tuple[float, float, float, float]], None] | None = None
        self._events: deque[Event] = deque(maxlen=events)
        self._positions = np.empty((positions, 4))
        self._looks = 0

    @property
    def events(self) -> tuple[Event, ...]:
        """All events that are kept, the oldest first."""
        return tuple(self._events)

    def add(self, event: Event) -> None:
        """Keep one event."""
        self._events.append(event)
        if self.sink is not None:
            self.sink(event)

    def look(self, time_s: float, position_m: float, pressure_pa: float, asked_pa: float) -> None:
        """Keep the plant's state at one look."""
        row = (time_s, position_m, pressure_pa, asked_pa)
        self._positions[self._looks % len(self._positions)] = row
        self._looks += 1
        if self.sink is not None:
            self.sink(row)

    @property
    def track(self) -> Track:
        """The states at the latest looks, the oldest first."""
        size = len(self._positions)
        if self._looks <= size:
            rows = self._positions[: self._looks].copy()
        else:
            rows = np.roll(self._positions, -(self._looks % size), axis=0)
        return Track(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3])


class RecordFile:
    """Writes events and positions as JSON lines, a position only where it differs from the one before."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._last: dict[str, tuple[float, float, float]] = {}

    def attach(self, record: ValveRecord) -> None:
        """Write what happens to this valve from now on."""

        def write(entry: Event | tuple[float, float, float, float]) -> None:
            self._write(record.tag, entry)

        record.sink = write

    def _write(self, tag: str, entry: Event | tuple[float, float, float, float]) -> None:
        if isinstance(entry, Event):
            line = {key: value for key, value in asdict(entry).items() if value is not None and value != ()}
        else:
            time_s, *state = entry
            position_m, pressure_pa, asked_pa = state
            if self._last.get(tag) == (position_m, pressure_pa, asked_pa):
                return
            self._last[tag] = (position_m, pressure_pa, asked_pa)
            line = {
                "time_s": time_s,
                "tag": tag,
                "position_m": position_m,
                "pressure_pa": pressure_pa,
                "asked_pa": asked_pa,
            }
        # A judge compares with other processes: by the machine's monotonic clock, and by the wall's.
        line |= {"monotonic_s": time.monotonic(), "wall": datetime.now(UTC).isoformat()}
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
