"""The search for the filter's window and for the rows whose friction has a known sense: each needs the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.drive.equation import Spectra, spectra, window
from estimators.drive.fit import ForceFit, fit_force, force_error_n, white_errors
from estimators.drive.senses import Senses, senses_by_force, surely_moving
from estimators.motion.moving_rows import MovingRows
from estimators.samples import Samples

# Own choices, tried on simulated axes of 1-200 kg at 0.1-100 um.
_NARROWEST: Final = 2
_WIDENING: Final = 1.6
_WIDEST_SHARE: Final = 1.0 / 12.0  # of the recording
_QUIET_SHARE: Final = 0.01  # noise in the filtered acceleration's mean square: little enough to start from
_NOISY_SHARE: Final = 0.1  # and to fit with at all, where some window has less
_ENOUGH_WORSE: Final = 0.15  # in the mean logarithm of the errors: wider windows only lose more
_ROUNDS: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class FittedForce:
    """The fit with the window and the rows that were found for it."""

    fit: ForceFit
    senses: Senses
    channels: Spectra
    force_error_n: float  # of one sample, taken as white


def search(samples: Samples, moving: MovingRows, *, both_directions: bool) -> FittedForce | None:
    """Return the fit with the least expected errors; None where no window leaves enough rows.

    The window is the maximum-likelihood weighting of white noise of force and position, to its form: frequencies
    count up to where m w^2 times the position's noise exceeds the force's error.
    """
    widest = _widths(samples)[-1]
    senses = surely_moving(moving)
    channels = spectra(samples.position_m, samples.force_n, senses.sense, widest + _NARROWEST)
    first = _first_fit(samples, channels, senses)
    if first is None or first.noise_share > _NOISY_SHARE:
        # the stem turns too often for what is wide enough: take every row, the friction's sense as it seems
        every = Senses(np.sign(moving.velocity), np.zeros(samples.count, dtype=np.bool_))
        bold_channels = channels.with_sense(every.sense)
        bold = _first_fit(samples, bold_channels, every)
        if bold is not None and (first is None or bold.noise_share < first.noise_share):
            first, senses, channels = bold, every, bold_channels
    if first is None:
        return None
    fit = first
    for _ in range(_ROUNDS if both_directions else 0):
        mass_kg, _, coulomb_n, preload_n = (float(value) for value in fit.coefficients)
        if not (mass_kg > 0.0 and coulomb_n > 0.0):
            break
        smooth = channels.filtered(channels.force, window(max(moving.half_window, _NARROWEST), samples.period_s).force)
        better = senses_by_force(samples, moving, smooth - preload_n, mass_kg, coulomb_n)
        better_channels = channels.with_sense(better.sense)
        again = fit_force(samples, better_channels, better.unsure, window(fit.window.half_width, samples.period_s))
        if again is None:
            break
        fit, senses, channels = again, better, better_channels
    candidates = _Remembered(_fits(samples, channels, senses))
    for _ in range(_ROUNDS):
        fit = _best_window(candidates, channels, fit, samples.position_noise_m)
    return FittedForce(fit, senses, channels, force_error_n(fit, samples.position_noise_m))


def _widths(samples: Samples) -> list[int]:
    """Half-widths to try, in rows."""
    widths, width = [_NARROWEST], _NARROWEST
    longest = int((samples.run_last - samples.run_first).max()) + 1
    most = min(_WIDEST_SHARE * samples.count, longest / 4.0)
    while (width := max(width + 1, round(_WIDENING * width))) <= most:
        widths.append(width)
    return widths


def _fits(samples: Samples, channels: Spectra, senses: Senses) -> Iterator[ForceFit]:
    """Fits from the narrowest window up, as long as rows are left."""
    for width in _widths(samples):
        fit = fit_force(samples, channels, senses.unsure, window(width, samples.period_s))
        if fit is None:
            return
        yield fit


def _first_fit(samples: Samples, channels: Spectra, senses: Senses) -> ForceFit | None:
    """The fit by the narrowest window that quietens the acceleration, or by the quietest there is."""
    quietest = None
    for fit in _fits(samples, channels, senses):
        if fit.noise_share <= _QUIET_SHARE:
            return fit
        if quietest is None or fit.noise_share < quietest.noise_share:
            quietest = fit
    return quietest


class _Remembered:
    """What an iterator gave, so that it can be gone through again and gone on with."""

    def __init__(self, source: Iterator[ForceFit]) -> None:
        self._source, self._seen = source, list[ForceFit]()

    def __iter__(self) -> Iterator[ForceFit]:
        yield from self._seen
        for fit in self._source:
            self._seen.append(fit)
            yield fit


def _best_window(candidates: Iterable[ForceFit], channels: Spectra, start: ForceFit, noise_m: float) -> ForceFit:
    """The fit whose expected errors of m, F_v and F_c are least, in the mean of their logarithms."""
    error_n = force_error_n(start, noise_m)
    best, least = start, np.inf
    for fit in candidates:
        if fit.noise_share > max(_NOISY_SHARE, start.noise_share):
            continue
        errors = white_errors(fit, channels, start.coefficients, noise_m, error_n)
        score = float(np.log(np.maximum(errors[:3], np.finfo(float).tiny)).mean())
        if score < least:
            best, least = fit, score
        elif score > least + _ENOUGH_WORSE:
            break
    return best
