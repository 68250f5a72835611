"""A command without a measured pressure: what the I/P makes of it is a lag and a dead time, which the fit finds.

The gain is what the signal range says. How late the stem follows the command in all is seen where a ramp turns back;
how that time is shared between the I/P and F_v / k shows only in the motion, and in breakaways at several rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.dynamic import PathToFit
from estimators.engine.force_path import Source, lagged, restarts_of
from estimators.engine.laws import Law, LawParameter, Where
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading

FloatArray = npt.NDArray[np.float64]

_LAG_S, _LAG_SPREAD = 0.1, 1.5  # of an I/P with its tubing and the actuator's volume: median, and of the logarithm
_SHORTEST_S, _LONGEST_S = 1.0e-3, 10.0
_DEAD_S: Final = 0.05
_MOST_DEAD_S: Final = 5.0
_SHARE: Final = 0.5  # of the whole lateness: what the path is given before it is fitted
_OTHER_SHARES: Final = (0.15, 0.85)  # that the fit begins with too
_START_DEAD_S: Final = 1.0e-3
_REMEMBERED: Final = 8
_LOG_STEP: Final = 1.0e-3
_TIME_STEP_S: Final = 2.0e-4


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


def is_commanded(reading: Reading) -> bool:
    """Whether the command stands in for the pressure."""
    return reading.path.source is Source.COMMAND_ALONE


def with_likely_path(reading: Reading, lag: Known) -> tuple[Reading, Known]:
    """Return the reading with a path that takes half of the lateness, s, and the lateness that is left."""
    path = reading.path
    lag_s = max(_SHARE * lag.value, _SHORTEST_S)
    restarts = restarts_of(path.force_n, reading.samples.run_first)
    force_n = passed(reading.time_s, path.force_n, restarts, lag_s, 0.0)
    likely = replace(path, force_n=force_n, lag_s=lag_s)
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
    return PathToFit(
        law, tuple((_start(lag, share), max((1.0 - share) * lag.value, _SHORTEST_S)) for share in _OTHER_SHARES)
    )


def _start(lag: Known, share: float) -> FloatArray:
    lag_s = min(max(share * lag.value, 2.0 * _SHORTEST_S), 0.5 * _LONGEST_S)
    return np.array([math.log(lag_s), _START_DEAD_S])
