"""A force recording of a drive without a spring, made ready: its balance of forces, low-pass filtered alike."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.fft import rfft

from estimators.base import Outcome
from estimators.drive.equation import Spectra, Window, spectra, window
from estimators.drive.fit import usable_rows
from estimators.drive.recording import evenly_sampled
from estimators.drive.search import search
from estimators.motion.moving_rows import find_moving_rows
from estimators.samples import BoolArray, FloatArray, Samples, prepare
from valve.nameplate import Nameplate
from valve.recording import Recording

# Half the gain is at 20 Hz: friction and mass show below, a drive's own flexibility above (docs/diagnosis.md).
_WINDOW_S: Final = 0.025
BASE: Final = ("m", "F_v", "F_c", "F_0")
_FEWEST_ROWS: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class ForceRecord:
    """One recording: ``base`` (n, 4) are the filtered regressors of BASE, ``jerk`` that of a delay, ``force_n`` (n,).

    ``rows`` (n,) are those where friction has a known sense; ``velocity`` and ``sense`` are not filtered yet.
    ``noise`` (5, 5) is what the position's noise adds to the normal matrix of base and jerk for each row.
    """

    samples: Samples
    velocity: FloatArray
    sense: FloatArray
    rows: BoolArray
    base: FloatArray
    jerk: FloatArray
    force_n: FloatArray
    noise: FloatArray
    channels: Spectra
    window: Window

    @property
    def time_s(self) -> FloatArray:
        """Times from the record's start, shape (n,)."""
        return np.asarray(self.samples.time_s - self.samples.time_s[0])

    def filtered(self, column: FloatArray) -> FloatArray:
        """Return a column, shape (n,), in any unit, filtered as the force is."""
        return np.asarray(self.channels.filtered(rfft(column, self.channels.length), self.window.force))


def read_force_record(recording: Recording, nameplate: Nameplate) -> ForceRecord | Outcome:
    """Return the recording as rows of the force balance, or the outcome that says why there is none."""
    found = prepare(recording, nameplate)
    if isinstance(found, Outcome):
        return found
    samples = evenly_sampled(found)
    if samples is None:
        return Outcome.TOO_FEW_SAMPLES
    moving = find_moving_rows(samples)
    if moving is None:
        return Outcome.NEVER_MOVED
    if set(np.unique(moving.sense).tolist()) >= {-1, 1}:
        fitted = search(samples, moving, both_directions=True)
    else:
        return Outcome.ONE_DIRECTION_ONLY
    if fitted is None:
        return Outcome.TOO_FEW_SAMPLES
    half = max(fitted.fit.window.half_width, math.floor(0.5 * _WINDOW_S / samples.period_s) - 1)
    used = window(half, samples.period_s)
    rows = usable_rows(samples, fitted.senses.unsure, used.reach + 1)
    if np.count_nonzero(rows) < _FEWEST_ROWS:
        return Outcome.TOO_FEW_SAMPLES
    channels = spectra(samples.position_m, samples.force_n, fitted.senses.sense, used.reach + 1)
    base, force_n = channels.rows(used)
    jerk = np.convolve(used.acceleration, (0.5, 0.0, -0.5), mode="same") / samples.period_s
    kernels = np.zeros((len(BASE) + 1, jerk.size))
    kernels[0], kernels[1], kernels[-1] = used.acceleration, used.velocity, jerk
    return ForceRecord(
        samples,
        moving.velocity,
        fitted.senses.sense,
        rows,
        base,
        channels.filtered(channels.position, jerk),
        force_n,
        samples.position_noise_m**2 * kernels @ kernels.T,
        channels,
        used,
    )
