"""The actuator force where only the command was recorded: through an I/P with a lag and a dead time to be fitted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.inputs.command_gaps import over_gaps
from estimators.likelihood.inputs.command_steps import stair_corners, within_signal, written_steps
from estimators.likelihood.inputs.nuisance import Nuisance
from estimators.likelihood.inputs.pressure_lines import held_together
from estimators.likelihood.lines.stretches import Corners, KnownCorners, Stretch, find_stretches
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray, position_noise
from valve.nameplate import Nameplate
from valve.recording import Recording

LAG: Final = "transducer_lag_s"
DEAD_TIME: Final = "transducer_dead_time_s"
_TOLERANCE: Final = 1.0e-7  # of the span: what the straight lines leave an exponential by, and no less than
_TREAD_TOLERANCE: Final = 1.0e-6  # likewise of a staircase's treads
_OF_THE_MEAN: Final = 0.3  # of the error of the mean of all rows, as a share of the travel
_OF_THE_NOISE: Final = 0.05  # of the position's noise, likewise
_LARGEST_TOLERANCE: Final = 1.0e-4
_COARSER: Final = 4.0  # times: half as many lines
_LONGEST_S: Final = 5.0
_OF_A_TREAD: Final = 0.25  # as the most: the answer to a step that is over before the next
_STEP: Final = 0.02  # of a tread: what a shorter lag gives is a step, later by the lag
_MANY_STEPS: Final = 50
_ROWS_A_STEP: Final = 4  # a ramp that is played in steps: each is real, and the lag rounds it
_CHANGES_A_CORNER: Final = 10  # as many rows at uneven times do not meet a line by chance
# An I/P with a small volume behind it; the fit starts from here where nothing better is known.
_LAG_START_S: Final = 0.1
_DEAD_TIME_START_S: Final = 0.02
_SCALE_S: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class TransducerPath:
    """The actuator force that a command gives: T P' = u(t - dead time) - P, times the diaphragm's area.

    The command is known; what is not are the nuisances ``transducer_lag_s`` (T) and ``transducer_dead_time_s``. On
    ramps of one rate r both delay the force alike, by T + dead time, and the delay times r adds to F_c and F_s:
    several rates, steps or holds tell them apart. ``stretches`` are of the command, as a force; a gap that its lines
    go on through is none; after a break the pressure is taken to have settled. ``breaks_s`` as of ``MeasuredPath``.
    Lines leave the exponentials by less than the position shows.
    """

    stretches: tuple[Stretch, ...]
    nuisances: tuple[Nuisance, ...]
    breaks_s: FloatArray
    span_n: float
    tolerance: float = _TOLERANCE
    tread_tolerance: float = _TOLERANCE

    def corners(self, values: FloatArray) -> Corners:
        """Corner times, s, and force, N, shape (n,), for this lag and dead time, both s."""
        lag_s, dead_time_s = float(values[0]), float(values[1])
        parts = [stretch.corners() for stretch in self.stretches]
        if lag_s > 0.0:
            parts = [self._lagged(time_s, asked_n, lag_s) for time_s, asked_n in parts]
        time_s, force_n = held_together(parts, self.breaks_s, _LONGEST_S + _DEAD_TIME_START_S, settled=True)
        return time_s + dead_time_s, force_n

    def _lagged(self, time_s: FloatArray, asked_n: FloatArray, lag_s: float) -> Corners:
        """The answer to one stretch; that to a staircase's steps is drawn no finer than the stem could show it."""
        tolerance_n = self.tolerance_n
        is_step = (np.diff(time_s) == 0.0) & (np.diff(asked_n) != 0.0)
        if np.count_nonzero(is_step) >= _MANY_STEPS:
            tread_s = float(np.median(np.diff(time_s[1:][is_step])))
            tread_n = float(np.median(np.abs(np.diff(asked_n)[is_step])))
            if lag_s < _STEP * tread_s:
                return np.concatenate([time_s[:1], time_s[1:] + lag_s]), asked_n
            coarse_n = self.tread_tolerance * self.span_n
            wide_n = coarse_n * max(1.0, tread_s / lag_s)
            tolerance_n = min(wide_n, max(_OF_A_TREAD * tread_n, coarse_n))
        return lagged(time_s, asked_n, float(asked_n[0]), lag_s, tolerance_n)

    def with_fewer_corners(self, values: FloatArray, most: int) -> TransducerPath:
        """Return the path whose lines are as coarse as leaves about ``most`` corners, for a search."""
        path = self
        while path.tolerance < _LARGEST_TOLERANCE and path.corners(values)[0].size > most:
            path = replace(path, tolerance=_COARSER * path.tolerance)
        return path

    @property
    def tolerance_n(self) -> float:
        """What a line may leave an exponential by, N."""
        return self.tolerance * self.span_n

    def variations(self, values: FloatArray) -> Iterator[Corners]:  # noqa: ARG002 - as all input paths
        """Nothing: the command is known."""
        return iter(())


def transducer_path(recording: Recording, nameplate: Nameplate, asked_n: FloatArray) -> TransducerPath | Outcome:
    """Return the force that a recorded command gives; ``asked_n``, shape (n,), is the command times the area.

    A ramp that is played in steps of at least 4 rows stays a staircase, which the lag rounds, and so does one that was
    polled, whose rows are its writes; another one of shorter steps, or of a converter's, becomes its line, and so does
    one that was read from a line, whatever polled it. The command is cut off where the nameplate's signal ends and an
    I/P saturates: at 3.8 and 20.5 mA of a 4 to 20 mA signal.
    """
    followed_n = within_signal(asked_n, nameplate)
    found = find_stretches(recording, followed_n, _ROWS_A_STEP)
    if isinstance(found, Outcome):
        return found
    stretches, breaks_s, _ = found
    steps = written_steps(recording, followed_n)
    if steps is not None and not _is_read(recording, followed_n, stretches):
        stretches = (KnownCorners(*stair_corners(steps.step_s, steps.level_n, float(recording.time_s[-1]))),)
        breaks_s = np.empty((0, 2))
    period_s = recording.sample_period_s
    stretches, breaks_s = over_gaps(stretches, breaks_s, period_s)
    nuisances = (
        Nuisance(LAG, _LAG_START_S, _SCALE_S, 0.0, _LONGEST_S, float("inf")),
        # the command's own time stamps may be late by up to a period
        Nuisance(DEAD_TIME, _DEAD_TIME_START_S, _SCALE_S, -period_s, _LONGEST_S, float("inf")),
    )
    span_n = float(np.nanmax(asked_n) - np.nanmin(asked_n))
    return TransducerPath(stretches, nuisances, breaks_s, span_n, *_tolerances(recording, nameplate.actuator.travel_m))


def _is_read(recording: Recording, asked_n: FloatArray, stretches: tuple[Stretch, ...]) -> bool:
    """Whether a polled command, shape (n,), N, was read at its rows' times from a signal that runs on between them.

    A command that is written is computed before its row, now sooner and now later: on lines of the rows' own uneven
    times it does not lie to rounding. Where the requests' times are recorded the rows are our writes.
    """
    if recording.sent_s is not None or recording.is_evenly_sampled:
        return False
    if not all(isinstance(stretch, KnownCorners) for stretch in stretches):
        return False
    changes = int(np.count_nonzero(np.diff(asked_n[np.isfinite(asked_n)])))
    return changes > _CHANGES_A_CORNER * sum(stretch.corners()[0].size for stretch in stretches)


def _tolerances(recording: Recording, travel_m: float) -> tuple[float, float]:
    """What a line may leave an exponential by, of the span: after a ramp's corner, and within a staircase's treads.

    What is missed at a corner all jumps of the ramp after it keep, so that all rows together show it; each tread has
    its own.
    """
    present = np.isfinite(recording.position_m)
    runs = np.zeros(int(present.sum()), dtype=np.int64)
    noise_m = position_noise(recording.time_s[present], recording.position_m[present], runs)
    of_all_rows = _OF_THE_MEAN * noise_m / travel_m / math.sqrt(max(runs.size, 1))
    of_a_row = _OF_THE_NOISE * noise_m / travel_m
    return (
        float(np.clip(of_all_rows, _TOLERANCE, _LARGEST_TOLERANCE)),
        float(np.clip(of_a_row, _TREAD_TOLERANCE, _LARGEST_TOLERANCE)),
    )
