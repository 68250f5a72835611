"""Stick-slip: a stem that only jumps from rest to rest; its branches are drawn through the ends of its slips."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.samples import FloatArray, IntArray, Samples
from estimators.scatter import Measured, combined

# Own choices.
_JUMP_SIGMAS: Final = 9.0  # of the noise: what a step between two samples must exceed
_JUMP_SHARE: Final = 2.0e-3  # of the travel seen
_REST_ROWS: Final = 6  # fewest samples of a rest
_RESTING_SHARE: Final = 0.8  # of the samples that lie in rests: less is no stick-slip
_FEWEST_SLIPS: Final = 5  # one of them in each direction at least
_COARSEST: Final = 0.005  # of the force's range: an input that goes in steps does not show where the stem broke away


@dataclass(frozen=True, slots=True, eq=False)
class Slips:
    """Slips from rest to rest, all (n,): travel before and after, m, force at breakaway and at its end, N."""

    direction: IntArray
    from_m: FloatArray
    to_m: FloatArray
    breakaway_n: FloatArray
    end_n: FloatArray
    timing_n: FloatArray  # within which the force at breakaway is known

    @property
    def jump_m(self) -> FloatArray:
        """How far each slip went, m."""
        return np.asarray(np.abs(self.to_m - self.from_m))


@dataclass(frozen=True, slots=True, eq=False)
class SlipBranches:
    """Lines through the points of breakaway (friction F_s) and through the ends of the slips, same spring."""

    static_friction: Measured
    end_friction: Measured
    spring: Measured
    preload: Measured
    slips: Slips


def find_slips(samples: Samples) -> Slips | None:
    """Return the slips between rests, or None where the stem does not mostly rest and jump."""
    position_m = samples.position_m
    jump_m = _JUMP_SIGMAS * samples.position_noise_m + _JUMP_SHARE * float(np.ptp(position_m))
    same_run = samples.run_first[1:] == samples.run_first[:-1]
    breaks = np.flatnonzero((np.abs(np.diff(position_m)) > jump_m) | ~same_run) + 1
    firsts = np.concatenate([[0], breaks])
    lasts = np.concatenate([breaks - 1, [samples.count - 1]])
    kept = lasts - firsts + 1 >= _REST_ROWS
    firsts, lasts = firsts[kept], lasts[kept]
    if firsts.size <= _FEWEST_SLIPS or float((lasts - firsts + 1).sum()) < _RESTING_SHARE * samples.count:
        return None
    # the first row of a rest may still be on its way
    level_m = np.array([np.median(position_m[f + 1 : z + 1]) for f, z in zip(firsts, lasts, strict=True)])
    spread_m = [np.ptp(position_m[f + 1 : z + 1]) for f, z in zip(firsts, lasts, strict=True)]
    if float(np.median(spread_m)) > jump_m:
        return None
    linked = samples.run_first[lasts[:-1]] == samples.run_first[firsts[1:]]
    before, after = lasts[:-1][linked], firsts[1:][linked]
    from_m, to_m = level_m[:-1][linked], level_m[1:][linked]
    force_n = samples.force_n
    beyond = np.minimum(before + 1, samples.count - 1)
    # the slip begins somewhere between the last sample at rest and the next
    return Slips(
        direction=np.sign(to_m - from_m).astype(np.int64),
        from_m=from_m,
        to_m=to_m,
        breakaway_n=0.5 * (force_n[before] + force_n[beyond]),
        end_n=force_n[after],
        timing_n=np.abs(force_n[beyond] - force_n[before]) / math.sqrt(12.0),
    )


def fit_slips(samples: Samples, slips: Slips) -> SlipBranches | None:
    """Return the lines F = k x + F_0 +- F_s through the breakaways and F = k x + F_0 +- A through the slips' ends.

    A slip of Karnopp's valve that is damped ends where the friction is F_c (plus F_v DV); one that swings goes on to
    2 F_c - F_s. So A is the friction at the end of the slips, and no friction in steady motion.
    """
    if float(np.median(slips.timing_n)) > _COARSEST * float(np.ptp(samples.force_n)):
        return None
    ways = [int(np.count_nonzero(slips.direction == way)) for way in (1, -1)]
    if min(ways) < 1 or sum(ways) < _FEWEST_SLIPS:
        return None
    sense = slips.direction.astype(np.float64)
    columns = np.column_stack([slips.from_m, np.ones(sense.size), sense])
    solution, _, rank, _ = np.linalg.lstsq(columns, slips.breakaway_n, rcond=None)
    if rank < 3 or solution[0] <= 0.0:
        return None
    residual_n = slips.breakaway_n - columns @ solution
    freedom = max(1, sense.size - 3)
    noise_n = math.hypot(
        math.sqrt(float(residual_n @ residual_n) / freedom), float(np.median(slips.timing_n)) + samples.force_noise_n
    )
    error = noise_n * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    # all slips are seen late or early together where the ramp is in step with the samples
    static = Measured(float(solution[2]), float(error[2]), freedom).with_error(float(np.median(slips.timing_n)))
    ends_n = sense * (slips.end_n - solution[0] * slips.to_m - solution[1])
    scatter_n = float(ends_n.std(ddof=1)) / math.sqrt(ends_n.size)
    end = Measured(float(ends_n.mean()), scatter_n, ends_n.size - 1.0).with_error(float(error[1]))
    return SlipBranches(
        static_friction=static,
        end_friction=combined(end.value, (end, 1.0), (Measured(0.0, float(np.median(slips.timing_n))), 2.0)),
        spring=Measured(float(solution[0]), float(error[0]), freedom),
        preload=Measured(float(solution[1]), float(error[1]), freedom),
        slips=slips,
    )
