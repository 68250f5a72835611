"""Where the fit of an I/P's lag and dead time begins: with them breakaways and slides lie on one balance of forces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from estimators.likelihood.inputs.transducer_path import DEAD_TIME, LAG, TransducerPath
from estimators.likelihood.start import breakaway_balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray

Pair = tuple[float, float]  # lag and dead time, s

# Own choices: a third or a half apart, as a longer lag and a shorter dead time nearly stand for each other.
_LAGS_S: Final = (0.02, 0.05, 0.1, 0.17, 0.25, 0.37, 0.55, 0.8, 1.2, 2.0)
_DEAD_TIMES_S: Final = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5)
_CLOSER: Final = (-1.0, 0.0, 1.0)
_HALVED: Final = (0.2, 0.07, 0.02, 0.007)  # steps about the best, of the lag, and
_ROUNDS: Final = 4  # so often at most
_FEWEST: Final = 8  # breakaways, of five unknowns
_ENOUGH: Final = 200
_ROWS: Final = 4000  # of sliding
_CLEARLY: Final = 0.7  # of what the usual lag leaves
_CHANCE: Final = 2.0  # standard deviations
_TOLD: Final = 1.5  # between the longest and the shortest delay that chance leaves


def started_behind_lag(path: TransducerPath, motion: RecordedMotion) -> tuple[TransducerPath, RecordedMotion]:
    """Return the path that begins at the lag and dead time of the motion, and the motion under its force.

    At each breakaway F = k x + F_0 +- F_s; the force of a wrong lag is off it, the more the faster the ramp and the
    nearer its corner. Where too few breakaways tell, or leave several delays, a stem that slides to a stop about the
    corners tells by F = k x + F_v v + F_0 +- F_c. Both as they are where neither does.
    """
    best = _of_breakaways(path, motion) or _of_sliding(path, motion)
    if best is None:
        return path, motion
    starts = {LAG: best[0], DEAD_TIME: best[1]}
    nuisances = tuple(replace(one, start=starts[one.name]) for one in path.nuisances)
    samples = replace(motion.samples, force_n=_force(path, best, motion.samples.time_s))
    return replace(path, nuisances=nuisances), replace(motion, samples=samples, shared={})


def _of_breakaways(path: TransducerPath, motion: RecordedMotion) -> Pair | None:
    breakaways = motion.phases.breakaways
    if len(breakaways) < _FEWEST:
        return None
    taken = breakaways[:: 1 + len(breakaways) // _ENOUGH]
    motion = replace(motion, phases=replace(motion.phases, breakaways=taken))
    best, found = _lowest(partial(_off_breakaways, path, motion))
    least = found[best]
    # on ramps of one rate any delay may do, with another F_s
    alike = least * (1.0 + 1.0 / math.sqrt(2.0 * len(taken)))
    alike = max(alike, math.hypot(least, _CHANCE * _timing_n(path, motion) / math.sqrt(len(taken))))
    delays_s = [sum(pair) for pair, off in found.items() if off <= alike]
    is_told = max(delays_s) < _TOLD * min(delays_s)
    return best if is_told and least < _off_breakaways(path, motion, (0.0, 0.0)) else None


def _of_sliding(path: TransducerPath, motion: RecordedMotion) -> Pair | None:
    stretches = motion.phases.stretches
    if not stretches:
        return None
    rows = np.concatenate([np.arange(one.first, one.last + 1) for one in stretches])
    rows = rows[:: 1 + rows.size // _ROWS]
    sense = np.sign(motion.phases.velocity[rows])
    balance = np.column_stack(
        [motion.samples.position_m[rows], motion.phases.velocity[rows], sense, np.ones(rows.size)]
    )
    size = np.abs(balance).max(axis=0)
    basis = np.linalg.qr(balance[:, size > 0.0] / size[size > 0.0])[0]
    time_s = motion.samples.time_s[rows]

    def off_n(pair: Pair) -> float:
        force_n = _force(path, pair, time_s)
        return float(np.linalg.norm(force_n - basis @ (basis.T @ force_n)))

    best, found = _lowest(off_n)
    usual = off_n((path.nuisances[0].start, path.nuisances[1].start))
    return best if found[best] < _CLEARLY * usual else None


def _lowest(off: Callable[[Pair], float]) -> tuple[Pair, dict[Pair, float]]:
    """Return the lag and dead time, s, where ``off`` is least, and ``off`` wherever it was looked."""
    found = {pair: off(pair) for pair in product(_LAGS_S, _DEAD_TIMES_S)}
    best = min(found, key=lambda pair: found[pair])
    for step in _HALVED:
        for _ in range(_ROUNDS):
            middle = best
            for longer, later in product(_CLOSER, _CLOSER):
                pair = middle[0] * (1.0 + step * longer), max(middle[1] + step * middle[0] * later, 0.0)
                found[pair] = off(pair)
                best = pair if found[pair] < found[best] else best
            if best == middle:
                break
    return best, found


def _timing_n(path: TransducerPath, motion: RecordedMotion) -> float:
    """Change of the commanded force, N, in the time that a breakaway is known to: of the breakaways the mean."""
    time_s = np.array([breakaway.time_s for breakaway in motion.phases.breakaways])
    within_s = np.array([breakaway.within_s for breakaway in motion.phases.breakaways])
    changed_n = _force(path, (0.0, 0.0), time_s + within_s) - _force(path, (0.0, 0.0), time_s)
    return float(np.mean(np.abs(changed_n)))


def _off_breakaways(path: TransducerPath, motion: RecordedMotion, pair: Pair) -> float:
    """Mean distance of the breakaways from their balance under this lag and dead time, N; infinite without one."""
    phases, samples = motion.phases, motion.samples
    rows = np.array([breakaway.row for breakaway in phases.breakaways], dtype=np.int64)
    force_n = np.zeros(samples.count)
    force_n[rows] = _force(path, pair, samples.time_s[rows])
    solved = breakaway_balance(replace(samples, force_n=force_n), phases.breakaways)
    if solved is None:
        return float("inf")
    sense = np.array([float(breakaway.direction) for breakaway in phases.breakaways])
    rest_m = np.array([breakaway.rest_m for breakaway in phases.breakaways])
    off_n = np.abs(force_n[rows] - solved[0] * rest_m - solved[1] * sense - solved[2])
    return float(np.mean(off_n))


def _force(path: TransducerPath, pair: Pair, time_s: FloatArray) -> FloatArray:
    corner_s, corner_n = path.corners(np.array(pair))
    return np.interp(time_s, corner_s, corner_n)
