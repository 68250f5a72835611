"""Where a simulation is wrong: its misfit of position and of force along time, travel, speed, rest and pressure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from discrepancy.least_squares import Fit
from discrepancy.model import simulated
from discrepancy.observed import Observed, Segment
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray

_BINS: Final = 40
_LEAST_IN_BIN: Final = 3
_MOST_POINTS: Final = 200
COORDINATE_UNITS: Final = {"time": "s", "travel": "m", "speed": "m/s", "time at rest": "s", "force": "N"}


@dataclass(frozen=True, slots=True, eq=False)
class Along:
    """A misfit along one coordinate: means in bins, shape (b,), with their standard errors.

    ``direction`` is 1 opening, -1 closing, 0 both. ``share`` is how much of the misfit's variance the coordinate
    explains beyond what as many bins explain of residuals that hang together as these do.
    """

    coordinate: str
    direction: int
    at: FloatArray
    mean: FloatArray
    std_error: FloatArray
    share: float

    @property
    def unit(self) -> str:
        """Unit of the coordinate."""
        return COORDINATE_UNITS[self.coordinate]

    def to_json(self) -> dict[str, Any]:
        """Return the curve for a picture."""
        return {
            "coordinate": self.coordinate,
            "unit": self.unit,
            "direction": self.direction,
            "at": self.at.tolist(),
            "mean": self.mean.tolist(),
            "std_error": self.std_error.tolist(),
            "share": self.share,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """What a fit leaves: curves of at most 200 points over time, and what each coordinate explains of it."""

    time_s: FloatArray
    measured_m: FloatArray
    simulated_m: FloatArray
    rms_m: float
    noise_m: float
    position: tuple[Along, ...]
    force: tuple[Along, ...]
    where: str

    def to_json(self) -> dict[str, Any]:
        """Return the data of the pictures and the words."""
        return {
            "time_s": self.time_s.tolist(),
            "measured_m": self.measured_m.tolist(),
            "simulated_m": self.simulated_m.tolist(),
            "rms_m": self.rms_m,
            "noise_m": self.noise_m,
            "position": [entry.to_json() for entry in self.position],
            "force": [entry.to_json() for entry in self.force],
            "where": self.where,
        }


def show(fit: Fit) -> Misfit:
    """Return where and by how much the fit misses the measured positions and forces."""
    observed = fit.model.observed
    measured_m = observed.position_m
    simulated_m = simulated(observed, fit.model.valve(fit.point), fit.values)
    residual_m = measured_m - simulated_m
    coordinates = coordinates_of(fit)
    position = _along_all(coordinates, residual_m)
    force_n, known = force_residual(fit, coordinates)
    force = _along_all({name: values[known] for name, values in coordinates.items()}, force_n[known])
    kept = np.unique(np.linspace(0, measured_m.size - 1, _MOST_POINTS).astype(np.int64))
    rms_m = float(np.sqrt(np.average(residual_m**2, weights=observed.weight**2)))
    return Misfit(
        observed.time_s[kept],
        measured_m[kept],
        simulated_m[kept],
        rms_m,
        observed.noise_m,
        position,
        force,
        _in_words(position, residual_m, observed.nameplate.actuator.travel_m),
    )


def force_residual(fit: Fit, coordinates: dict[str, FloatArray]) -> tuple[FloatArray, BoolArray]:
    """Force that the baseline's balance leaves, S_a P - k x - F_0 - F_f(v) - m a, N, and where it is known, (n,).

    In motion only: at rest friction is whatever it must be.
    """
    values, speed = fit.values, coordinates["speed"]
    sense = np.sign(coordinates["velocity"])
    friction_n = sense * values["F_c"] + values["F_v"] * coordinates["velocity"]
    inertia_n = values["m"] * coordinates["acceleration"]
    position_m = fit.model.observed.position_m
    left_n = coordinates["force"] - values["k"] * position_m - values["F_0"] - friction_n - inertia_n
    return left_n, speed > 0.3 * usual_speed(coordinates)


def usual_speed(coordinates: dict[str, FloatArray]) -> float:
    """Return the speed that a quarter of the blocks in motion exceed, m/s: rests, however long, do not count."""
    speed = coordinates["speed"]
    moving = coordinates["moving"] > 0.0
    return float(np.quantile(speed[moving] if moving.any() else speed, 0.75)) if speed.size else 0.0


def coordinates_of(fit: Fit) -> dict[str, FloatArray]:
    """Return what a misfit may depend on, each in all blocks, shape (count,), with what goes with it."""
    observed = fit.model.observed
    parts = [_of_segment(segment, motion) for segment, motion in paired(observed)]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    joined["travel"], joined["time"] = observed.position_m, observed.time_s
    return joined


def paired(observed: Observed) -> list[tuple[Segment, RecordedMotion]]:
    """Each segment with the recording that it is of: in time order, those of one recording begin after another."""
    found: list[tuple[Segment, RecordedMotion]] = []
    number = 0
    motions = observed.motions
    for segment in observed.segments:
        if segment.elapsed_s == 0.0 and found:
            number = min(number + 1, len(motions) - 1)
        found.append((segment, motions[number]))
    return found


def _of_segment(segment: Segment, motion: RecordedMotion) -> dict[str, FloatArray]:
    samples, phases, time_s = motion.samples, motion.phases, segment.time_s
    velocity = np.interp(time_s, samples.time_s, phases.velocity)
    span_s = max(2 * phases.half_window * samples.period_s, 1.0e-6)
    later = np.interp(time_s + 0.5 * span_s, samples.time_s, phases.velocity)
    earlier = np.interp(time_s - 0.5 * span_s, samples.time_s, phases.velocity)
    rest_s = np.full(time_s.size, math.nan)
    moving = np.zeros(time_s.size)
    for stretch in phases.stretches:
        moving[slice(*np.searchsorted(time_s, samples.time_s[[stretch.first, stretch.last]]))] = 1.0
    ends = np.array([stretch.last for stretch in phases.stretches])
    for breakaway in phases.breakaways:
        before = ends[ends < breakaway.row]
        since = samples.time_s[before[-1]] if before.size else samples.time_s[0]
        row = int(np.searchsorted(time_s, samples.time_s[breakaway.row]))
        rest_s[row : row + 20] = samples.time_s[breakaway.row] - since
    return {
        "force": np.interp(time_s, samples.time_s, samples.force_n),
        "velocity": velocity,
        "acceleration": (later - earlier) / span_s,
        "speed": np.abs(velocity),
        "moving": moving,  # 1 in a stretch of motion, 0 at rest
        "force rate": np.interp(time_s, samples.time_s, phases.force_rate),
        "time at rest": rest_s,
    }


def _along_all(coordinates: dict[str, FloatArray], residual: FloatArray) -> tuple[Along, ...]:
    if residual.size < 2 * _BINS:
        return ()
    sense = np.sign(coordinates["velocity"])
    found = []
    for name in COORDINATE_UNITS:
        directions = (1, -1) if name == "travel" else (0,)
        for direction in directions:
            chosen = np.isfinite(coordinates[name])
            if direction:
                chosen &= sense == direction
            if np.count_nonzero(chosen) >= 2 * _LEAST_IN_BIN:
                found.append(along(name, direction, coordinates[name][chosen], residual[chosen]))
    return tuple(found)


def along(name: str, direction: int, at: FloatArray, residual: FloatArray) -> Along:
    """Return the means of residuals, shape (n,), in bins of a coordinate ``at``, (n,), and what it explains."""
    length = correlation_length(residual)
    independent = residual.size / length
    bins = int(np.clip(independent / 3.0, 2, _BINS))
    edges = np.linspace(float(at.min()), float(at.max()) + 1.0e-12, bins + 1)
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    used = count >= _LEAST_IN_BIN
    mean = np.bincount(place, residual, minlength=bins) / np.maximum(count, 1)
    square = np.bincount(place, residual**2, minlength=bins) / np.maximum(count, 1)
    error = np.sqrt(np.maximum(square - mean**2, 0.0) * length / np.maximum(count, 1))
    left = float(np.sum((residual - mean[place]) ** 2))
    total = float(np.sum((residual - residual.mean()) ** 2))
    freedom = max(independent - int(used.sum()), 1.0)
    share = 1.0 - (left / max(total, 1.0e-300)) * max(independent - 1.0, 1.0) / freedom
    middle = 0.5 * (edges[1:] + edges[:-1])
    return Along(name, direction, middle[used], mean[used], error[used], min(max(share, 0.0), 1.0))


def correlation_length(residual: FloatArray) -> float:
    """Number of rows that count as one: 1 + 2 times the sum of autocorrelations up to their first zero."""
    centred = residual - residual.mean()
    size = 1 << (2 * residual.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: residual.size]
    if correlation[0] <= 0.0:
        return 1.0
    ratio = correlation / correlation[0]
    negative = np.flatnonzero(ratio < 0.0)
    end = int(negative[0]) if negative.size else residual.size
    return float(min(max(1.0 + 2.0 * float(ratio[1:end].sum()), 1.0), 0.25 * residual.size))


def _in_words(position: tuple[Along, ...], residual_m: FloatArray, travel_m: float) -> str:
    known = [entry for entry in position if entry.at.size]
    if not known:
        return ""
    most = max(known, key=lambda entry: entry.share)
    place = int(np.argmax(np.abs(most.mean)))
    at = most.at[place]
    where = f"{100.0 * at / travel_m:.0f} % travel" if most.coordinate == "travel" else f"{at:.3g} {most.unit}"
    way = {1: " opening", -1: " closing", 0: ""}[most.direction]
    return (
        f"The simulation misses by {1.0e6 * float(np.sqrt(np.mean(residual_m**2))):.0f} um rms; "
        f"{most.coordinate}{way} explains {100.0 * most.share:.0f} % of it, most at {where}, "
        f"where it is {1.0e6 * most.mean[place]:+.0f} um."
    )
