"""The coming night, as it will go if every test takes the time that its waveform takes."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from service.config.plant import Plant
from service.model.schedule import occurrences_between
from service.model.sequences import build_waveform

# Beside the waveform itself: reading the permissives, ramps to its start and to safe, upload of a capture. Own choice,
# twice what the simulated valves need.
_AROUND_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class PlannedCheck:
    """One valve that will be checked: due with its schedule, starting when the valves before it on its buses are done.

    They are when their stems were looked at. ``fits`` says whether that is within the schedule's window.
    """

    schedule: str
    valve: str
    gateway: str
    bus: str
    sequence: str
    due_at: datetime
    starts_at: datetime
    ends_at: datetime
    window_ends_at: datetime

    @property
    def fits(self) -> bool:
        """Whether the valve's turn comes before the window ends."""
        return self.starts_at <= self.window_ends_at


def plan_night(plant: Plant, after: datetime, until: datetime) -> list[PlannedCheck]:
    """Return what the schedules ask for after ``after`` and not after ``until``, in the order of the starts."""
    due = [
        (one.due_at, number, schedule)
        for number, schedule in enumerate(plant.schedules)
        for one in occurrences_between(schedule, after, until)
    ]
    free_at: dict[str, datetime] = {}
    planned = []
    for due_at, _, schedule in sorted(due, key=lambda one: one[:2]):
        for tag in schedule.valves:
            valve = plant.valves[tag]
            waveform = build_waveform(schedule.sequence, schedule.overrides, valve.nameplate, valve.wiring.limits)
            starts_at = max([due_at, *(free_at[bus] for bus in valve.buses if bus in free_at)])
            ends_at = starts_at + timedelta(seconds=waveform.duration_s + _AROUND_S)
            window_ends_at = due_at + timedelta(seconds=schedule.window_s)
            check = PlannedCheck(
                schedule.name,
                tag,
                plant.gateway_of(tag),
                valve.wiring.command.bus,
                schedule.sequence,
                due_at,
                starts_at,
                ends_at,
                window_ends_at,
            )
            planned.append(check)
            if check.fits:
                looked_at = ends_at + timedelta(seconds=valve.wiring.rest.after_s)
                free_at |= dict.fromkeys(valve.buses, looked_at)
    return sorted(planned, key=lambda check: (check.starts_at, check.bus))
