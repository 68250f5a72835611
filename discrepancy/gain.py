"""What naming a cause gains: errors of prediction where nothing was fitted, before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from scipy.optimize import minimize_scalar

from discrepancy.causes.base import Values
from discrepancy.growing import first_part
from discrepancy.intervals import drawn_points
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import simulated
from discrepancy.observed import Observed, observe
from discrepancy.unknowns import of_a_segment
from estimators.base import Outcome
from estimators.samples import FloatArray
from valve.errors import MotionError, ParameterError
from valve.nameplate import Nameplate
from valve.recording import Recording

LEFT_OUT: Final = "the part of the recording that was left out of the fit"
_KEPT_SHARE: Final = (0.5, 0.8)  # of the duration, within which the fitted part ends at a turn of the force
_USUAL_SHARE: Final = 0.65
_STEPS: Final = 8
_WORSE: Final = 1.02  # times the error before: a cause that predicts worse than this is none
_MUCH: Final = (
    3.0  # times the noise: what the plain valve misses then is more than chance, and a cause takes some of it
)
_FEWEST_ROWS: Final = 50
# Own choices: predictions drawn within the errors of the parameters, and how many of them have to be as good.
_DRAWN: Final = 12
_AS_GOOD: Final = 2
_SEED: Final = 1
_DELAY_ERRORS: Final = 4.0  # of what is known beforehand of a delay between channels, about the one that was fitted
_CLOSE: Final = 0.02  # of that
_TRIES: Final = 16
_FAR: Final = 1.0e30


@dataclass(frozen=True, slots=True)
class Gain:
    """Root mean square errors of the predicted position, m; ``noise_floor_m`` is what no model can go below.

    ``allowed_m`` is what the extended model may come to with other parameters within their errors, where its own
    prediction gained nothing: one slip more or less moves the stem for seconds, and no fit knows the last digits.
    """

    held_out: str
    rmse_before_m: float
    rmse_after_m: float
    noise_floor_m: float
    allowed_m: float | None = None

    @property
    def is_worse(self) -> bool:
        """Whether the extended model predicts worse than the baseline, by more than its parameters' errors allow."""
        return self._least_after_m > _WORSE * self.rmse_before_m

    @property
    def is_none(self) -> bool:
        """Whether the extended model takes nothing of what the baseline misses, though that is far beyond the noise."""
        return self.rmse_before_m > _MUCH * self.noise_floor_m and self._least_after_m > self.rmse_before_m / _WORSE

    @property
    def _least_after_m(self) -> float:
        return self.rmse_after_m if self.allowed_m is None else min(self.allowed_m, self.rmse_after_m)

    @property
    def share(self) -> float:
        """Share of what could be gained, by mean squares; NaN where there was nothing to gain."""
        possible = self.rmse_before_m**2 - self.noise_floor_m**2
        if possible <= 0.0:
            return math.nan
        return (self.rmse_before_m**2 - self.rmse_after_m**2) / possible

    def to_json(self) -> dict[str, Any]:
        """Return the gain as in the analysis object."""
        return {
            "held_out": self.held_out,
            "rmse_before_m": self.rmse_before_m,
            "rmse_after_m": self.rmse_after_m,
            "noise_floor_m": self.noise_floor_m,
        }


def held_out_gain(name: str, recording: Recording, nameplate: Nameplate, before: Fit, after: Fit) -> Gain | None:
    """Return the gain on a recording that had no part in the fits; None where it cannot be read or followed.

    How much later its pressure was read than its position is that recording's own, as its start is, and says nothing
    of the valve: where it is not known it is found in it, for both models alike.
    """
    observed = observe([recording], nameplate)
    if isinstance(observed, Outcome):
        return None
    free = _without_rests(observed)
    return _gain(name, free, (before, after), 0.0, (_own_delay(free, before), _own_delay(free, after)))


def prediction_error(recording: Recording, nameplate: Nameplate, fit: Fit) -> tuple[float, float] | None:
    """Return the error of the predicted position and the noise, m, for the pressure in this recording.

    An unknown delay between the channels is found in it, as ``held_out_gain`` does.
    """
    observed = observe([recording], nameplate)
    if isinstance(observed, Outcome):
        return None
    free = _without_rests(observed)
    error_m = _rmse(free, fit, 0.0, _own_delay(free, fit))
    return None if error_m is None else (error_m, observed.noise_m)


def left_out_gain(before: Fit, after: Fit) -> Gain | None:
    """Return the gain on the last part of the recording, with both models fitted to what comes before it.

    None where the recording is too short to leave a part out.
    """
    observed = before.model.observed
    if len(observed.segments) != 1:
        return None
    split_s = _split(observed)
    kept = observed.segments[0].time_s < split_s
    if min(np.count_nonzero(kept), np.count_nonzero(~kept)) < _FEWEST_ROWS:
        return None
    part = observed.of([first_part(observed.segments[0], split_s)])
    free = _without_rests(observed)
    first, second = (
        descend(start_fit(replace(fit.model, observed=part, thin=None), fit.point), most_steps=_STEPS)
        for fit in (before, after)
    )
    return _gain(LEFT_OUT, free, (first, second), split_s, (None, None))


def _own_delay(observed: Observed, fit: Fit) -> Values:
    """Return the delay between the channels with which a fit predicts what was ``observed`` best, by name, s."""
    delay = observed.delay
    if delay is None:
        return {"delay_s": 0.0}

    def cost(delay_s: float) -> float:
        try:
            predicted_m = simulated(observed, fit.model.valve(fit.point), _foreign(fit, {"delay_s": delay_s}))
        except (MotionError, ParameterError):
            return _FAR
        residual = observed.residuals(predicted_m)
        return float(residual @ residual) + ((delay_s - delay.start) / delay.prior_sd) ** 2

    fitted_s, off_s = fit.values.get("delay_s", delay.start), _DELAY_ERRORS * delay.prior_sd
    bounds = max(fitted_s - off_s, delay.lower), min(fitted_s + off_s, delay.upper)
    close = _CLOSE * delay.prior_sd
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": close, "maxiter": _TRIES})
    return {"delay_s": min((float(found.x), fitted_s, delay.start), key=cost)}


def _foreign(fit: Fit, own: Values) -> Values:
    """Return a fit's values for a recording that had no part in it, with the nuisances that are its own."""
    return {name: value for name, value in fit.values.items() if not of_a_segment(name)} | own


def _gain(
    name: str, free: Observed, fits: tuple[Fit, Fit], from_s: float, own: tuple[Values | None, Values | None]
) -> Gain | None:
    after = fits[1]
    before_m, after_m = (_rmse(free, fit, from_s, nuisances) for fit, nuisances in zip(fits, own, strict=True))
    if before_m is None or after_m is None:
        return None
    found = Gain(name, before_m, after_m, free.noise_m)
    if not ((found.is_worse or found.is_none) and after.is_followed):
        return found
    drawn = [replace(after, point=point) for point in drawn_points(after, _DRAWN, _SEED)]
    errors = [_rmse(free, one, from_s, own[1]) for one in drawn]
    followed = sorted(error for error in errors if error is not None)
    return replace(found, allowed_m=followed[_AS_GOOD - 1]) if len(followed) >= _AS_GOOD else found


class Measured(Protocol):
    """What any gain says."""

    @property
    def is_worse(self) -> bool:
        """Whether the extended model predicts worse than the baseline."""
        ...


GainT = TypeVar("GainT", bound=Measured)


def decisive(gains: Sequence[GainT]) -> GainT | None:
    """Return the gain to tell of: one that is worse before all others, then the first."""
    worse = [gain for gain in gains if gain.is_worse]
    return worse[0] if worse else (gains[0] if gains else None)


def _rmse(observed: Observed, fit: Fit, from_s: float, own: Values | None) -> float | None:
    """Error of prediction per row: that of the block means, and the noise that averaging took away.

    ``own``: the nuisances of a recording that had no part in the fit; None where it had.
    """
    values = fit.values if own is None else _foreign(fit, own)
    try:
        predicted_m = simulated(observed, fit.model.valve(fit.point), values)
    except (MotionError, ParameterError):
        return None
    chosen = observed.time_s >= from_s
    error_m = (observed.position_m - predicted_m)[chosen]
    count = _rows_in_blocks(observed)[chosen]
    mean_square = float(np.average(error_m**2, weights=count))
    taken = observed.noise_m**2 * (1.0 - error_m.size / float(count.sum()))
    return math.sqrt(mean_square + taken)


def _rows_in_blocks(observed: Observed) -> FloatArray:
    return np.concatenate([segment.rows for segment in observed.segments])


def _split(observed: Observed) -> float:
    motion = observed.motions[0]
    time_s = motion.samples.time_s
    first_s, length_s = float(time_s[0]), float(time_s[-1] - time_s[0])
    turns_s = time_s[motion.phases.corners]
    low_s, high_s = (first_s + share * length_s for share in _KEPT_SHARE)
    inside = turns_s[(turns_s >= low_s) & (turns_s <= high_s)]
    usual_s = first_s + _USUAL_SHARE * length_s
    return float(inside[np.argmin(np.abs(inside - usual_s))]) if inside.size else usual_s


def _without_rests(observed: Observed) -> Observed:
    """Return what was observed without restarts: a prediction is not told where the stem came to rest."""
    none = np.empty(0)
    return observed.of([replace(one, rest_time_s=none, rest_m=none, rest_sense=none) for one in observed.segments])
