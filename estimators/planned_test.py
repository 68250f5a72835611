"""What a test that is not done yet will tell: the Cramér-Rao bound of its waveform, sampling and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.identifiability.bound import Knowledge, knowledge
from estimators.identifiability.sensitivities import SENSITIVITY_SYMBOLS, position_sensitivities
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray
from valve.errors import WaveformError
from valve.messages import say
from valve.motion import simulate_motion
from valve.parameters import TravelStops, ValveParameters
from valve.stem import StemState
from valve.waveform import Waveform

# As maximum likelihood takes it: DV is known beforehand to a factor of e^1.5.
LIMIT_VELOCITY_PRIOR: Final = 1.5
_DELAY_STEP_S: Final = 1.0e-6
_LAG_STEP: Final = 1.0e-4
_LAG_TOLERANCE: Final = 1.0e-6  # of the force's span: what straight lines leave the lag's exponential by
HALF_A_PERIOD: Final = 0.5  # as the channels of one exchange may be apart


@dataclass(frozen=True, slots=True)
class PlannedTest:
    """A waveform on a diaphragm area, m2, and how the stem's position is sampled: period, s, and noise, m rms.

    ``lag_s`` rounds the pressure's corners, 0 does not. Where the pressure is measured it is known, but for a delay
    between the channels of ``delay_periods`` of a period, one standard deviation: half of one, or ``ONE_INSTANT``
    where a device captures both at once. Where it is not, the command alone is, and neither lag nor dead time.
    """

    waveform: Waveform
    area_m2: float
    sample_period_s: float
    noise_m: float
    lag_s: float = 0.0
    pressure_measured: bool = True
    stops: TravelStops | None = None
    delay_periods: float = HALF_A_PERIOD

    def __post_init__(self) -> None:
        for name in ("area_m2", "sample_period_s", "noise_m", "delay_periods"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise WaveformError(
                    say(
                        "planned_value_not_positive",
                        "planned test: {name} is {value:g}, it must be above 0: correct it",
                        name=name,
                        value=value,
                    )
                )
        if not (math.isfinite(self.lag_s) and self.lag_s >= 0.0) or (self.lag_s == 0.0 and not self.pressure_measured):
            raise WaveformError(
                say(
                    "planned_lag",
                    "planned test: the transducer's lag is {lag:g} s, it must not be negative, nor 0 where the "
                    "pressure is not measured: correct it",
                    lag=self.lag_s,
                )
            )

    @property
    def force_rates_n_per_s(self) -> tuple[float, ...]:
        """Rates of the actuator force along the ramps, N/s, each once, slow ones first."""
        run_s, rise_n = np.diff(self.waveform.time_s), self.area_m2 * np.abs(np.diff(self.waveform.pressure_pa))
        ramps = (run_s > 0.0) & (rise_n > 0.0)
        rates: list[float] = []
        for rate in np.sort(rise_n[ramps] / run_s[ramps]):
            if not rates or rate > rates[-1] * (1.0 + 1.0e-6):
                rates.append(float(rate))
        return tuple(rates)

    @property
    def output_times_s(self) -> FloatArray:
        """Times of the samples, s; half a period late, so that none falls on a corner."""
        period_s = self.sample_period_s
        return np.arange(0.5 * period_s, self.waveform.duration_s, period_s, dtype=np.float64)

    def corners(self, lag_s: float) -> tuple[FloatArray, FloatArray]:
        """Corner times, s, and actuator force, N, shape (n,), behind this lag."""
        time_s, force_n = self.waveform.time_s, self.area_m2 * self.waveform.pressure_pa
        if lag_s == 0.0:
            return time_s, force_n
        return lagged(time_s, force_n, float(force_n[0]), lag_s, _LAG_TOLERANCE * float(np.ptp(force_n)))


def planned_knowledge(parameters: ValveParameters, test: PlannedTest, *, start_m: float = 0.0) -> Knowledge:
    """Return what the test will tell of a valve with these parameters that rests at ``start_m``.

    Unknown are the seven parameters, the position at the start and the lateness of the input; of DV a weak prior is
    known. Raises MotionError where the motion cannot be followed.
    """
    time_s, start = test.output_times_s, StemState(start_m)
    corners = test.corners(test.lag_s)
    _, slopes = position_sensitivities(
        parameters, *corners, time_s, SENSITIVITY_SYMBOLS, stops=test.stops, initial=start
    )
    columns, symbols = [slopes], list(SENSITIVITY_SYMBOLS)
    values = [*parameters.by_symbol().values(), start_m]
    prior_sd = {"DV": LIMIT_VELOCITY_PRIOR * parameters.limit_velocity_m_per_s}

    def position(lag_s: float, late_s: float) -> FloatArray:
        corner_s, force_n = test.corners(lag_s)
        # the clock is set by the force, so that it may also be early
        return simulate_motion(
            parameters, corner_s, force_n, np.maximum(time_s - late_s, 0.0), stops=test.stops, initial=start
        ).position_m

    late = (position(test.lag_s, _DELAY_STEP_S) - position(test.lag_s, -_DELAY_STEP_S)) / (2.0 * _DELAY_STEP_S)
    columns.append(late[:, None])
    if test.pressure_measured:
        symbols.append("delay_s")
        values.append(0.0)
        prior_sd["delay_s"] = test.delay_periods * test.sample_period_s
    else:
        step_s = _LAG_STEP * test.lag_s
        change = position(test.lag_s + step_s, 0.0) - position(test.lag_s - step_s, 0.0)
        columns.append((change / (2.0 * step_s))[:, None])
        symbols += ["transducer_dead_time_s", "transducer_lag_s"]
        values += [0.0, test.lag_s]
    jacobian = np.hstack(columns) / test.noise_m
    information = jacobian.T @ jacobian
    for symbol, sd in prior_sd.items():
        place = symbols.index(symbol)
        information[place, place] += sd**-2
    rates = test.force_rates_n_per_s
    spring = parameters.spring_rate_n_per_m
    speeds = tuple(rate / spring for rate in rates) if spring > 0.0 else ()
    return knowledge(symbols, values, information, sliding_speeds_m_per_s=speeds, ramp_rates_n_per_s=rates)
