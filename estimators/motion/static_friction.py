"""Static friction from the instants of breakaway (Romano & Garcia 2007, Eq. 2, last line, and Eq. 12)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.phases import Phases
from estimators.motion.rests import Breakaway
from estimators.samples import FloatArray, Samples

# Own choices: rows at rest whose force is drawn on to the instant of breakaway.
_FEWEST_LINE_ROWS: Final = 3
_MOST_LINE_ROWS: Final = 40


@dataclass(frozen=True, slots=True, eq=False)
class BreakawayForces:
    """Friction at each breakaway, N, shape (n,): s (F - k x - F_0), s the direction; with its timing error."""

    friction_n: FloatArray
    timing_n: FloatArray
    direction: FloatArray
    time_s: FloatArray

    @property
    def value(self) -> float:
        """Median over the breakaways, N."""
        return float(np.median(self.friction_n))

    @property
    def std_error(self) -> float:
        """Scatter of the median and the timing error that all breakaways share, N."""
        count = self.friction_n.size
        scatter = 1.4826 * float(np.median(np.abs(self.friction_n - self.value)))
        # 1.25: a median scatters that much more than a mean of normal values
        return math.hypot(1.25 * scatter / math.sqrt(count), float(np.median(self.timing_n)))


def force_at(samples: Samples, phases: Phases, breakaway: Breakaway) -> tuple[float, float]:
    """Force at the instant of breakaway and its slope (N, N/s), from a line through the rows about it.

    As few rows before it as bring the force's noise below the timing error: the force may still bend after a corner.
    The row after it counts too, the force does not feel the breakaway.
    """
    timing_n = abs(float(phases.force_rate[breakaway.row])) * breakaway.within_s
    wanted = (4.0 * samples.force_noise_n / timing_n) ** 2 if timing_n > 0.0 else _MOST_LINE_ROWS
    before = int(min(_MOST_LINE_ROWS, max(_FEWEST_LINE_ROWS, math.ceil(min(wanted, 1.0e6)))))
    first = max(int(samples.run_first[breakaway.row]), breakaway.row - before + 1)
    last = min(breakaway.row + 1, int(samples.run_last[breakaway.row]))
    rows = slice(first, last + 1)
    time_s, force_n = samples.time_s[rows] - breakaway.time_s, samples.force_n[rows]
    # a corner among the rows would bend the line, a leap would tear it: keep what lies together before the breakaway
    steps_n = np.diff(force_n)
    usual_n = float(np.median(np.abs(steps_n))) if steps_n.size else 0.0
    torn = np.flatnonzero(np.abs(steps_n) > 4.0 * usual_n + 8.0 * samples.force_noise_n)
    if torn.size and int(torn[-1]) == steps_n.size - 1 and last > breakaway.row:
        time_s, force_n = time_s[:-1], force_n[:-1]
        torn = torn[:-1]
    if torn.size and time_s.size - int(torn[-1]) - 1 >= 2:
        time_s, force_n = time_s[int(torn[-1]) + 1 :], force_n[int(torn[-1]) + 1 :]
    if time_s.size > 3:
        bend = np.abs(np.diff(force_n, 2))
        limit = 8.0 * samples.force_noise_n + 1.0e-6 * float(np.ptp(force_n)) + 3.0 * float(np.median(bend))
        kinks = np.flatnonzero(bend > limit)
        if kinks.size and time_s.size - int(kinks[-1]) - 1 >= 3:
            time_s, force_n = time_s[int(kinks[-1]) + 1 :], force_n[int(kinks[-1]) + 1 :]
    if time_s.size < 2:
        return float(force_n[-1]), 0.0
    middle_s = float(time_s.mean())
    spread = time_s - middle_s
    slope = float(spread @ force_n) / float(spread @ spread)
    return float(force_n.mean()) - slope * middle_s, slope


def breakaway_forces(
    samples: Samples, phases: Phases, spring_n_per_m: float, preload_n: float
) -> BreakawayForces | None:
    """Friction at each breakaway; None where there was none."""
    found = []
    for breakaway in phases.breakaways:
        force_n, rate = force_at(samples, phases, breakaway)
        friction = breakaway.direction * (force_n - spring_n_per_m * breakaway.rest_m - preload_n)
        first = max(breakaway.row - 1, int(samples.run_first[breakaway.row]))
        last = min(breakaway.row + 1, int(samples.run_last[breakaway.row]))
        leap_n = float(np.abs(np.diff(samples.force_n[first : last + 1])).max(initial=0.0))
        # a force that leaps at the breakaway leaves it open within the leap
        timing_n = max(abs(rate) * breakaway.within_s, leap_n / math.sqrt(12.0))
        found.append((friction, timing_n, float(breakaway.direction), breakaway.time_s))
    if not found:
        return None
    friction, timing, direction, time_s = np.array(found).T
    return BreakawayForces(friction, timing, direction, time_s)


def published_breakaway_forces(samples: Samples, phases: Phases, spring_n_per_m: float) -> BreakawayForces | None:
    """As published: |F - k x| of the last sample at rest, without preload; None where there was no breakaway."""
    rows = np.array([breakaway.row for breakaway in phases.breakaways], dtype=np.int64)
    if rows.size == 0:
        return None
    friction = np.abs(samples.force_n[rows] - spring_n_per_m * samples.position_m[rows])
    next_rows = np.minimum(rows + 1, samples.count - 1)
    timing = np.abs(samples.force_n[next_rows] - samples.force_n[rows]) / math.sqrt(3.0)
    direction = np.array([float(breakaway.direction) for breakaway in phases.breakaways])
    return BreakawayForces(friction, timing, direction, samples.time_s[rows])
