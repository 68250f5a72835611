"""Where to start from: what each cause would be by the balance of forces in steady motion, where all is linear.

In steady motion S_a P = k x + F_0 + s F_c + F_v v, and most causes add a term whose size is linear once their shape is
fixed. A least-squares fit of it gives the size of the cause and what k, F_0, F_c and F_v become with it: a start near
the bottom, where the motion's own cost has many basins. A cause that is in the valve already adds its term too, of
the shape that it has: else what it leaves of the balance hides what comes beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from discrepancy.balance import COLUMNS, TIMES_K, Sliding
from discrepancy.causes.base import Cause, Setting, Values
from discrepancy.causes.friction import ASYMMETRY
from discrepancy.least_squares import Fit
from discrepancy.registry import CAUSES
from discrepancy.residuals import coordinates_of
from estimators.samples import FloatArray

_SLOWER: Final = 0.5  # of the speed at which the force leads the stem: slower is a start or an end
_FASTER: Final = 2.0  # than it: beyond is a slip
_FEWEST_ROWS: Final = 100
_FEWEST_SHARE: Final = 0.2  # of the blocks in motion
_MARGIN: Final = 12  # blocks about a start or an end of steady motion, as the most
_MARGIN_S: Final = 0.12
_LEAST: Final = 1.0e-12
_PLAIN: Final = 4  # columns of the plain valve
_FEWEST_BREAKAWAYS: Final = 4
_EARLY: Final = 0.25
_RATES_APART: Final = 1.5  # times: the fast ramps' speed over the slow ones', from which on F_v is told from F_c
_VISCOUS_SHARE: Final = 0.05  # of the friction in motion
_SPOTS: Final = 2
_LEAST_RISE: Final = 0.03  # of F_s, that a breakaway at a tight spot needs more
_SPOT_WIDTH: Final = 0.02  # of the travel that was swept
_VISCOUS_SHARES: Final = (0.05, 0.003)  # of the friction in motion: a stem in grease, and a dry one that jumps


def sliding_rows(fit: Fit) -> Sliding | None:
    """Return the rows of steady motion; None where there are too few, and in a stick-slip."""
    at = coordinates_of(fit)
    moving, speed = at["moving"] > 0.0, at["speed"]
    # a stem that slides follows the ramp at F'/k, whichever rate the ramp has
    ramp = np.abs(at["force rate"]) / fit.values["k"]
    steady = moving & (speed > _SLOWER * ramp) & (speed < _FASTER * ramp)
    # polled rows are further apart than blocks are: a dozen of them about each end would leave none of a fast ramp
    margin = min(_MARGIN, math.ceil(_MARGIN_S / fit.model.observed.motions[0].samples.period_s))
    held = np.convolve((~steady).astype(np.float64), np.ones(2 * margin + 1), mode="same") > 0.5
    rows = np.flatnonzero(~held)
    if rows.size < max(_FEWEST_ROWS, _FEWEST_SHARE * np.count_nonzero(moving)):
        return None
    velocity = at["velocity"][rows]
    return Sliding(at["travel"][rows], velocity, np.sign(velocity), at["force"][rows], at["time"][rows])


def sliding_starts(
    rows: Sliding, fit: Fit, causes: Iterable[Cause], setting: Setting
) -> dict[str, tuple[float, Values]]:
    """Return by cause the share of the misfit of forces that it takes, and its best start with the valve's values."""
    base = np.column_stack([rows.base, *_present(rows, fit)])
    scale = np.maximum(np.linalg.norm(base, axis=0), _LEAST)
    basis = np.linalg.svd(base / scale, full_matrices=False)[0]
    left = _without(basis, rows.force_n)
    misfit = max(float(left @ left), _LEAST)
    found: dict[str, tuple[float, Values]] = {}
    for cause in causes:
        if cause.name not in COLUMNS:
            continue
        best: tuple[float, Values, FloatArray] | None = None
        for start in cause.starts(setting):
            own = {**cause.held(setting), **start}
            column = COLUMNS[cause.name](rows, own)
            rest = _without(basis, column)
            size = float(rest @ rest)
            if size <= 1.0e-10 * max(float(column @ column), _LEAST):
                continue
            share = float(rest @ left) ** 2 / size / misfit
            if best is None or share > best[0]:
                best = (share, start, column)
        if best is not None:
            values = _values(rows, fit, _Added(cause, best[1], cause.held(setting), best[2]))
            if values is not None:
                found[cause.name] = (best[0], values)
    return found


def sliding_valve(rows: Sliding, fit: Fit) -> Values | None:
    """Return the valve, with its causes, by the balance of forces in steady motion; None where that makes none.

    What ends a motion adds nothing to it: it is the valve beside a travel stop, whatever the rests there made of a fit.
    """
    return _values(rows, fit, None)


def steady_valve(rows: Sliding, fit: Fit) -> Values | None:
    """Return the valve by the balance of forces in steady motion and at the breakaways; None where it tells none.

    With the causes that are in it, and no other. The stem must slide at rates that tell F_v from F_c.
    """
    present = _with_a_term(fit)
    columns = np.column_stack([rows.base, *_present(rows, fit)])
    scale = np.maximum(np.linalg.norm(columns, axis=0), _LEAST)
    solved = np.linalg.lstsq(columns / scale, rows.force_n, rcond=1.0e-9)[0] / scale
    spring, preload_n, coulomb_n, viscous = (float(value) for value in solved[:_PLAIN])
    slow, fast = np.quantile(np.abs(rows.velocity), (0.1, 0.9))
    if not (spring > 0.0 and coulomb_n > 0.0 and viscous > 0.0) or fast < _RATES_APART * slow:
        return None
    sizes = [float(value) for value in solved[_PLAIN:]]
    terms = [(one, _own(fit, one), size) for one, size in zip(present, sizes, strict=True)]
    static_n = _static_friction(fit, terms, spring, preload_n)
    if static_n is None:
        return None
    return {
        **{one.own(one.strength): _strength(one, size, spring) for one, _, size in terms},
        **usual_values(fit),
        "k": spring,
        "F_0": preload_n - _by_direction(fit) * coulomb_n,
        "F_c": coulomb_n,
        "F_v": viscous,
        "d": max(static_n / coulomb_n - 1.0, 0.0),
    }


def spots_at_rests(rows: Sliding, fit: Fit, setting: Setting) -> list[Values]:
    """Return tight spots by the breakaways that overcame most, beyond F_s, each with the valve by the balance.

    A stem that a spot has stopped is not seen to slide there: where it rests is the spot, and what lets it go its rise.
    """
    balance = plain_balance(rows)
    if fit.model.causes or balance is None:
        return []
    spring, preload_n, kinetic_n, speed = balance
    needed_n, place_m = needed_friction(fit, (), spring, preload_n)
    if needed_n.size < _FEWEST_BREAKAWAYS:
        return []
    static_n = float(np.quantile(needed_n, _EARLY))
    highest = np.argsort(needed_n)[::-1][:_SPOTS]
    found: list[Values] = []
    for one, viscous_share in product(highest, _VISCOUS_SHARES):
        rise_n, coulomb_n = float(needed_n[one]) - static_n, (1.0 - viscous_share) * kinetic_n
        if rise_n > _LEAST_RISE * static_n:
            spot = {"rise_n": rise_n, "centre_m": float(place_m[one]), "width_m": _SPOT_WIDTH * setting.swept_m}
            viscous = viscous_share * kinetic_n / speed
            valve = {"k": spring, "F_0": preload_n, "F_c": coulomb_n, "F_v": viscous, "d": static_n / coulomb_n - 1.0}
            found.append({**spot, **usual_values(fit), **valve, "d": max(valve["d"], 0.0)})
    return found


def plain_balance(rows: Sliding) -> tuple[float, float, float, float] | None:
    """Return spring rate, preload and friction in motion by the plain balance, and the usual speed; None for no valve.

    How much of that friction is damping is not asked: ramps of one rate do not tell.
    """
    scale = np.maximum(np.linalg.norm(rows.base, axis=0), _LEAST)
    solved = np.linalg.lstsq(rows.base / scale, rows.force_n, rcond=1.0e-9)[0] / scale
    spring, preload_n, coulomb_n, viscous = (float(value) for value in solved)
    speed = float(np.median(np.abs(rows.velocity)))
    kinetic_n = coulomb_n + viscous * speed
    return (spring, preload_n, kinetic_n, speed) if spring > 0.0 and kinetic_n > 0.0 and speed > 0.0 else None


def usual_values(fit: Fit) -> Values:
    """Mass and DV as one would begin with, and a first breakaway like the others."""
    priors = {one.name: one.value(one.prior) for one in fit.model.unknowns.entries if one.name in {"m", "DV"}}
    return {**priors, "first_rise": 0.0}


def _by_direction(fit: Fit) -> float:
    """The share by which friction differs by direction, which the balance has as a preload."""
    return fit.values.get(ASYMMETRY.own(ASYMMETRY.strength), 0.0)


def _present(rows: Sliding, fit: Fit) -> list[FloatArray]:
    """Terms of the causes that are in the valve already, each of strength 1 and shape (n,)."""
    return [COLUMNS[cause.name](rows, _own(fit, cause)) for cause in _with_a_term(fit)]


def _with_a_term(fit: Fit) -> list[Cause]:
    return [CAUSES[name] for name in fit.model.causes if name in COLUMNS]


def _own(fit: Fit, cause: Cause) -> Values:
    """Parameters of a cause in the valve, as the fit has them."""
    start = cause.own("")
    return {name.removeprefix(start): value for name, value in fit.values.items() if name.startswith(start)}


def _without(basis: FloatArray, column: FloatArray) -> FloatArray:
    return np.asarray(column - basis @ (basis.T @ column))


@dataclass(frozen=True, slots=True, eq=False)
class _Added:
    """A cause that comes to those in the valve: its start, what of it is held, and its term of strength 1, (n,)."""

    cause: Cause
    start: Values
    held: Values
    column: FloatArray

    def strength(self, size: float, spring: float) -> Values:
        """Its start with the strength that a term of this size is."""
        return {**self.start, self.cause.strength: _strength(self.cause, size, spring)}


def _strength(cause: Cause, size: float, spring: float) -> float:
    return size / spring if cause.name in TIMES_K else size


def _values(rows: Sliding, fit: Fit, added: _Added | None) -> Values | None:
    """Values of the valve, and of a cause that comes to it, by a fit of all of them; None where they are no valve's."""
    present = _with_a_term(fit)
    more = [] if added is None else [added.column]
    columns = np.column_stack([rows.base, *_present(rows, fit), *more])
    scale = np.maximum(np.linalg.norm(columns, axis=0), _LEAST)
    solved = np.linalg.lstsq(columns / scale, rows.force_n, rcond=1.0e-9)[0] / scale
    spring, preload_n, coulomb_n, viscous = (float(value) for value in solved[:_PLAIN])
    sizes = [float(value) for value in solved[_PLAIN:]]
    own = fit.values
    if not (spring > 0.0 and coulomb_n > 0.0):
        return None
    pace = np.abs(rows.velocity)
    speed = float(np.median(pace))
    kinetic_n = coulomb_n + viscous * speed
    if kinetic_n <= 0.0:
        return None
    slow, fast = np.quantile(pace, (0.1, 0.9))
    if fast < _RATES_APART * slow or viscous <= 0.0:
        # one rate of ramps cannot tell F_v from F_c: both, and what goes with them, begin anew
        coulomb_n, viscous = (1.0 - _VISCOUS_SHARE) * kinetic_n, _VISCOUS_SHARE * kinetic_n / speed
    terms = [(one, _own(fit, one)) for one in present]
    terms += [] if added is None else [(added.cause, {**added.held, **added.start})]
    static_n = _static_friction(
        fit, [(*term, size) for term, size in zip(terms, sizes, strict=True)], spring, preload_n
    )
    if static_n is None:
        # the breakaway's excess over F_c stays: F_s at the reversals shifts with F_c
        static_n = coulomb_n + own["F_c"] * own["d"]
    return {
        **{one.own(one.strength): _strength(one, size, spring) for one, size in zip(present, sizes, strict=False)},
        **({} if added is None else added.strength(sizes[-1], spring)),
        "k": spring,
        "F_0": preload_n - _by_direction(fit) * coulomb_n,
        **usual_values(fit),
        "F_c": coulomb_n,
        "F_v": viscous,
        "d": max(static_n / coulomb_n - 1.0, 0.0),
    }


def _static_friction(
    fit: Fit, terms: Sequence[tuple[Cause, Values, float]], spring: float, preload_n: float
) -> float | None:
    """F_s, N, that the balance with the ``terms`` of causes, each with its size, needs at breakaway; None for too few.

    A low quantile over all breakaways: the first is harder than the others, and on a fast ramp they are seen late.
    """
    needed_n = needed_friction(fit, terms, spring, preload_n)[0]
    return float(np.quantile(needed_n, _EARLY)) if needed_n.size >= _FEWEST_BREAKAWAYS else None


def needed_friction(
    fit: Fit, terms: Sequence[tuple[Cause, Values, float]], spring: float, preload_n: float
) -> tuple[FloatArray, FloatArray]:
    """Friction that each breakaway overcame, N, and the place of its rest, m, both shape (b,)."""
    needed: list[FloatArray] = []
    places: list[FloatArray] = []
    for motion in fit.model.observed.motions:
        samples, breakaways = motion.samples, motion.phases.breakaways
        place = np.array([one.row for one in breakaways], dtype=np.int64)
        sense = np.array([float(one.direction) for one in breakaways])
        rest_m = np.array([one.rest_m for one in breakaways])
        rows = Sliding(rest_m, np.zeros(place.size), sense, samples.force_n[place], samples.time_s[place])
        left_n = rows.force_n - spring * rest_m - preload_n
        for cause, own, size in terms:
            left_n = left_n - size * COLUMNS[cause.name](rows, own)
        needed.append(sense * left_n)
        places.append(rest_m)
    return np.concatenate(needed), np.concatenate(places)
