"""The actuator force where only the command was recorded: through an I/P with a lag and a dead time to be fitted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.command_steps import stair_corners, within_signal, written_steps
from estimators.likelihood.lag_kernel import lagged
from estimators.likelihood.nuisance import Nuisance
from estimators.likelihood.pressure_lines import Corners, KnownCorners, Stretch, find_stretches, held_together
from estimators.samples import FloatArray
from valve.nameplate import Nameplate
from valve.recording import Recording

_TOLERANCE: Final = 1.0e-6  # of the span: what the straight lines leave an exponential by
_LONGEST_S: Final = 5.0
_ROWS_A_STEP: Final = 4  # a ramp that is played in steps: each is real, and the lag rounds it
# An I/P with a small volume behind it; the fit starts from here where nothing better is known.
_LAG_START_S: Final = 0.1
_DEAD_TIME_START_S: Final = 0.02
_SCALE_S: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class TransducerPath:
    """The actuator force that a command gives: T P' = u(t - dead time) - P, times the diaphragm's area.

    The command is known; what is not are the nuisances ``transducer_lag_s`` (T) and ``transducer_dead_time_s``. On
    ramps of one rate r both delay the force alike, by T + dead time, and the delay times r adds to F_c and F_s:
    several rates, steps or holds tell them apart. ``stretches`` are of the command, as a force; after a break the
    pressure is taken to have settled. ``breaks_s`` as of ``MeasuredPath``. Lines leave the exponentials by at most
    1e-6 of the span.
    """

    stretches: tuple[Stretch, ...]
    nuisances: tuple[Nuisance, ...]
    breaks_s: FloatArray
    span_n: float

    def corners(self, values: FloatArray) -> Corners:
        """Corner times, s, and force, N, shape (n,), for this lag and dead time, both s."""
        lag_s, dead_time_s = float(values[0]), float(values[1])
        parts = [stretch.corners() for stretch in self.stretches]
        if lag_s > 0.0:
            parts = [lagged(time_s, asked_n, float(asked_n[0]), lag_s, self.tolerance_n) for time_s, asked_n in parts]
        time_s, force_n = held_together(parts, self.breaks_s, _LONGEST_S + _DEAD_TIME_START_S)
        return time_s + dead_time_s, force_n

    @property
    def tolerance_n(self) -> float:
        """What a line may leave an exponential by, N."""
        return _TOLERANCE * self.span_n

    def variations(self, values: FloatArray) -> Iterator[Corners]:  # noqa: ARG002 - as all input paths
        """Nothing: the command is known."""
        return iter(())


def transducer_path(recording: Recording, nameplate: Nameplate, asked_n: FloatArray) -> TransducerPath | Outcome:
    """Return the force that a recorded command gives; ``asked_n``, shape (n,), is the command times the area.

    A ramp that is played in steps of at least 4 rows stays a staircase, which the lag rounds, and so does one that was
    polled, whose rows are its writes; another one of shorter steps, or of a converter's, becomes its line. The command
    is cut off where the nameplate's signal ends and an I/P saturates: at 3.8 and 20.5 mA of a 4 to 20 mA signal.
    """
    followed_n = within_signal(asked_n, nameplate)
    found = find_stretches(recording, followed_n, _ROWS_A_STEP)
    if isinstance(found, Outcome):
        return found
    stretches, breaks_s, _ = found
    steps = written_steps(recording, followed_n)
    if steps is not None:
        stretches = (KnownCorners(*stair_corners(steps.step_s, steps.level_n, float(recording.time_s[-1]))),)
        breaks_s = np.empty((0, 2))
    period_s = recording.sample_period_s
    nuisances = (
        Nuisance("transducer_lag_s", _LAG_START_S, _SCALE_S, 0.0, _LONGEST_S, float("inf")),
        # the command's own time stamps may be late by up to a period
        Nuisance("transducer_dead_time_s", _DEAD_TIME_START_S, _SCALE_S, -period_s, _LONGEST_S, float("inf")),
    )
    return TransducerPath(stretches, nuisances, breaks_s, float(np.nanmax(asked_n) - np.nanmin(asked_n)))
