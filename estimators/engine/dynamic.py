"""The dynamic level: m, F_v, DV and the rest from the motion of all sections, mixed over the fits that are left.

Of each fit the quantities that are reported are linear in its unknowns (m, F_v, k and DV in their logarithms): F_c, F_0
and F_s are averages over the travel swept and the time recorded. Fits that are nearly as likely as the best are mixed
by their marginal likelihoods, so that a mass which two of them see differently is as uncertain as they differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import NORMAL_95, student_95
from estimators.engine.balance import Balance
from estimators.engine.breakaways import StaticFriction
from estimators.engine.fields import Fields, fields_over, knots_a_length, no_fields
from estimators.engine.fit import LEAST_LAG_S, Found, equations_of, explored
from estimators.engine.force_path import Source, coloured_covariance
from estimators.engine.hyperparameters import field_likelihood, spread
from estimators.engine.lateness import coasting
from estimators.engine.laws import NO_LAWS, Laws, PathToFit
from estimators.engine.model import Model, Unknowns
from estimators.engine.nodes import Sections
from estimators.engine.noise import position_noise_at_rest
from estimators.engine.parameters import FC, FO, FS, GLOBALS, LEAD, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, Known, prior_of
from estimators.engine.reading import Reading
from estimators.engine.roughness import RoughnessPrior
from estimators.engine.sections import sections_of
from estimators.engine.settings import USUAL, Settings

FloatArray = npt.NDArray[np.float64]

QUANTITIES: Final = ("m", "k", "F_v", "F_c", "F_s", "DV", "F_0")
_LOGARITHMS: Final = {"m": LN_M, "k": LN_K, "F_v": LN_V, "DV": LN_DV}
_NO_SHARE: Final = 1.0e-4  # of F_c: fields that small are none
_IDEAL_SHARE: Final = 2.0e-3  # fields that small are left out on trial
_LATENESS_SHARE: Final = 0.02  # of a row's period: how well the channels of one row are of one instant
_DOUBT: Final = 5.0
_FINE_ROWS_S: Final = 0.004
_MIXED: Final = 20.0  # of minus twice the logarithm of the likelihood: fits beyond it weigh nothing
_LEAST_SCATTER: Final = 2.0e-5
# Of a row's period: what is unknown of an instant, of the lag between force and position.
_ROW_INSTANT: Final = 0.2
_ROW_LAG: Final = 0.05
_SLOW_ROWS: Final = 2.0  # of the quick time m / F_v
# Of what a sensor's filter is slower by than this, so much is open of the instants of breakaway.
_QUICK_FILTER_S: Final = 0.01
_FILTERED: Final = 0.1
_SIDE: Final = 0.5  # of that: by how much it differs from one side to the other, and from end to end
# Of a rough valve: errors of fresh cases over their standard errors, root mean square. The model knows the shape of the
# friction's variation, of the gauge's and of the filter's lag less well than its likelihood says.
_DOUBT_OF: Final = {"m": 1.5, "F_v": 1.3, "k": 1.2, "F_0": 1.2}
# Roughness of so much of F_c doubles all variances: where friction changes along the travel about as steeply as the
# spring, how the motion answers to it is no longer linear.
_STEEP_SHARE: Final = 0.025
# Of DV: how well the instants at which a stem stops tell it, at several speeds and at one.
_STOPPING, _ONE_STOPPING = 0.003, 0.06
_ONE_RATE: Final = 1.5  # times the slowest ramp: quicker ones are of another speed
_CREEPING: Final = 0.25  # of F_s - F_c: what friction while the stem creeps below DV, in part at rest, is uncertain by


@dataclass(frozen=True, slots=True)
class Quantity:
    """A reported value, its standard error and its 95 % interval in its unit."""

    value: float
    std_error: float
    ci95: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Dynamic:
    """What the dynamic level gives: quantities by symbol, the scatter of F_s (N), and the best fit."""

    quantities: dict[str, Quantity]
    scatter_n: float
    best: Found
    fits: int  # that are mixed
    residual_rms_m: float
    creeping: dict[str, float]  # what a stem that creeps leaves open of k, F_c, F_s, F_0, F_v: standard errors


@dataclass(frozen=True, slots=True, eq=False)
class LatentFriction:
    """How friction differs from F_c along a coordinate, N, with its 95 % band, arrays of shape (n,).

    ``coordinate`` is "travel_m" (with a direction) or "time_s" (both directions); ``at`` holds places in its unit.
    """

    coordinate: str
    direction: str | None
    at: FloatArray
    force_n: FloatArray
    low_n: FloatArray
    high_n: FloatArray


def latent_friction(found: Found) -> list[LatentFriction]:
    """Return the fields of a fit as data: opening, closing and in time; nothing where it has none."""
    fields = found.model.fields
    if fields.count == 0:
        return []
    travel = fields.travel_m.size
    values = found.unknowns.fields
    half_n = NORMAL_95 * np.sqrt(np.diag(found.covariance)[GLOBALS : GLOBALS + fields.count])
    parts = (
        ("travel_m", "opening", fields.travel_m, slice(0, travel)),
        ("travel_m", "closing", fields.travel_m, slice(travel, 2 * travel)),
        ("time_s", None, fields.time_s, slice(2 * travel, fields.count)),
    )
    return [
        LatentFriction(coordinate, direction, at, values[part], (values - half_n)[part], (values + half_n)[part])
        for coordinate, direction, at, part in parts
    ]


def dynamic(
    reading: Reading,
    lag: Known,
    balance: Balance,
    static: StaticFriction,
    path: PathToFit | None = None,
    *,
    limit_share: float | None = None,
    settings: Settings = USUAL,
) -> Dynamic | None:
    """Return the dynamic level's answer, None where there is no section to follow.

    ``path`` is the force's where it has to be fitted too, None where it is known. ``limit_share`` is DV over the usual
    speed where corners show that instead of the lag.
    """
    fits = fitted(reading, lag, balance, static, path, limit_share=limit_share, settings=settings)
    return mixed(reading, fits, balance.prior.near(balance.roughness), static.count) if fits else None


def fitted(
    reading: Reading,
    lag: Known,
    balance: Balance,
    static: StaticFriction,
    path: PathToFit | None = None,
    *,
    limit_share: float | None = None,
    settings: Settings = USUAL,
) -> list[Found]:
    """Return the fits of the motion, the likeliest first; none where there is no section to follow."""
    sections = sections_of(reading, lag)
    if sections.count == 0 or "k" not in balance.symbols or balance.known("k").value <= 0.0:
        return []
    noise = position_noise_at_rest(
        reading.time_s, reading.position_m, reading.segmentation.rests, reading.noise_m, reading.least_noise_m
    )
    start = _start(balance, static)
    speed = float(np.median([np.median(np.abs(one.rate_n_per_s)) for one in sections.sections]))
    spring = balance.known("k").value
    slow_s = max(lag.value, LEAST_LAG_S)
    late_s = reading.path.late_s
    unsure_s = 0.5 * abs(late_s) + _LATENESS_SHARE * reading.samples.period_s
    middle_s = 0.5 * late_s if reading.path.lag_s == 0.0 else 0.0
    prior = prior_of(spring * slow_s, (middle_s, unsure_s))
    start[LEAD] = middle_s
    scatter_n = max(static.scatter_n or 0.0, _LEAST_SCATTER * static.mean_n)
    laws = Laws((path.law,)) if path else NO_LAWS
    is_tail = coasting(reading).is_tail
    fits: list[Found] = []
    noise_m = noise.white_m if reading.samples.period_s < _FINE_ROWS_S else math.inf  # slow rows see no finer grid
    for fields in _fields_to_try(sections, balance, noise_m):
        model = Model(sections, fields, noise, prior, noise, scatter_n, laws=laws, settings=settings)
        unknowns = Unknowns(
            start,
            np.zeros(fields.count),
            np.array([section.began_s for section in sections.sections]),
            np.array([section.rest_m for section in sections.sections]),
            laws.start,
        )
        found = explored(
            model,
            unknowns,
            model.measured_paths(),
            slow_s=slow_s,
            speed_m_per_s=speed / spring,
            prior=balance.prior.near(balance.roughness),
            path=path,
            limit_share=limit_share,
            is_tail=is_tail,
        )
        fits += found
        sections = found[0].model.sections  # what is left out of one is left out of all: likelihoods are compared
    return sorted((one for one in fits if math.isfinite(one.surprise)), key=lambda one: one.surprise)


def _start(balance: Balance, static: StaticFriction) -> FloatArray:
    start = np.zeros(GLOBALS)
    start[LN_K] = math.log(balance.known("k").value)
    start[FO], start[FC] = balance.known("F_0").value, max(balance.known("F_c").value, 1.0e-6)
    start[FS] = max(static.mean_n, 1.0e-6)
    start[LN_DV] = math.log(2.0e-4)
    return start


def _fields_to_try(sections: Sections, balance: Balance, noise_m: float) -> list[Fields]:
    """The friction's fields as the balance has them; without any too where they are as good as none."""
    rough = balance.roughness
    largest_n = max(rough.common_n, rough.own_n, rough.wander_n)
    if largest_n < _NO_SHARE * balance.known("F_c").value:
        return [no_fields()]
    low_m = min(float(section.path_m.min()) for section in sections.sections)
    high_m = max(float(section.path_m.max()) for section in sections.sections)
    spans_s = [(float(section.time_s[0]), float(section.time_s[-1])) for section in sections.sections]
    # the balance, which sees means over blocks, may see half of the roughness
    size_n = 2.0 * math.hypot(rough.common_n, rough.own_n)
    knots = knots_a_length(size_n, balance.known("k").value * noise_m)
    rough_ones = fields_over((low_m, high_m), spans_s, rough, balance.smoothness, knots)
    ideal = largest_n < _IDEAL_SHARE * balance.known("F_c").value
    return [no_fields(), rough_ones] if ideal else [rough_ones]


def _averages(found: Found, reading: Reading) -> dict[str, FloatArray]:
    """The reported quantities as linear functions of the unknowns."""
    fields, count = found.model.fields, found.unknowns.count
    travel = fields.travel_m.size
    rows = {}
    for symbol, at in (*_LOGARITHMS.items(), ("F_c", FC), ("F_0", FO), ("F_s", FS)):
        rows[symbol] = np.zeros(count)
        rows[symbol][at] = 1.0
    if fields.count == 0:
        return rows
    swept: dict[int, FloatArray] = {}
    for direction in (1, -1):
        weight = np.zeros(travel)
        # also where a motion was left out of the fit: what it met is as unknown as the fields are there
        moves = [move for move in reading.segmentation.moves if move.direction == direction]
        ends = [end for move in moves for end in (move.first, move.last)]
        if ends:
            ends_m = reading.position_m[ends]
            inside = (fields.travel_m >= ends_m.min()) & (fields.travel_m <= ends_m.max())
            weight[inside] = 1.0 / max(1, int(inside.sum()))
        swept[direction] = weight
    opening, closing = slice(GLOBALS, GLOBALS + travel), slice(GLOBALS + travel, GLOBALS + 2 * travel)
    in_time = slice(GLOBALS + 2 * travel, GLOBALS + fields.count)
    # the mean over the whole record: each knot stands for half of the time to its neighbours
    edges_s = np.concatenate(
        [[reading.time_s[0]], 0.5 * (fields.time_s[1:] + fields.time_s[:-1]), [reading.time_s[-1]]]
    )
    share = np.diff(edges_s) / (edges_s[-1] - edges_s[0])
    rows["F_c"][opening], rows["F_c"][closing], rows["F_c"][in_time] = 0.5 * swept[1], 0.5 * swept[-1], share
    rows["F_0"][opening], rows["F_0"][closing] = 0.5 * swept[1], -0.5 * swept[-1]
    ratio = found.unknowns.parameters[FS] / max(found.unknowns.parameters[FC], 1.0e-9)
    rows["F_s"] = ratio * (rows["F_c"] - _unit(count, FC)) + _unit(count, FS)
    return rows


def _unit(count: int, at: int) -> FloatArray:
    out = np.zeros(count)
    out[at] = 1.0
    return out


def _of_fit(one: Found, reading: Reading, prior: RoughnessPrior, breakaways: int) -> tuple[FloatArray, FloatArray]:
    """Means and variances of the quantities by one fit, shape (7,) each."""
    unknowns, fields = one.unknowns, one.model.fields
    rows = np.array([row for _, row in _ordered(_averages(one, reading))])
    values = np.concatenate([unknowns.parameters, unknowns.fields, unknowns.began_s, unknowns.rest_m, unknowns.laws])
    means, variances = rows @ values, np.einsum("qi,ij,qj->q", rows, one.covariance, rows)
    settings = one.model.settings
    if fields.count and settings.roughness_spread:
        likelihood = field_likelihood(equations_of(one.model, unknowns, one.paths), rows)
        wider = None if likelihood is None else spread(fields, likelihood, prior)
        if wider is not None:
            means, variances = means + wider[0], wider[1]
    variances = max(1.0, one.chi) ** 2 * variances
    if fields.count and settings.doubted:
        for symbol, share in _DOUBT_OF.items():
            variances[QUANTITIES.index(symbol)] *= share**2
        variances *= 1.0 + (_rough_share(one) / _STEEP_SHARE) ** 2
    # the scatter is estimated from as many breakaways: Student's t instead of the normal distribution
    student_share = student_95(breakaways - 1) / NORMAL_95
    variances[QUANTITIES.index("F_s")] += one.model.scatter_n**2 / max(1, breakaways) * (student_share**2 - 1.0)
    if settings.force_scale:
        _add_force_scale(one, reading, variances)
    if settings.creeping:
        _add_creeping(one, variances)
    _add_unseen_wander(one, reading, variances)
    _add_stops(one, reading, variances)
    _add_filtered_starts(one, variances)
    _add_unknown_path(one, variances, reading)
    if settings.slow_rows:
        _add_slow_rows(one, variances, reading)
    return means, variances


def _rough_share(found: Found) -> float:
    """Size of the friction's roughness along the travel as a share of F_c."""
    rough = found.model.fields.roughness
    assert rough is not None, "fields have one"
    return math.hypot(rough.common_n, rough.own_n) / max(float(found.unknowns.parameters[FC]), 1.0e-9)


def mixed(reading: Reading, fits: list[Found], prior: RoughnessPrior, breakaways: int) -> Dynamic:
    """Return the quantities of these fits, mixed by their marginal likelihoods."""
    # what is left of a rough valve is not quite what the model says, and the likelihood is too sure of itself
    doubt = _DOUBT if fits[0].model.fields.count and fits[0].model.settings.tempered else 1.0
    fits = [one for one in fits if one.surprise - fits[0].surprise < _MIXED * doubt]
    weights = np.exp(-0.5 / doubt * np.array([one.surprise - fits[0].surprise for one in fits]))
    weights /= weights.sum()
    means, variances = (
        np.array(both) for both in zip(*(_of_fit(one, reading, prior, breakaways) for one in fits), strict=True)
    )
    mean = weights @ means
    variance = weights @ (variances + (means - mean) ** 2)
    quantities = {}
    for symbol, middle, error in zip(QUANTITIES, mean, np.sqrt(variance), strict=True):
        half = NORMAL_95 * float(error)
        if symbol in _LOGARITHMS:
            value = math.exp(middle)
            ends = (math.exp(middle - min(half, 50.0)), math.exp(min(middle + half, 300.0)))
            quantities[symbol] = Quantity(value, value * float(error), ends)
        else:
            quantities[symbol] = Quantity(float(middle), float(error), (float(middle) - half, float(middle) + half))
    best = fits[0]
    return Dynamic(
        quantities,
        best.model.scatter_n,
        best,
        len(fits),
        best.model.residual_rms(best.unknowns, best.paths, reading.noise_m),
        _creeping(best) if best.model.settings.creeping else {},
    )


def _usual_rate(found: Found) -> float:
    """Median rate of the force in the sections, N/s."""
    return float(np.median([np.median(np.abs(one.rate_n_per_s)) for one in found.model.sections.sections]))


def _add_force_scale(found: Found, reading: Reading, variances: FloatArray) -> None:
    """Add what the gauge's noise leaves open of the force's gain and offset: k, F_0 and frictions scale with it."""
    force_n, left_n = reading.path.force_n, reading.path.left_n
    design = np.column_stack([np.ones(force_n.size), force_n - force_n.mean()])
    offset, gain = np.diag(coloured_covariance(design, left_n, reading.time_s))
    parameters = found.unknowns.parameters
    for symbol in ("m", "k", "F_v"):
        variances[QUANTITIES.index(symbol)] += gain
    for symbol, at in (("F_c", FC), ("F_s", FS)):
        variances[QUANTITIES.index(symbol)] += gain * float(parameters[at]) ** 2
    variances[QUANTITIES.index("F_0")] += offset + gain * float(force_n.mean() - parameters[FO]) ** 2


def _creeping(found: Found) -> dict[str, float]:
    """What a stem leaves open that is driven at hardly more than DV, standard errors: it rests now and then, unseen.

    By the share (DV / speed)^2 of its motion, the friction seen is anything between F_c and F_s.
    """
    parameters, sections = found.unknowns.parameters, found.model.sections.sections
    spring, limit = math.exp(parameters[LN_K]), math.exp(parameters[LN_DV])
    speeds = np.array([float(np.median(np.abs(one.rate_n_per_s))) for one in sections]) / spring
    times_s = np.array([float(one.time_s[-1] - one.time_s[0]) for one in sections])
    share = float(times_s @ np.minimum(1.0, limit / np.maximum(speeds, 1.0e-12)) ** 2 / times_s.sum())
    error_n = _CREEPING * share * max(0.0, float(parameters[FS] - parameters[FC]))
    speed = float(times_s @ speeds / times_s.sum())
    swept_m = max(float(one.path_m.max()) for one in sections) - min(float(one.path_m.min()) for one in sections)
    side_n = _SIDE * error_n
    return {"F_c": error_n, "F_s": error_n, "F_0": side_n, "k": side_n / swept_m, "F_v": error_n / speed}


def _add_creeping(found: Found, variances: FloatArray) -> None:
    """Widen all of a stem that is driven at hardly more than DV."""
    for symbol, error in _creeping(found).items():
        at = _LOGARITHMS.get(symbol)
        unit = 1.0 if at is None else math.exp(found.unknowns.parameters[at])
        variances[QUANTITIES.index(symbol)] += (error / unit) ** 2


def _add_unseen_wander(found: Found, reading: Reading, variances: FloatArray) -> None:
    """Add what friction may have done in time while the stem rested, which the mean over the record has in it.

    Between two knots an Ornstein-Uhlenbeck process is a bridge, before the first and after the last it runs free.
    """
    rough, time_s = found.model.fields.roughness, found.model.fields.time_s
    if rough is None:
        return
    gaps_s = np.diff(time_s, prepend=reading.time_s[0], append=reading.time_s[-1])
    share = np.full(gaps_s.size, 1.0 / 12.0)
    share[[0, -1]] = 1.0 / 3.0
    walked = 2.0 * rough.wander_n**2 / rough.wander_s * share * gaps_s**3
    unseen_n2 = float(np.sum(np.minimum(walked, (rough.wander_n * gaps_s) ** 2))) / float(np.ptp(reading.time_s)) ** 2
    for symbol in ("F_c", "F_s"):
        variances[QUANTITIES.index(symbol)] += unseen_n2


def _add_stops(found: Found, reading: Reading, variances: FloatArray) -> None:
    """Add what a friction that varies, and a force that is not quite known, leave open of DV.

    A stem stops where what drives it exceeds friction by F_v DV only. A friction that varies by as much stops it as
    well: then the likelihood has one narrow maximum after the other, and each of them is sure of its DV. At one speed a
    longer lag and a higher DV stop the stem alike.
    """
    parameters, rough = found.unknowns.parameters, found.model.fields.roughness
    varies_n = float(np.std(reading.path.left_n))
    if rough is not None:
        varies_n = math.hypot(varies_n, rough.common_n, rough.own_n)
    stopping_n = math.exp(parameters[LN_V] + parameters[LN_DV])
    rates = [float(np.median(np.abs(one.rate_n_per_s))) for one in found.model.sections.sections]
    stopping = _ONE_STOPPING if max(rates) < _ONE_RATE * min(rates) else _STOPPING
    variances[QUANTITIES.index("DV")] += (varies_n / stopping_n) ** 2 + stopping**2


def _add_filtered_starts(found: Found, variances: FloatArray) -> None:
    """Add what a slow sensor leaves open of all breakaways' instants alike.

    Behind its filter a lighter stem that starts later looks the same. On fast ramps a millisecond is a good part of a
    small F_s.
    """
    slower_s = max(0.0, math.exp(found.unknowns.parameters[LN_FILTER]) - _QUICK_FILTER_S)
    variances[QUANTITIES.index("F_s")] += (_FILTERED * slower_s * _usual_rate(found)) ** 2


def _add_unknown_path(found: Found, variances: FloatArray, reading: Reading) -> None:
    """Widen what a gauge without a command leaves open: how late it is, and how an I/P rounds the force's corners.

    A stem whose own times are no longer looks the same.
    """
    if reading.path.source is not Source.LINES:
        return
    parameters, unknown_s = found.unknowns.parameters, 0.5 * abs(reading.path.late_s)
    slow_s = math.exp(parameters[LN_V] - parameters[LN_K])
    quick_s = math.exp(parameters[LN_M] - parameters[LN_V])
    slowest = min(float(np.median(np.abs(one.rate_n_per_s))) for one in found.model.sections.sections)
    variances[QUANTITIES.index("F_v")] += (2.0 * unknown_s / slow_s) ** 2
    variances[QUANTITIES.index("m")] += (2.0 * unknown_s / quick_s) ** 2
    variances[QUANTITIES.index("F_c")] += (unknown_s * slowest) ** 2
    variances[QUANTITIES.index("F_s")] += (unknown_s * _usual_rate(found)) ** 2


def _add_slow_rows(found: Found, variances: FloatArray, reading: Reading) -> None:
    """Widen what rows that are slower than the stem's own times leave open: instants, and so m and F_v altogether.

    Between such rows no corner tells whether a late pressure is the gauge's or the I/P's.
    """
    parameters, rate, period_s = found.unknowns.parameters, _usual_rate(found), reading.samples.period_s
    if period_s > _FINE_ROWS_S:
        for symbol in ("F_c", "F_s"):
            variances[QUANTITIES.index(symbol)] += (0.5 * reading.path.late_s * rate) ** 2
    variances[QUANTITIES.index("F_s")] += (_ROW_INSTANT * period_s * rate) ** 2
    variances[QUANTITIES.index("F_c")] += (_ROW_LAG * period_s * rate) ** 2
    slow_s = math.exp(parameters[LN_V] - parameters[LN_K])
    quick_s = math.exp(parameters[LN_M] - parameters[LN_V])
    if period_s > _SLOW_ROWS * quick_s:
        variances[QUANTITIES.index("m")] += (period_s / quick_s) ** 2
    if period_s > 0.5 * slow_s:
        variances[QUANTITIES.index("F_v")] += (period_s / slow_s) ** 2


def _ordered(rows: dict[str, FloatArray]) -> list[tuple[str, FloatArray]]:
    return [(symbol, rows[symbol]) for symbol in QUANTITIES]
