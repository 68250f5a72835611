"""The fit of a drive without a spring whose force was measured: the error is on the force.

m, F_v, F_c and F_0 of F = m a + F_v v + F_c sgn v + F_0 + error. A position simulated from the force would drift
without bounds, as no spring draws it back: so the misfit is a force, and the encoder's position is taken for true but
for its white noise. F_0 has the sign that it has in m x'' = F - k x - F_0 - friction: the constant force that the
actuator needs to hold against, positive where it is pushed towards smaller positions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.interpolate import CubicSpline

from estimators.base import (
    NO_SPRING,
    NORMAL_95,
    Estimate,
    Outcome,
    ParameterEstimate,
    Status,
    absent,
    failed,
    in_order,
    measured,
    not_given,
    offset_estimate,
)
from estimators.drive.breakaways import static_friction
from estimators.drive.equation import COLUMNS
from estimators.drive.fit import correlated_errors, sampling_errors, slow_covariance, spring_that_shows
from estimators.drive.repeated_misfit import locked_errors, repeated_misfit
from estimators.drive.search import FittedForce, search
from estimators.motion.moving_rows import MovingRows, find_moving_rows
from estimators.samples import FloatArray, Samples, prepare
from valve.messages import joined, say
from valve.nameplate import Nameplate
from valve.recording import Recording

_METHOD: Final = "exact_motion"
_EVEN: Final = 1.0e-3  # of the period, as in Recording.is_evenly_sampled
_FEWEST_RUN_ROWS: Final = 8
_SURE: Final = 3.0  # standard errors by which a value must be unphysical
_SPRING_SURE: Final = 4.0
_SPRING_SHARE: Final = 0.3  # of the residual's mean square: a spring that takes as much belongs into the model
_BEYOND_CHANCE: Final = 1.3  # between errors by 24 waves each, of noise: 14 % is each one's own error
_NO_LIMIT_SPEED: Final = say(
    "limit_velocity_too_short", "what the stem does below DV is too short for the force to show it"
)
_AT_PLACES: Final = say(
    "friction_at_places", "friction that depends on the stem's position shows as this parameter: see the diagnosis"
)
_LITTLE_ACCELERATED: Final = say("little_accelerated", "the drive was accelerated too little for the noise")


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """Values (m, F_v, F_c, F_0) and their covariance, with the larger of both standard errors on its diagonal."""

    values: FloatArray
    covariance: FloatArray

    def error(self, symbol: str) -> float:
        place = COLUMNS.index(symbol)
        return math.sqrt(float(self.covariance[place, place]))

    def value(self, symbol: str) -> float:
        return float(self.values[COLUMNS.index(symbol)])

    def combination(self, first: str, second: str) -> tuple[float, float, float]:
        """Weight w for which first + w * second is known best, that sum, and its standard error."""
        one, two = COLUMNS.index(first), COLUMNS.index(second)
        weight = -float(self.covariance[one, two] / self.covariance[two, two])
        variance = float(self.covariance[one, one]) + weight * float(self.covariance[one, two])
        return weight, float(self.values[one] + weight * self.values[two]), math.sqrt(max(variance, 0.0))


def estimate_force_recording(recording: Recording, nameplate: Nameplate) -> Estimate:
    """Return m, F_v, F_c and F_0 (F_s where the stem broke away from rests) of a drive without a spring.

    Raises nothing for an odd recording: its status and message say what is wrong. ``residual_rms_m`` is None, the
    misfit is ``force_residual_rms_n`` of the diagnostics.
    """
    with np.errstate(all="ignore"):
        return _estimate(recording, nameplate)


def _estimate(recording: Recording, nameplate: Nameplate) -> Estimate:
    found = prepare(recording, nameplate)
    if isinstance(found, Outcome):
        return failed(_METHOD, found)
    if float(np.ptp(found.force_n)) <= 6.0 * found.force_noise_n:
        return failed(_METHOD, Outcome.NO_FORCE_CHANGE)
    samples = evenly_sampled(found)
    if samples is None:
        return failed(_METHOD, Outcome.TOO_FEW_SAMPLES)
    moving = find_moving_rows(samples)
    if moving is None:
        return failed(_METHOD, Outcome.NEVER_MOVED)
    directions = set(np.unique(moving.sense).tolist()) - {0}
    fitted = search(samples, moving, both_directions=len(directions) == 2)
    if fitted is None:
        return failed(_METHOD, Outcome.TOO_FEW_SAMPLES)
    return _concluded(samples, moving, fitted, directions)


def evenly_sampled(samples: Samples) -> Samples | None:
    """Return the samples at even times within each run, or None where no run is long enough.

    Jittered ones are drawn anew: the position by a cubic spline, the force straight between its samples.
    """
    steps = np.diff(samples.time_s)[samples.run_first[1:] == samples.run_first[:-1]]
    if steps.size and float(np.ptp(steps)) <= _EVEN * samples.period_s:
        return samples
    times, positions, forces, lengths = [], [], [], []
    for first in np.unique(samples.run_first).tolist():
        last = int(samples.run_last[first])
        if last - first + 1 < _FEWEST_RUN_ROWS:
            continue
        own = samples.time_s[first : last + 1]
        even = own[0] + samples.period_s * np.arange(int((own[-1] - own[0]) / samples.period_s) + 1)
        times.append(even)
        positions.append(CubicSpline(own, samples.position_m[first : last + 1])(even))
        forces.append(np.interp(even, own, samples.force_n[first : last + 1]))
        lengths.append(even.size)
    if not lengths or max(lengths) < _FEWEST_RUN_ROWS:
        return None
    ends = np.cumsum(lengths)
    return replace(
        samples,
        time_s=np.concatenate(times),
        position_m=np.concatenate(positions),
        force_n=np.concatenate(forces),
        run_first=np.repeat(ends - lengths, lengths),
        run_last=np.repeat(ends - 1, lengths),
    )


def _known(samples: Samples, fitted: FittedForce) -> _Known:
    """The largest of the standard errors: by slow scores, by the residual's spectrum (few events), by place and speed.

    To it comes what slow sampling leaves open.
    """
    covariance = slow_covariance(fitted.fit)
    slow = np.sqrt(np.diag(covariance))
    larger = np.maximum(slow, correlated_errors(fitted.fit, fitted.channels))
    locked = locked_errors(samples, fitted.fit)
    larger = np.where(locked > _BEYOND_CHANCE * larger, locked, larger)
    larger = np.hypot(larger, sampling_errors(fitted.fit, fitted.channels))
    # rounding alone is left where there is no noise
    larger = np.maximum(larger, 1.0e-9 * np.abs(fitted.fit.coefficients))
    stretch = larger / np.where(slow > 0.0, slow, 1.0)
    covariance = covariance * np.outer(stretch, stretch)
    np.fill_diagonal(covariance, larger**2)
    return _Known(fitted.fit.coefficients, covariance)


def _concluded(samples: Samples, moving: MovingRows, fitted: FittedForce, directions: set[int]) -> Estimate:
    known = _known(samples, fitted)
    both = len(directions) == 2
    diagnostics = _diagnostics(samples, fitted, known)
    positive = ("m", "F_v", "F_c") if both else ("m", "F_v")
    if any(known.value(symbol) < -_SURE * known.error(symbol) for symbol in positive):
        return failed(_METHOD, Outcome.UNPHYSICAL, diagnostics)
    parameters = _parameters(known, both=both)
    parameters["F_s"] = static_friction(
        samples,
        moving,
        known.value("m"),
        (known.value("F_c"), known.error("F_c")),
        (known.value("F_0"), known.error("F_0")),
    )
    if not both:
        parameters["F_s"] = absent(parameters["F_c"].note)
    repeated = repeated_misfit(samples, moving, fitted.fit)
    if repeated.is_much(abs(known.value("F_c"))):
        parameters |= {symbol: absent(_AT_PLACES) for symbol in ("m", "F_v")}
    complete = in_order(parameters)
    missing = [symbol for symbol in COLUMNS if complete[symbol].value is None]
    outcomes = [] if both else [Outcome.ONE_DIRECTION_ONLY]
    said = [outcome.message for outcome in outcomes]
    spring = spring_that_shows(fitted.fit, fitted.channels)
    if spring.spring_n_per_m > _SPRING_SURE * spring.std_error and spring.share > _SPRING_SHARE:
        said.append(
            say(
                "force_as_a_springs",
                "The force goes with the position by {rate:.4g N/m}, as a spring's does, and none is in the model: "
                "check the nameplate's action.",
                rate=float(spring.spring_n_per_m),
            )
        )
    if repeated.is_much(abs(known.value("F_c"))):
        said.append(
            say(
                "misfit_at_places",
                "The force misses {misfit:.3g N}, and {share:.0f %} of it is at the same places on every stroke, which "
                "m and F_v stand in for: see the diagnosis for what holds the stem there.",
                misfit=float(repeated.rms_n),
                share=float(repeated.share),
            )
        )
    status = Status.POOR if missing or said else Status.OK
    if all(complete[symbol].value is None for symbol in COLUMNS):
        status = Status.FAILED
    if missing:
        said.append(not_given(missing))
    diagnostics |= {
        "outcomes": [outcome.name for outcome in outcomes],
        "spring_that_shows_n_per_m": [spring.spring_n_per_m, spring.std_error],
        "share_at_places": repeated.share,
    }
    return Estimate(_METHOD, status, joined(" ", said), None, complete, diagnostics)


def _parameters(known: _Known, *, both: bool) -> dict[str, ParameterEstimate]:
    parameters = {
        "m": measured(known.value("m"), known.error("m"), reason=_LITTLE_ACCELERATED),
        "k": ParameterEstimate(0.0, note=NO_SPRING),
        "DV": absent(_NO_LIMIT_SPEED),
    }
    speed, sum_n, error_n = known.combination("F_c", "F_v")
    tied = say(
        "takes_more_speeds",
        "it takes more speeds; F_c + {speed:.3g m/s} * F_v = {sum:.5g N} is known to +-{half:.2g N}",
        speed=speed,
        sum=sum_n,
        half=NORMAL_95 * error_n,
    )
    parameters["F_v"] = measured(known.value("F_v"), known.error("F_v"), reason=tied)
    if not both:
        weight, sum_n, error_n = known.combination("F_c", "F_0")
        alone = absent(
            say(
                "drive_one_way_knows",
                "F_0 {weight:+.0f} * F_c = {sum:.5g N} is known to +-{half:.2g N}: {why}",
                weight=weight,
                sum=sum_n / weight,
                half=NORMAL_95 * error_n,
                why=Outcome.ONE_DIRECTION_ONLY.message,
            )
        )
        return parameters | {"F_c": alone, "F_0": alone}
    parameters["F_c"] = measured(known.value("F_c"), known.error("F_c"), reason=tied)
    parameters["F_0"] = offset_estimate(known.value("F_0"), known.error("F_0"), abs(known.value("F_c")))
    return parameters


def _diagnostics(samples: Samples, fitted: FittedForce, known: _Known) -> dict[str, Any]:
    fit = fitted.fit
    return {
        "raw": dict(zip(COLUMNS, known.values.tolist(), strict=True)),
        "std_error": {symbol: known.error(symbol) for symbol in COLUMNS},
        "force_residual_rms_n": fit.residual_rms_n,
        "force_error_n": fitted.force_error_n,
        "position_noise_m": samples.position_noise_m,
        "window_s": 2.0 * (fit.window.half_width + 1) * samples.period_s,
        "acceleration_noise_share": fit.noise_share,
        "rows": fit.count,
        "rows_at_rest": int(np.count_nonzero(fitted.senses.unsure)),
    }
