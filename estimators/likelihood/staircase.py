"""A stem that only sticks and slips: the phases of its staircase, whose steps are too short to be motions else."""

from __future__ import annotations

from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.moving_rows import find_moving_rows, pieces_of
from estimators.phases import After, Phases, Stretch
from estimators.recorded_motion import RecordedMotion
from estimators.rests import Breakaway
from estimators.samples import Samples, prepare
from estimators.windowed_slope import windowed_slope
from valve.nameplate import Nameplate
from valve.recording import Recording

_AWAY_SIGMAS: Final = 5.0
_FEWEST_STEPS: Final = 2
_MOST_LEVEL_ROWS: Final = 100


def read_staircase(recording: Recording, nameplate: Nameplate) -> RecordedMotion | None:
    """Return the motion of a stem that rests between jumps, or None where it does not."""
    samples = prepare(recording, nameplate)
    if isinstance(samples, Outcome):
        return None
    moving = find_moving_rows(samples)
    if moving is None:
        return None
    stretches, breakaways = _steps(samples, pieces_of(samples, moving.sense))
    if len(breakaways) < _FEWEST_STEPS:
        return None
    phases = Phases(
        velocity=moving.velocity,
        half_window=moving.half_window,
        moving_speed=moving.usual_speed,
        stretches=tuple(stretches),
        breakaways=tuple(breakaways),
        corners=np.empty(0, dtype=np.int64),
        force_rate=windowed_slope(samples, samples.force_n, max(2, moving.half_window)),
    )
    return RecordedMotion(
        samples=samples,
        phases=phases,
        uniform=None,
        uniform_outcome=Outcome.NO_UNIFORM_MOTION,
        stops=None,
        action=nameplate.actuator.action,
        moving_mass_kg=nameplate.actuator.moving_mass_kg,
        command_only=recording.force_n is None and recording.pressure_pa is None,
    )


def _steps(samples: Samples, pieces: list[tuple[int, int, int]]) -> tuple[list[Stretch], list[Breakaway]]:
    """Jumps from one level to the next, to the row: the windows that found them are wider than they are."""
    stretches: list[Stretch] = []
    breakaways: list[Breakaway] = []
    away_m = _AWAY_SIGMAS * samples.position_noise_m + 1.0e-9 * float(np.ptp(samples.position_m))
    for before, jump, after in zip(pieces, pieces[1:], pieces[2:], strict=False):
        if before[2] != 0 or jump[2] == 0 or after[2] != 0:
            continue
        level_m = float(np.median(samples.position_m[max(before[0], before[1] - _MOST_LEVEL_ROWS) : before[1] + 1]))
        next_m = float(np.median(samples.position_m[after[0] : min(after[1], after[0] + _MOST_LEVEL_ROWS) + 1]))
        position_m = samples.position_m[jump[0] : jump[1] + 1]
        gone = np.flatnonzero(jump[2] * (position_m - level_m) > away_m)
        there = np.flatnonzero(np.abs(position_m - next_m) > away_m)
        if gone.size == 0:
            continue
        first = jump[0] + int(gone[0])
        last = max(first, jump[0] + int(there[-1])) if there.size else first
        if stretches and first <= stretches[-1].last:
            continue
        row = max(first - 1, before[0])
        stretches.append(Stretch(first, last, jump[2], After.BREAKAWAY, driven=True))
        half_step_s = 0.5 * float(samples.time_s[first] - samples.time_s[row])
        at_s = float(samples.time_s[row]) + half_step_s
        breakaways.append(Breakaway(row, jump[2], at_s, half_step_s, level_m))
    return stretches, breakaways
