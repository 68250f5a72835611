"""How late the stem follows the force: by how long it coasts after a corner, and by how it starts.

Where a ramp turns back the stem goes on for F_v / k ln 2. Only a stem whose limit velocity is near its own speed stops
there at once. Its lag shows after each breakaway: its speed comes to the ramp's by exp(-t k / F_v). Friction that is
rough looks much alike, and of the two the likelier one counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from estimators.engine.balance import Balance, Blocks, Problem, covariance_of, fit, problem_of
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.segmentation import Move

FloatArray = npt.NDArray[np.float64]

_ONE_LAG: Final = 1.0e-3  # of one: two lags that differ by less are one
_LAG_ERROR_S: Final = 0.02  # an arrival is seen early or late by the band of the rest and the sensor's filter
_UNSEEN_S: Final = 0.1  # a lag of which no corner tells: as on travel stops at both ends
_LAG_SHARE: Final = 0.5
_MOST_ALIKE: Final = 4.0
_LONG_S: Final = 0.1  # a coasting that may be a tail
_RAMP_S: Final = 0.2  # before a corner, that show the speed
# At full speed the way of a coasting takes so much of its time: of a stem that slows down to rest by itself 0.44, of
# one that stops sooner more, of a tail of four lags a quarter.
_TAIL: Final = 0.42
_SHORTEST_S: Final = 0.02  # of a lag that starts show
_LONGEST_SHARE: Final = 0.3  # of the longest time since a breakaway
_APART: Final = 0.1  # of the logarithms of two lags that are tried
_TIED: Final = 0.3  # of a lag that is tried: how far the lag of the sliding stem may be from it
_START_SHARE: Final = 0.3  # of F_c: by how much the stem starts faster or slower than its ramp, as a force
_LIKELIER: Final = 10.0  # nats, at the roughness that the balance found without


@dataclass(frozen=True, slots=True)
class Coasting:
    """How late the stem follows the force, s, by how it coasts; ``is_tail``: as a reading that lags shows it."""

    lag: Known
    is_tail: bool


def lag_after_corners(reading: Reading) -> Known:
    """How late the stem follows the force, s, from how it coasts after a corner where a ramp turns back."""
    return coasting(reading).lag


def coasting(reading: Reading) -> Coasting:
    """Return how the stem coasts after corners: its lag by how long it does.

    A reading that lags has a tail there, which ends only in the noise: then by how far it coasts.
    """
    time_s, corners_s = reading.time_s, reading.path.corners_s
    found, tails = [], []
    for move in reading.segmentation.moves:
        if move.next_rest < 0:
            continue
        arrived_s = float(time_s[reading.segmentation.rests[move.next_rest].first])
        before = corners_s[(corners_s > time_s[move.first]) & (corners_s <= arrived_s + 0.01)]
        if before.size:
            coasted_s = max(0.0, arrived_s - float(before[-1]))
            found.append(lag_of_coasting(coasted_s, reading.path.lag_s))
            if coasted_s > _LONG_S:
                full_speed_s = _coasting_at_full_speed(reading, move, float(before[-1]))
                tails.append((full_speed_s, full_speed_s / coasted_s))
    if not found:
        return Coasting(Known(0.0, _UNSEEN_S), is_tail=False)
    late_s, share = np.median(np.array(tails), axis=0).tolist() if 2 * len(tails) > len(found) else (0.0, math.inf)
    if 0.0 < share < _TAIL:
        return Coasting(Known(late_s, _LAG_ERROR_S + _LAG_SHARE * late_s), is_tail=True)
    # a stem that stops for another reason, as where the supply ends, has its last corner long before
    near = [one for one in found if one < _MOST_ALIKE * (float(np.quantile(found, 0.25)) + _LAG_ERROR_S)]
    lag_s = float(np.median(near))
    return Coasting(Known(lag_s, _LAG_ERROR_S + _LAG_SHARE * lag_s), is_tail=False)


def _coasting_at_full_speed(reading: Reading, move: Move, corner_s: float) -> float:
    """How long a move would take for the way that it coasts after this corner at its speed on the ramp before, s."""
    time_s, position_m = reading.time_s, reading.position_m
    first, corner = np.searchsorted(time_s, [corner_s - _RAMP_S, corner_s]).tolist()
    if first < move.first or corner - first < 2:
        return math.inf  # no ramp: a step
    speed, at_corner_m = np.polyfit(time_s[first:corner] - corner_s, position_m[first:corner], 1).tolist()
    coasted_m = move.direction * (reading.segmentation.rests[move.next_rest].level_m - at_corner_m)
    return float(coasted_m / max(move.direction * speed, 1.0e-12))


def lag_of_coasting(coasted_s: float, path_lag_s: float) -> float:
    """The lag of a stem, s, that coasts so long after its force has turned back; the force has a lag of its own.

    Behind a ramp that turns back the speed of a stem with the lag T is 1 - 2 (1 - exp(-t / T)) of the ramp's: it turns
    at t = T ln 2. Behind a force with the lag P it is 1 - 2 (1 - (P exp(-t / P) - T exp(-t / T)) / (P - T)), while the
    force itself has turned at P ln 2: a force so rounded is followed T late, and not T ln 2.
    """
    if path_lag_s <= 0.0 or coasted_s <= 0.0:
        return coasted_s / math.log(2.0)
    turns_s = path_lag_s * math.log(2.0) + coasted_s

    def left(lag_s: float) -> float:
        late, apart_s = np.exp(-turns_s / np.array([path_lag_s, lag_s])), path_lag_s - lag_s
        if abs(apart_s) < _ONE_LAG * path_lag_s:
            return float(late[0]) * (1.0 + turns_s / path_lag_s) - 0.5
        return float(path_lag_s * late[0] - lag_s * late[1]) / apart_s - 0.5

    return float(brentq(left, 1.0e-3 * coasted_s, 2.0 * coasted_s))


def lag_after_breakaways(reading: Reading, lag: Known, found: Balance) -> Known | None:
    """How late a stem is that starts as one with a far longer lag than it shows after corners; None for any other.

    ``lag`` is what corners show, ``found`` the balance with it. The roughness that this balance found has taken up what
    it could of the starts: a lag that is likelier beside it is more so beside less.
    """
    blocks = found.blocks
    since_s = _since_breakaway(reading, blocks)
    shortest_s = max(_SHORTEST_S, lag.value + lag.std_error if lag.value > 0.0 else 0.0)
    longest_s = _LONGEST_SHARE * float(np.max(since_s[np.isfinite(since_s)], initial=0.0))
    if longest_s < 2.0 * shortest_s:
        return None
    spring, friction_n = found.known("k").value, abs(found.known("F_c").value)
    variance = (spring * reading.noise_m) ** 2 / blocks.rows + reading.path.noise_n**2
    columns = [blocks.travel_m, np.ones(blocks.count), blocks.direction, blocks.rate_n_per_s]
    plain = problem_of(blocks, columns, variance, {3: lag})
    covariance = covariance_of(plain, found.roughness.logarithms(), found.smoothness)

    def surprise(lag_s: float) -> float:
        longer = Known(lag_s, _TIED * lag_s)
        return fit(_starting(blocks, since_s, variance, longer, _START_SHARE * friction_n), covariance).objective

    tried_s = np.geomspace(shortest_s, longest_s, 1 + math.ceil(math.log(longest_s / shortest_s) / _APART)).tolist()
    least, lag_s = min((surprise(lag_s), lag_s) for lag_s in tried_s)
    is_one = lag_s > tried_s[0] and fit(plain, covariance).objective - least > _LIKELIER
    return Known(lag_s, _LAG_SHARE * lag_s) if is_one else None


def _starting(blocks: Blocks, since_s: FloatArray, variance: FloatArray, lag: Known, start_n: float) -> Problem:
    """The balance of a stem whose speed comes to the ramp's within a lag after each breakaway."""
    left = np.exp(-since_s / lag.value)
    columns = [blocks.travel_m, np.ones(blocks.count), blocks.direction, blocks.rate_n_per_s * (1.0 - left)]
    return problem_of(blocks, [*columns, blocks.direction * left], variance, {3: lag, 4: Known(0.0, start_n)})


def _since_breakaway(reading: Reading, blocks: Blocks) -> FloatArray:
    """Time of each block since its move broke away, s; infinite behind a corner and where none was seen."""
    since_s = np.full(blocks.count, math.inf)
    for move in reading.segmentation.breakaways:
        corners_s = reading.path.corners_s[reading.path.corners_s > move.began_s]
        ends_s = min([float(reading.time_s[move.last]), *corners_s[:1].tolist()])
        inside = (blocks.time_s >= move.began_s) & (blocks.time_s <= ends_s)
        since_s[inside] = blocks.time_s[inside] - move.began_s
    return since_s


def stops_at(lag_s: float, as_of_s: float) -> float:
    """The share of its ramp's speed at which a stem of this lag rests that coasts as long as one of another lag, s.

    Behind a ramp that turns back its speed is 2 exp(-t / lag) - 1 of the ramp's.
    """
    return 2.0 * math.exp(-as_of_s * math.log(2.0) / lag_s) - 1.0
