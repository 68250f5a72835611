"""The actuator force of a polled test: the staircase of its commands behind the I/P that its pressure shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from estimators.likelihood.inputs.command_steps import stair_corners, within_signal, write_lead_s, written_steps
from estimators.likelihood.inputs.nuisance import Nuisance
from estimators.likelihood.inputs.pressure_lines import delay_prior_s
from estimators.likelihood.inputs.row_timing import look_doubts_s
from estimators.likelihood.inputs.stair_kernel import stair_answer
from estimators.likelihood.inputs.transducer_fit import TransducerFit, fit_transducer
from estimators.likelihood.lines.stretches import Corners
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray
from valve.nameplate import Nameplate
from valve.recording import Recording

_TOLERANCE: Final = 3.0e-6  # of the span: what a line may leave a lag's answer by that lasts for a whole tread
_OF_A_TREAD: Final = 0.03  # as the most: one that is over long before the next step
_STEP: Final = 0.02  # of a tread: what a shorter lag gives is a step, later by the lag
_DELAY_PERIODS: Final = 5.0
_DELAY_S: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class CommandedPath:
    """The actuator force gain u(t - dead time) + offset behind a first-order lag; u is the commands' staircase.

    ``delay`` is of the position against this force. It is known as well as the position is to the pressure and the
    pressure to the command: without a lag the pressure tells of the dead time only that it is below a period.
    ``noise_n``: what the fit leaves of the pressure. ``write_doubt_s``, shape (k,), is one standard deviation of each
    step's instant, 0 where the recording does not say when it was written. ``breaks_s`` is empty: a command holds until
    the next.
    """

    step_s: FloatArray
    level_n: FloatArray
    last_s: float
    fit: TransducerFit
    delay: Nuisance
    noise_n: float
    breaks_s: FloatArray
    write_doubt_s: FloatArray
    is_stepped: bool = field(init=False)  # the force steps at each write, without a lag that is seen
    _plain: Corners = field(init=False)  # before the dead time

    def __post_init__(self) -> None:
        stepped = self.fit.lag_s < _STEP * float(np.median(np.diff(self.step_s)))
        object.__setattr__(self, "is_stepped", stepped)
        object.__setattr__(self, "_plain", self._drawn(self.fit.linear))

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """The delay of the position against the force."""
        return (self.delay,)

    def rewritten(self, late_s: FloatArray) -> CommandedPath:
        """Return the path of writes that are later by ``late_s``, shape (k,); none overtakes the next."""
        return replace(self, step_s=np.maximum.accumulate(self.step_s + late_s))

    def corners(self, values: FloatArray) -> Corners:
        """Corner times, s, and force, N, shape (n,), for this delay."""
        time_s, force_n = self._plain
        return self._led(time_s + self.fit.dead_time_s + float(values[0]), force_n)

    def variations(self, values: FloatArray) -> Iterator[Corners]:
        """Corners changed by one sigma along each direction of the errors of offset, gain, start and lag.

        The total delay's error is the nuisance's; a longer lag means a shorter dead time.
        """
        for change in self.fit.root:
            linear = self.fit.linear + change[:3]
            time_s, force_n = self._drawn(linear) if self.is_stepped else self._plain
            lag_s = self.fit.lag_s
            if not self.is_stepped:
                lag_s = max(lag_s + float(change[3]), 0.5 * lag_s)
                force_n = self._answer(time_s, linear, lag_s)
            yield self._led(time_s + self.fit.dead_time_s + self.fit.lag_s - lag_s + float(values[0]), force_n)

    def _drawn(self, linear: FloatArray) -> Corners:
        """Corners before the dead time."""
        lag_s = self.fit.lag_s
        corner_s, level_n = stair_corners(self.step_s, self.level_n, self.last_s)
        asked_n = linear[0] + linear[1] * level_n
        if self.is_stepped:
            return corner_s + lag_s, asked_n
        span_n = float(np.ptp(asked_n))
        tread_s, tread_n = float(np.median(np.diff(self.step_s))), float(np.median(np.abs(np.diff(asked_n[::2]))))
        tolerance_n = _TOLERANCE * span_n * max(1.0, tread_s / lag_s)
        tolerance_n = min(tolerance_n, max(_OF_A_TREAD * tread_n, _TOLERANCE * span_n))
        return lagged(corner_s, asked_n, float(asked_n[0] + linear[2]), lag_s, tolerance_n)

    def _answer(self, time_s: FloatArray, linear: FloatArray, lag_s: float) -> FloatArray:
        answered_n = stair_answer(self.step_s, self.level_n, time_s, lag_s)
        left = np.exp(-(time_s - self.step_s[0]) / lag_s)
        return np.asarray(linear[0] + linear[1] * answered_n + linear[2] * left)

    def _led(self, time_s: FloatArray, force_n: FloatArray) -> Corners:
        """With the first force held before: the stem's first row is earlier where the delay is long."""
        lead_s = self.fit.dead_time_s + 2.0 * (self.delay.upper + _DELAY_S)
        return np.concatenate([[time_s[0] - lead_s], time_s]), np.concatenate([force_n[:1], force_n])


def commanded_path(recording: Recording, nameplate: Nameplate, force_n: FloatArray) -> CommandedPath | None:
    """Return the path of a polled recording with command and pressure, or None where the model does not hold.

    ``force_n``, shape (n,), is the measured pressure times the area, NaN where it is missing. The model holds where it
    leaves white noise of the pressure's own size.
    """
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if recording.force_n is not None or recording.command_pa is None or area_m2 is None:
        return None
    written = written_steps(recording, within_signal(recording.command_pa * area_m2, nameplate))
    if written is None:
        return None
    steps, doubt_s = (written.step_s, written.level_n), written.doubt_s
    period_s = recording.sample_period_s
    fit = fit_transducer(*steps, recording.time_s, force_n, (write_lead_s(recording), period_s))
    if fit is None:
        return None
    most_s = max(_DELAY_PERIODS * period_s, _DELAY_S)
    prior_s = float(np.hypot(_place_in_exchange_s(recording, doubt_s), fit.delay_sd_s))
    delay = Nuisance("delay_s", 0.0, 0.1 * period_s, -most_s, most_s, prior_s)
    return CommandedPath(*steps, float(recording.time_s[-1]), fit, delay, fit.noise_n, np.empty((0, 2)), doubt_s)


def _place_in_exchange_s(recording: Recording, write_doubt_s: FloatArray) -> float:
    """One standard deviation of what all delays of the position against its command have in common, s.

    A device may always act at the same place of an exchange. Longer exchanges than most are late by chance: where each
    write is recorded these count row by row.
    """
    look_s = look_doubts_s(recording, np.arange(recording.samples))
    if not (write_doubt_s.any() and look_s.any()):
        return delay_prior_s(recording)
    usual_s = float(np.hypot(np.median(write_doubt_s), np.median(look_s[look_s > 0.0])))
    return min(usual_s, delay_prior_s(recording))
