"""What an I/P makes of its command, as far as the fit has to find it: lag and dead time, or the gauge's part of them.

Without a measured pressure the gain is what the signal range says. How late the stem follows the command in all is seen
where a ramp turns back; how that time is shared between the I/P and F_v / k shows only in the motion, and in breakaways
at several rates.

A gauge sees the I/P's lag behind its own filter, and hardly tells the two from one lag: their times' squares add, so
the pressure that acts has the lag sqrt(T^2 - g^2) where the gauge shows T. F_v / k is a lag of the same kind, so what g
leaves open of T is in F_v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.force_path import GAUGE_LAG_S, lagged, restarts_of
from estimators.engine.laws import Law, LawParameter, PathToFit, Where
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading

FloatArray = npt.NDArray[np.float64]

_LAG_S, _LAG_SPREAD = 0.1, 1.5  # of an I/P with its tubing and the actuator's volume: median, and of the logarithm
_SHORTEST_S, _LONGEST_S = 1.0e-3, 10.0
_DEAD_S: Final = 0.05
_MOST_DEAD_S: Final = 5.0
_SHARE: Final = 0.5  # of the whole lateness: what the path is given before it is fitted
_OTHER_SHARES: Final = (0.15, 0.85)  # that the fit begins with too
_UNSEEN_LAGS_S: Final = (0.5, 1.0)  # the same where no slide shows how late the stem is
_START_DEAD_S: Final = 1.0e-3
_REMEMBERED: Final = 8
_LOG_STEP: Final = 1.0e-3
_TIME_STEP_S: Final = 2.0e-4
# The square of a gauge's filter time, ms^2: a few to twenty ms are usual.
_SQUARE_MS2, _SQUARE_SPREAD_MS2, _SQUARE_START_MS2, _SQUARE_STEP_MS2 = 100.0, 150.0, 50.0, 5.0
_EARLIER_S: Final = 0.01  # than the gauge: its filter's time, mean and standard deviation
_MOST_OF_SQUARE: Final = 0.8  # of the lag that the gauge shows
_SURELY: Final = 4.0  # standard errors of the lag that the gauge shows


@dataclass(frozen=True, slots=True, eq=False)
class CommandPath(Law):
    """The force of a command, N, at times, s, arrays of shape (n,), behind a lag and a dead time.

    It adds to ``nominal_n``, the force that the model has without it. Values: the lag's logarithm, the dead time, s.
    """

    time_s: FloatArray
    command_n: FloatArray
    nominal_n: FloatArray
    restarts: npt.NDArray[np.bool_]
    parameters: tuple[LawParameter, ...]
    known: dict[tuple[float, float], FloatArray] = field(default_factory=dict)  # of the last values, for all sections

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what this lag and dead time add to the force."""
        key = float(values[0]), float(values[1])
        if key not in self.known:
            if len(self.known) >= _REMEMBERED:
                del self.known[next(iter(self.known))]
            passed_n = passed(self.time_s, self.command_n, self.restarts, math.exp(key[0]), key[1])
            self.known[key] = passed_n - self.nominal_n
        return np.asarray(np.interp(where.time_s, self.time_s, self.known[key]))


def passed(
    time_s: FloatArray, command_n: FloatArray, restarts: npt.NDArray[np.bool_], lag_s: float, dead_s: float
) -> FloatArray:
    """Return the command behind a dead time and a lag, N, shape (n,)."""
    begins_s = time_s[np.maximum.accumulate(np.where(restarts, np.arange(time_s.size), 0))]
    late_n = np.interp(np.maximum(time_s - dead_s, begins_s), time_s, command_n)
    return lagged(time_s, late_n, lag_s, restarts)


@dataclass(frozen=True, slots=True, eq=False)
class GaugedPath(Law):
    """The force behind an I/P's lag, N, where a gauge showed that lag with its own filter in it; times, s, shape (n,).

    Values: the square of the filter's time, ms^2, and by how much the force is earlier than the gauge, s. The second is
    the first one's root for a filter, but a gauge may be late without one.
    """

    time_s: FloatArray
    command_n: FloatArray
    restarts: npt.NDArray[np.bool_]
    lag_s: float
    dead_s: float
    parameters: tuple[LawParameter, ...]
    known: dict[tuple[float, float], FloatArray] = field(default_factory=dict)

    def force_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return what the shorter and earlier lag adds to the force."""
        key = float(values[0]), float(values[1])
        if key not in self.known:
            if len(self.known) >= _REMEMBERED:
                del self.known[next(iter(self.known))]
            self.known[key] = self._passed_n(*key) - self._passed_n(0.0, 0.0)
        return np.asarray(np.interp(where.time_s, self.time_s, self.known[key]))

    def _passed_n(self, square: float, earlier_s: float) -> FloatArray:
        lag_s = math.sqrt(max(self.lag_s**2 - 1.0e-6 * square, 0.0))
        dead_s = self.lag_s + self.dead_s - lag_s - earlier_s
        return passed(self.time_s, self.command_n, self.restarts, lag_s, dead_s)


def with_likely_path(reading: Reading, lag: Known) -> tuple[Reading, Known]:
    """Return the reading with a path that takes half of the lateness, s, and the lateness that is left."""
    path = reading.path
    lag_s = max(_SHARE * lag.value, _SHORTEST_S)
    restarts = restarts_of(path.force_n, reading.samples.run_first)
    force_n = passed(reading.time_s, path.force_n, restarts, lag_s, 0.0)
    likely = replace(path, force_n=force_n, lag_s=lag_s, peaks_s=np.empty(0), peaks_n=np.empty(0))
    left_s = lag.value - lag_s
    return replace(reading, path=likely), Known(left_s, math.hypot(lag.std_error, lag_s))


def command_path(as_recorded: Reading, likely: Reading, lag: Known) -> PathToFit:
    """Return the path as a law that begins at the likely one, and other shares of the lateness, s, to begin with."""
    forces = as_recorded.path.force_n, likely.path.force_n
    restarts = restarts_of(forces[0], as_recorded.samples.run_first)
    lag_range = math.log(_SHORTEST_S), math.log(_LONGEST_S)
    law = CommandPath(
        as_recorded.time_s,
        *forces,
        restarts,
        (
            LawParameter("ln lag", "", *lag_range, math.log(_LAG_S), _LAG_SPREAD, _start(lag, _SHARE)[0], _LOG_STEP),
            LawParameter("dead time", "s", 0.0, _MOST_DEAD_S, 0.0, _DEAD_S, _START_DEAD_S, _TIME_STEP_S),
        ),
    )
    others = [(_start(lag, share), max((1.0 - share) * lag.value, _SHORTEST_S)) for share in _OTHER_SHARES]
    if lag.std_error > lag.value:  # no corner shows it
        others += [(np.array([math.log(lag_s), _START_DEAD_S]), _SHORTEST_S) for lag_s in _UNSEEN_LAGS_S]
    return PathToFit(law, tuple(others), lag_at=0)


def with_gauged_path(reading: Reading) -> tuple[Reading, PathToFit | None]:
    """Return the gauge's part of the path's lag as a law, None where the force has no lag of a command's path.

    With it the reading whose force is as late as the law says, and no more.
    """
    path = reading.path
    if path.commanded_n is None:
        return reading, None
    shown = 1.0e6 * path.lag_s**2
    error = 2.0e6 * path.lag_s * path.lag_error_s
    most = min(1.0e6 * GAUGE_LAG_S**2 + _SURELY * error, _MOST_OF_SQUARE * shown)
    square = LawParameter(
        "gauge's filter, squared",
        "ms^2",
        -_SURELY * error - _SQUARE_START_MS2,
        most,
        _SQUARE_MS2,
        math.hypot(_SQUARE_SPREAD_MS2, error),
        min(_SQUARE_START_MS2, 0.5 * most),
        _SQUARE_STEP_MS2,
    )
    earlier = LawParameter(
        "gauge's delay", "s", -0.5 * GAUGE_LAG_S, GAUGE_LAG_S, _EARLIER_S, _EARLIER_S, _EARLIER_S, _TIME_STEP_S
    )
    restarts = restarts_of(path.commanded_n, reading.samples.run_first)
    law = GaugedPath(reading.time_s, path.commanded_n, restarts, path.lag_s, path.dead_time_s, (square, earlier))
    return replace(reading, path=replace(path, late_s=0.0)), PathToFit(law, ())


def _start(lag: Known, share: float) -> FloatArray:
    lag_s = min(max(share * lag.value, 2.0 * _SHORTEST_S), 0.5 * _LONGEST_S)
    return np.array([math.log(lag_s), _START_DEAD_S])
