"""What the whole recorded motion says of a valve's values: Gauss and Newton's steps from them on, and where they end.

No method makes this check of itself: it fits no value that is given, it tells how far each one is from where it would
have to be for the exact motion to explain all that was measured, and how well that place is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.likelihood.certificate import Certificate, certify
from estimators.proof.whole_motion import SYMBOLS, WholeMotion
from estimators.samples import FloatArray

# What is believed of m, F_v and DV about the values checked: standard deviations of logarithms.
_BELIEF: Final = {"m": 1.0, "F_v": 2.3, "DV": 2.1}
_LOGARITHMIC: Final = np.array([symbol in _BELIEF for symbol in SYMBOLS])
_PRIOR: Final = np.array([_BELIEF.get(symbol, math.inf) ** -2.0 for symbol in SYMBOLS])
_MASS, _COULOMB, _STATIC, _LIMIT = (SYMBOLS.index(symbol) for symbol in ("m", "F_c", "F_s", "DV"))
_DELAY: Final = len(SYMBOLS)
_SHORTER: Final = 3  # times that a step is tried shorter
_LARGEST_STEP: Final = 1.0  # of a logarithm
_STRAIGHT: Final = 9.0  # of the sum of squares in noise's variances: a step of 3 standard errors is the last one
_FAR: Final = 4.0  # of the sum of squares beside the blocks: so much is left that
_HARDLY: Final = 0.5  # a step that takes no more than this share of it off leads nowhere soon
# A file has one time a row, so that a delay between its channels has one chance in twenty beforehand.
_DELAYED: Final = 0.05
_HELD: Final = 1.0e12  # 1 / variance of a logarithm that stays


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A valve's values (7,), the start of each section (s,), and what they leave, in the noise's variances."""

    values: FloatArray
    starts_m: FloatArray
    residual: FloatArray
    cost: float

    def certificate(self) -> Certificate:
        """Judge what is left."""
        return certify(self.residual, np.ones(self.residual.size))


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """The place that explains the recording best, from some values on; its certificate and its errors by symbol.

    ``std_error`` (7,) is the least that any method can have, the delay being known; ``by_delay`` (7,) one standard
    deviation of what the delay adds where it is not fitted, and ``by_delay_at_limit`` (7,) the same of a fit in which
    DV stays where it is: what DV would take up goes into m and F_v there.
    """

    place: Place
    certificate: Certificate
    std_error: FloatArray
    by_delay: FloatArray
    by_delay_at_limit: FloatArray


def place_of(seen: WholeMotion, values: FloatArray, starts_m: FloatArray | None = None) -> Place | None:
    """Return these values with what they leave; None where they are no valve's or its motion cannot be followed."""
    starts = np.array([section.start_m for section in seen.sections]) if starts_m is None else starts_m
    if not (bool(np.isfinite(values).all()) and bool((values[_LOGARITHMIC] > 0.0).all())):
        return None
    residual = seen.residual(values, starts)
    return None if residual is None else Place(values, starts, residual, float(residual @ residual))


def prove(seen: WholeMotion, first: Place, most_steps: int) -> Proof | None:
    """Return where so many steps lead from this place; None where the motion has no derivatives there."""
    at, normal = first, _normal_equations(seen, first)
    for _ in range(most_steps):
        if normal is None:
            return None
        moved = _stepped(seen, first, at, *normal)
        if moved is None:
            break
        gained, at = at.cost - moved.cost, moved
        if gained < _STRAIGHT or (at.cost > _FAR * at.residual.size and gained < _HARDLY * at.cost):
            break
        normal = _normal_equations(seen, at)
    if normal is None:
        return None
    errors = _errors(seen, at, *normal)
    return None if errors is None else Proof(at, at.certificate(), *errors)


def _creep_n(seen: WholeMotion, values: FloatArray) -> float:
    """sqrt(2 m DV r): what the force of a ramp of rate r exceeds F_s by when the stem leaves the band of DV, N."""
    return math.sqrt(2.0 * float(values[_MASS] * values[_LIMIT]) * seen.breakaway_rate_n_per_s)


def _directions(seen: WholeMotion, at: Place) -> FloatArray:
    """Derivatives of the values to what is moved, shape (7, 7): logarithms, and F_s + sqrt(2 m DV r) in F_s's place.

    That sum is what the breakaways show sharply; along it F_s and DV lie in a valley that bends.
    """
    moves = np.diag(np.where(_LOGARITHMIC, at.values, 1.0))
    moves[_STATIC, [_MASS, _LIMIT]] = -0.5 * _creep_n(seen, at.values)
    return moves


def _normal_equations(seen: WholeMotion, at: Place) -> tuple[FloatArray, FloatArray] | None:
    """Matrix and right side of what is moved, the delay and the starts."""
    slopes = seen.slopes(at.values, at.starts_m)
    if slopes is None:
        return None
    moves = np.eye(slopes.shape[0])
    moves[: len(SYMBOLS), : len(SYMBOLS)] = _directions(seen, at)
    return moves.T @ (slopes @ slopes.T) @ moves, moves.T @ (slopes @ at.residual)


def _prior(at: Place) -> FloatArray:
    """What is believed beforehand, 1 / variance, shape (8 + s,); nothing of the delay, which stands apart."""
    return np.concatenate([_PRIOR, np.zeros(1 + at.starts_m.size)])


def _inverse(matrix: FloatArray) -> FloatArray | None:
    scale = np.sqrt(np.diag(matrix))
    scale[scale == 0.0] = 1.0
    try:
        inverse = np.linalg.inv(matrix / np.outer(scale, scale) + 1.0e-13 * np.eye(scale.size))
    except np.linalg.LinAlgError:
        return None
    return np.asarray(inverse / np.outer(scale, scale))


def _without_delay(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.delete(np.delete(matrix, _DELAY, axis=0), _DELAY, axis=1))


def _stepped(seen: WholeMotion, first: Place, at: Place, normal: FloatArray, side: FloatArray) -> Place | None:
    """The next place; None where no step betters it. The delay is not moved, it belongs to the errors."""
    prior = _prior(at)
    inverse = _inverse(_without_delay(normal + np.diag(prior)))
    if inverse is None:
        return None
    offset = np.zeros(side.size)
    offset[: len(SYMBOLS)][_LOGARITHMIC] = np.log(at.values[_LOGARITHMIC] / first.values[_LOGARITHMIC])
    step = inverse @ np.delete(side - prior * offset, _DELAY)
    for shorter in range(_SHORTER):
        new = _moved(seen, at, step * 0.25**shorter)
        if new is not None and new.cost < at.cost:
            return new
    return None


def _moved(seen: WholeMotion, at: Place, step: FloatArray) -> Place | None:
    own = step[: len(SYMBOLS)]
    factor = np.exp(np.clip(own, -_LARGEST_STEP, _LARGEST_STEP))
    values = np.where(_LOGARITHMIC, at.values * factor, at.values + own)
    values[_COULOMB] = max(values[_COULOMB], 0.0)
    values[_STATIC] += _creep_n(seen, at.values) - _creep_n(seen, values)
    values[_STATIC] = max(values[_STATIC], values[_COULOMB])
    return place_of(seen, values, at.starts_m + step[len(SYMBOLS) :])


def _errors(
    seen: WholeMotion, at: Place, normal: FloatArray, side: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Standard errors (7,) in SI with the delay known, and what an unfitted delay adds to them (7,), DV free or not.

    Values that are fitted without the delay t answer to it by N^-1 n t, n its column. Where nothing sure is said of the
    delay, ``delay_doubt_s``, it counts with the weight that data and belief give it, by Laplace's approximation.
    """
    prior = _prior(at)
    inverse = _inverse(_without_delay(normal + np.diag(prior)))
    held = np.where(np.arange(prior.size) == _LIMIT, _HELD, prior)
    stiff = _inverse(_without_delay(normal + np.diag(held)))
    if inverse is None or stiff is None:
        return None
    moves = _directions(seen, at)
    column = np.delete(normal[:, _DELAY], _DELAY)
    answers = [np.abs(moves @ (one @ column)[: len(SYMBOLS)]) for one in (inverse, stiff)]
    delay_squared = seen.delay_sd_s**2
    if seen.delay_doubt_s > 0.0:
        # what is left of the delay's own information, and its pull, when all else follows it
        own = seen.delay_doubt_s**-2.0 + max(float(normal[_DELAY, _DELAY] - column @ inverse @ column), 0.0)
        pull = float(side[_DELAY] - column @ inverse @ np.delete(side, _DELAY))
        found_s, spread_s = pull / own, own**-0.5
        odds = math.log(_DELAYED / (1.0 - _DELAYED)) + 0.5 * pull * found_s + math.log(spread_s / seen.delay_doubt_s)
        delay_squared += (found_s**2 + spread_s**2) / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
    variance = np.einsum("ij,jk,ik->i", moves, inverse[: len(SYMBOLS), : len(SYMBOLS)], moves)
    error = np.sqrt(np.clip(variance, 0.0, None))
    delay_s = math.sqrt(delay_squared)
    return error, answers[0] * delay_s, answers[1] * delay_s
