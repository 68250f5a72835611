"""The likelihood of one recording: its rows and their weights, the unknowns, and where to look for them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.likelihood.coordinates import Coordinate, Coordinates, linear, logarithmic
from estimators.likelihood.inputs.input_path import CommandedPath, InputPath, TransducerPath
from estimators.likelihood.inputs.nuisance import Nuisance
from estimators.likelihood.lag_start import started_behind_lag
from estimators.likelihood.model import NO_NOISE, StemModel
from estimators.likelihood.places import Restarts
from estimators.likelihood.row_weights import row_noise, row_weights
from estimators.likelihood.search import measured_rests
from estimators.likelihood.start import Trial, first_guesses, trials
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import IntArray

# Own choices.
_START_ROWS: Final = 50
_OUT_OF_BALANCE: Final = 6.0  # standard deviations
_MOVED: Final = 4.0  # likewise, of a row that is out of balance
_FIRST_ROWS: Final = 6
_SPEEDS: Final = 3.0  # times what these rows show: between two of them it may be faster
_STILL_ROWS: Final = 3  # fewer before the first motion: the recording begins in it
# DV: lognormal about 1.5 % of the fastest ramp's sliding speed, and never above that speed.
_LIMIT_MEDIAN: Final = 0.015
_LIMIT_SD: Final = 1.5
_FASTEST: Final = 0.9  # quantile of the speeds in motion
# m: lognormal, as wide as the masses that there are, so that one that does not show is not taken to where it is nothing
_MASSES_KG: Final = (1.0e-2, 1.0e3)
_MASS_MEDIAN_KG: Final = math.sqrt(_MASSES_KG[0] * _MASSES_KG[1])
_MASS_SD: Final = math.log(_MASSES_KG[1] / _MASSES_KG[0]) / math.sqrt(12.0)
_LARGEST_STICTION: Final = 100.0  # F_s/F_c - 1
_STAIRCASE: Final = 6  # breakaways from which on jumps tell more than the balance of all motion


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The model with its trial values, the rests of the measured stem, and the noise of the position, m."""

    model: StemModel
    trials: list[Trial]
    rests: Restarts
    noise_m: float
    is_noise_free: bool
    fastest_m_per_s: float
    jumps: bool  # from rest to rest: the trials are those of a stem that sticks and slips


def pose(motion: RecordedMotion, path: InputPath) -> Problem | None:
    """Return the problem of this motion under this force; None where no balance of forces gives a start."""
    guessed = motion
    if isinstance(path, TransducerPath):
        path, guessed = started_behind_lag(path, motion)
    samples, phases = motion.samples, motion.phases
    guesses = first_guesses(guessed)
    if not guesses:
        return None
    jumping = [guess for guess in guesses if guess.jump_m is not None]
    jumps = bool(jumping) and len(phases.breakaways) >= _STAIRCASE
    if jumps:
        guesses = jumping
    range_m, range_n = float(np.ptp(samples.position_m)), float(np.ptp(samples.force_n))
    noise_m = max(row_noise(motion), NO_NOISE * range_m)
    moving = np.zeros(samples.count, dtype=np.bool_)
    for stretch in phases.stretches:
        moving[stretch.rows] = True
    fastest = float(np.quantile(np.abs(phases.velocity[moving]), _FASTEST))
    section_row = np.concatenate([[0], np.searchsorted(samples.time_s, path.breaks_s[:, 1])]).astype(np.int64)
    others = _section_values(motion, section_row) | _stop_values(motion)
    others |= {nuisance.name: nuisance.start for nuisance in path.nuisances}
    coordinates = Coordinates(
        (
            *_valve(range_n, fastest),
            *(linear(name, range_m) for name in others if name in ("low", "high") or name[0] == "x"),
            *(_first_speed(motion, name, others[name], section_row, fastest) for name in others if name[0] == "v"),
            *(_input(nuisance) for nuisance in path.nuisances),
        )
    )
    wanted = [
        replace(trial, values=trial.values | others)
        for guess in guesses
        for trial in trials(guess, motion.moving_mass_kg, fastest)
    ]
    model = StemModel(
        time_s=samples.time_s,
        position_m=samples.position_m,
        weight=row_weights(motion, noise_m),
        path=path,
        coordinates=coordinates,
        section_row=section_row,
        input_names=tuple(nuisance.name for nuisance in path.nuisances),
        range_m=range_m,
        stepped=isinstance(path, CommandedPath) and path.is_stepped,
    )
    rests = measured_rests(motion)
    return Problem(model, wanted, rests, noise_m, samples.position_noise_m == 0.0, fastest, jumps)


def _valve(range_n: float, fastest: float) -> list[Coordinate]:
    return [
        logarithmic("m", *_MASSES_KG, median=_MASS_MEDIAN_KG, sd=_MASS_SD),
        logarithmic("k", 1.0e-3, 1.0e12),
        logarithmic("F_v", 1.0e-9 * range_n / fastest, 1.0e3 * range_n / fastest),
        logarithmic("F_c", 1.0e-7 * range_n, range_n),
        linear("d", 1.0, low=0.0, high=_LARGEST_STICTION),
        linear("F_0", range_n),
        logarithmic("DV", 1.0e-5 * fastest, fastest, median=_LIMIT_MEDIAN * fastest, sd=_LIMIT_SD),
    ]


def _input(nuisance: Nuisance) -> Coordinate:
    return linear(
        nuisance.name,
        nuisance.scale,
        low=nuisance.lower,
        high=nuisance.upper,
        centre=nuisance.start,
        sd=nuisance.prior_sd,
    )


def _section_values(motion: RecordedMotion, section_row: IntArray) -> dict[str, float]:
    """Position, and in motion also velocity, at the first row of each section: x_0, v_0, x_1, ..."""
    values: dict[str, float] = {}
    position_m, velocity = motion.samples.position_m, motion.phases.velocity
    for number, row in enumerate(section_row):
        coming = [stretch for stretch in motion.phases.stretches if stretch.last >= row]
        first = coming[0].first if coming else position_m.size
        if first < row + _STILL_ROWS:
            windowed = float(velocity[row : row + 3].mean())
            speed = windowed if motion.uniform is not None else _speed_at(motion, int(row)) or windowed
            values |= {f"x_{number}": float(position_m[row]), f"v_{number}": speed}
        else:
            level_m = float(np.mean(position_m[row : min(first, row + _START_ROWS)]))
            off_m = abs(float(position_m[row]) - level_m)
            # out of balance the stem leaves its first position before the second sample or so
            is_off = off_m > _OUT_OF_BALANCE * motion.samples.position_noise_m + 1.0e-9 * abs(level_m)
            values[f"x_{number}"] = float(position_m[row]) if is_off else level_m
            speed = _speed_at(motion, int(row), _MOVED) if is_off and number > 0 else 0.0
            if speed != 0.0:
                # in the midst of a jump that is too short to be seen as a motion of its own
                values[f"v_{number}"] = speed
    return values


def _speed_at(motion: RecordedMotion, row: int, sigmas: float = _OUT_OF_BALANCE) -> float:
    """Velocity from this row to the next, m/s, where it is more than so many standard deviations of noise; else 0.

    In the midst of a jump a windowed one is that of the ramp.
    """
    samples = motion.samples
    if row >= samples.run_last[row]:
        return 0.0
    moved_m = float(samples.position_m[row + 1] - samples.position_m[row])
    is_clear = abs(moved_m) > sigmas * samples.position_noise_m
    return moved_m / float(samples.time_s[row + 1] - samples.time_s[row]) if is_clear else 0.0


def _first_speed(
    motion: RecordedMotion, name: str, speed_m_per_s: float, section_row: IntArray, fastest: float
) -> Coordinate:
    """The velocity v_j of section j, known beforehand as far as the first rows of the section show how fast it goes.

    An overdamped stem forgets it before the next row: it would stand for nothing, and go anywhere.
    """
    samples, row = motion.samples, int(section_row[int(name.split("_")[1])])
    first = slice(row, row + _FIRST_ROWS)
    shown = np.abs(np.diff(samples.position_m[first])) / np.diff(samples.time_s[first])
    most = max(fastest, abs(speed_m_per_s), float(shown.max(initial=0.0)))
    return linear(name, fastest, centre=speed_m_per_s, sd=_SPEEDS * most)


def _stop_values(motion: RecordedMotion) -> dict[str, float]:
    if motion.stops is None:
        return {}
    both = {"low": motion.stops.low_m, "high": motion.stops.high_m}
    return {name: value for name, value in both.items() if math.isfinite(value)}
