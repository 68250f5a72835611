"""A pressure that lags its command, or follows it after a dead time, by more than an I/P in good order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.command_loop import command_loop
from discrepancy.rough.causes.position_lag import LIMIT_S
from discrepancy.rough.causes.seen import InputCause, Seen, command_and_pressure_pa
from estimators.engine.force_path import through_command
from estimators.engine.rows import runs_between_gaps
from valve.messages import say
from valve.recording import Recording

_ROWS_S: Final = 0.004
_MOST_LEFT: Final = 0.006  # of the range, rms: what a gauge's noise and a hunting I/P leave beside lag and dead time
_SURE: Final = 2.0  # standard errors


@dataclass(frozen=True, slots=True)
class Delays:
    """Time constant and dead time of the pressure behind its command, s; 0 where a gauge's filter explains them."""

    lag: Fitted
    dead_time: Fitted


@lru_cache(maxsize=1)
def delays(recording: Recording) -> Delays | None:
    """Return how late the measured pressure follows its command; None without either, or where that explains it not."""
    command_pa, pressure_pa = recording.command_pa, recording.pressure_pa
    if command_pa is None or pressure_pa is None or command_and_pressure_pa(recording) is None:
        return None
    if command_loop(recording) is not None:
        return None
    known = np.flatnonzero(np.isfinite(command_pa) & np.isfinite(pressure_pa))
    period_s = float(np.median(np.diff(recording.time_s[known])))
    rows = known[:: max(1, round(_ROWS_S / period_s))]
    time_s = recording.time_s[rows]
    path = through_command(time_s, command_pa[rows], pressure_pa[rows], runs_between_gaps(time_s)[0])
    if float(np.std(path.left_n)) > _MOST_LEFT * float(np.ptp(pressure_pa[rows])):
        return None
    error_s = max(path.lag_error_s, 0.1 * period_s)
    return Delays(Fitted(path.lag_s, error_s, "s"), Fitted(path.dead_time_s, error_s, "s"))


def beyond_limit(known: Fitted) -> bool:
    """Whether a delay is surely longer than an I/P in good order has."""
    return known.value - _SURE * known.std_error > LIMIT_S


class TransducerLag(InputCause):
    """The pressure follows the command with a time constant."""

    name: ClassVar[str] = "transducer_lag"
    action: ClassVar[str] = say(
        "transducer_lag_action",
        "Look at the I/P's supply, its filter and the tubing; a booster fills a large actuator faster.",
    )

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the time constant where it is above the limit."""
        found = delays(recording)
        return Seen({"lag_s": found.lag}, None) if found is not None and beyond_limit(found.lag) else None

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "pressure_lags",
            "The pressure lags the command with a time constant of {lag}.",
            lag=fitted["lag_s"].in_words("ms"),
        )


class TransducerDeadTime(InputCause):
    """The pressure follows the command after a delay."""

    name: ClassVar[str] = "transducer_dead_time"
    action: ClassVar[str] = say(
        "transducer_dead_time_action", "Look for long or narrow tubing and for a device that writes late."
    )

    @override
    def seen_in(self, recording: Recording) -> Seen | None:
        """Return the dead time where it is above the limit."""
        found = delays(recording)
        return Seen({"delay_s": found.dead_time}, None) if found is not None and beyond_limit(found.dead_time) else None

    @override
    def told(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "pressure_follows_after",
            "The pressure follows the command after {delay}.",
            delay=fitted["delay_s"].in_words("ms"),
        )
