"""What a fit works on: measured positions in short blocks with their weights, beside the force that acted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final

import numpy as np

from discrepancy.beginning import beginning, last_motion
from discrepancy.blocks import Blocks
from discrepancy.force_corners import Corners, corners_from, deviations_of, flat_where_held, unresolved_variance
from discrepancy.pace import timing_doubts
from discrepancy.pauses import pauses
from discrepancy.row_noise import repeated_errors, resting_noise, timing_errors
from estimators.base import Outcome
from estimators.likelihood.inputs.input_path import CommandedPath, InputPath, Nuisance, input_path
from estimators.likelihood.inputs.row_timing import position_doubts, still_rows
from estimators.likelihood.row_weights import repeated_share
from estimators.likelihood.search import measured_rests
from estimators.likelihood.staircase import read_staircase
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import FloatArray, IntArray
from valve.nameplate import Nameplate
from valve.recording import Recording

# Own choices, from valves without and with hidden effects (docs/diagnosis.md).
_STEPS_A_TURN: Final = 3.0  # rests for each turn of the force, from which on the motion is a stick-slip
_MAY_BE_A_STAIRCASE: Final = (Outcome.NEVER_MOVED, Outcome.NO_UNIFORM_MOTION)
_KNOWN_DELAY_PERIODS: Final = 0.01  # a delay between the channels that is known so well is not fitted: captured rows


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """An unbroken part of a recording: block means of time and position, shape (n,), and their weights, 1/m.

    ``rows``: how many samples each block is the mean of.

    ``corner_s`` and ``corner_n`` draw the force, straight between corners; with a command it is the force asked for.
    The rests are those of a stick-slip, at which a simulated stem begins anew; none elsewhere. ``rest_sense`` is the
    direction in which the stem came to each.

    ``start_velocity_error``, m/s, is 0 where the velocity at the start is known as well as matters. ``start_sense`` is
    the direction of the last motion up to the start, 0 where the stem has not moved; where it rests there, it rests
    since ``rest_since_s``, counted as ``elapsed_s`` is, from the start of the recording.
    """

    time_s: FloatArray
    position_m: FloatArray
    weight: FloatArray
    rows: FloatArray
    corner_s: FloatArray
    corner_n: FloatArray
    rest_time_s: FloatArray
    rest_m: FloatArray
    rest_sense: FloatArray
    start_m: float
    start_error_m: float
    start_velocity: float
    elapsed_s: float
    start_sense: float = 0.0
    rest_since_s: float = 0.0
    start_velocity_error: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Recordings of one valve made ready for fits; ``motion`` has what each recording holds, in the same order."""

    segments: tuple[Segment, ...]
    motions: tuple[RecordedMotion, ...]
    nameplate: Nameplate
    noise_m: float
    rows: int
    command_only: bool
    delay: Nuisance | None
    full_force_n: float
    # what the instants of polled writes and looks leave unknown of positions in motion, rms, over the noise
    doubt_in_noises: float = 0.0
    # corners of all segments, each changed by one sigma along a direction in which the measured force is uncertain
    deviations: tuple[tuple[Corners, ...], ...] = ()
    # of the residuals, shape (count, d), that the force's own errors spread over many blocks; none where it is exact
    spread: FloatArray | None = None
    # the force's errors that no deviation holds: their variance over that of all these, and what they move a row by
    unresolved: float = 0.0
    unresolved_rms: float = 0.0
    # the most that a converter's steps move rows by at one frequency while the stem goes evenly, rms, over the noise
    stepped_rms: float = 0.0
    # of a command alone: the valve behind an I/P as maximum likelihood has it (discrepancy.commanded)
    commanded: Mapping[str, float] = field(default_factory=dict)
    # of all blocks: times, positions and weights, 1/m, shape (count,)
    time_s: FloatArray = field(init=False)
    position_m: FloatArray = field(init=False)
    weight: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        for name in ("time_s", "position_m", "weight"):
            object.__setattr__(self, name, np.concatenate([getattr(one, name) for one in self.segments]))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.time_s.size)

    @property
    def has_exact_force(self) -> bool:
        """Whether the force was measured, and with errors that no residual shows."""
        return not (self.command_only or self.deviations)

    def of(self, segments: Sequence[Segment]) -> Observed:
        """Return the same valve's with other segments, whose force is taken as exact."""
        return replace(self, segments=tuple(segments), deviations=(), spread=None)

    def residuals(self, simulated_m: FloatArray) -> FloatArray:
        """Measured minus simulated positions, shape (count,), in standard deviations, each independent of the others.

        Errors of the force move many blocks together: with the covariance I + D D' and D = U S V' its inverse root is
        I - U (1 - 1/sqrt(1 + S^2)) U', and ``spread`` is the root of what is subtracted.
        """
        residual = (self.position_m - simulated_m) * self.weight
        return residual if self.spread is None else residual - self.spread @ (self.spread.T @ residual)


def observe(recordings: Sequence[Recording], nameplate: Nameplate, longest_s: float = math.inf) -> Observed | Outcome:
    """Return what these recordings hold for a fit in blocks of up to ``longest_s``, or the outcome why one does not."""
    segments: list[Segment] = []
    motions: list[RecordedMotion] = []
    deviations: list[tuple[Corners, ...]] = []
    noises, delay, rows, forces, doubted, stepped, missed = [], None, 0, [], 0.0, 0.0, np.zeros(2)
    for recording in recordings:
        motion = read_motion(recording, nameplate)
        if motion in _MAY_BE_A_STAIRCASE:
            motion = read_staircase(recording, nameplate, motion) or motion
        if isinstance(motion, Outcome):
            return motion
        path = input_path(recording, nameplate)
        if isinstance(path, Outcome):
            return path
        noise_m = resting_noise(motion)
        own_delay = None if motion.command_only else path.nuisances[0]
        period_s = motion.samples.period_s
        if own_delay is not None and own_delay.prior_sd > _KNOWN_DELAY_PERIODS * period_s:
            delay = own_delay
        doubts_m = timing_doubts(motion, recording.provenance.timing_uncertainty_s)
        own = _segments(motion, path, noise_m, doubts_m, longest_s)
        deviations = [(*one, *(_corners(segment) for segment in own)) for one in deviations]
        before = [_corners(segment) for segment in segments]
        deviations += [
            (*before, *changed) for changed in deviations_of(path, [float(segment.time_s[0]) for segment in own])
        ]
        segments += own
        missed += unresolved_variance(path)
        doubted = max(doubted, _doubt_in_noises(motion, path, noise_m))
        stepped = max(stepped, math.sqrt(repeated_share(motion.samples, noise_m)))
        motions.append(motion)
        noises.append(noise_m)
        rows += motion.samples.count
        forces.append(float(np.abs(motion.samples.force_n).max()))
    if not segments:
        return Outcome.TOO_FEW_SAMPLES
    command_only = any(motion.command_only for motion in motions)
    full_force_n = _full_force(nameplate) or max(forces)
    return Observed(
        tuple(segments),
        tuple(motions),
        nameplate,
        max(noises),
        rows,
        command_only,
        delay,
        full_force_n,
        doubted,
        tuple(deviations),
        unresolved=float(missed[0] / max(missed[1], 1.0e-300)),
        stepped_rms=stepped,
    )


def _corners(segment: Segment) -> Corners:
    return segment.corner_s, segment.corner_n


def _doubt_in_noises(motion: RecordedMotion, path: InputPath, noise_m: float) -> float:
    """How far the doubt in their instants moves positions in motion, in noises: its root mean square.

    Where the pressure answers the commands by a lag that outlasts a tread, no single write moves the stem, and a late
    look spoils its own row alone, which weighs by its doubt: what counts is how much the rows still tell, each
    1/(1 + doubt^2) of one without.
    """
    if motion.recording is None:
        return 0.0
    samples = motion.samples
    still = still_rows(samples.position_m, samples.position_noise_m)
    if still.all():
        return 0.0
    doubts = position_doubts(motion.recording, samples.time_s, samples.position_m, samples.position_noise_m)
    squares = (doubts.total_m[~still] / noise_m) ** 2
    if isinstance(path, CommandedPath) and path.fit.lag_s > float(np.median(np.diff(path.step_s))):
        return math.sqrt(1.0 / float(np.mean(1.0 / (1.0 + squares))) - 1.0)
    return math.sqrt(float(np.mean(squares)))


def _full_force(nameplate: Nameplate) -> float | None:
    area_m2, signal = nameplate.actuator.diaphragm_area_m2, nameplate.signal
    return None if area_m2 is None or signal is None else area_m2 * signal.range_pa[1]


def _segments(
    motion: RecordedMotion, path: InputPath, noise_m: float, timing_m: FloatArray, longest_s: float
) -> list[Segment]:
    samples, phases = motion.samples, motion.phases
    neutral = np.zeros(len(path.nuisances))
    corner_s, corner_n = path.corners(neutral)
    corner_n = flat_where_held(corner_n)
    starts = [0, *(int(row) for row in np.searchsorted(samples.time_s, path.breaks_s[:, 1])), samples.count]
    firsts = Blocks(samples, phases, noise_m, longest_s)
    rest_row, rest_m, rest_sense = _stick_slip_rests(motion)
    instants_m, repeated = timing_errors(motion, noise_m), repeated_errors(motion, noise_m)
    found = []
    for first, end in pairwise(starts):
        if end - first < 2:
            continue
        own = slice(first, end)
        edges = firsts.between(first, end)
        counts = np.diff(np.concatenate([edges, [end]]))
        time_s = np.add.reduceat(samples.time_s[own], edges - first) / counts
        position_m = np.add.reduceat(samples.position_m[own], edges - first) / counts
        doubt_m = np.add.reduceat(timing_m[own], edges - first) / counts
        variance = (noise_m**2 + doubt_m**2 + np.add.reduceat(repeated[own], edges - first) / counts) / counts
        # what writes leave unknown is the same for the rows of a block
        variance += np.add.reduceat(instants_m[own] ** 2, edges - first) / counts
        inside = (rest_row >= first) & (rest_row < end)
        begun = beginning(motion, first, math.sqrt(noise_m**2 + float(repeated[first])))
        begin_s = float(time_s[0])
        sense, since_s = last_motion(motion, first)
        # the stem begins where the first block lies
        own_s, own_n = corners_from(begin_s, corner_s, corner_n)
        found.append(
            Segment(
                time_s=time_s,
                position_m=position_m,
                weight=1.0 / np.sqrt(variance),
                rows=counts.astype(np.float64),
                corner_s=own_s,
                corner_n=own_n,
                rest_time_s=samples.time_s[rest_row[inside]],
                rest_m=rest_m[inside],
                rest_sense=rest_sense[inside],
                start_m=begun.position_m,
                start_error_m=begun.position_error_m,
                start_velocity=begun.velocity,
                start_velocity_error=begun.velocity_error,
                elapsed_s=begin_s - float(samples.time_s[0]),
                start_sense=sense,
                rest_since_s=since_s,
            )
        )
    return found


def _stick_slip_rests(motion: RecordedMotion) -> tuple[IntArray, FloatArray, FloatArray]:
    """Rows, positions and directions of arrival of the measured rests of a stick-slip; none where it slides."""
    fewest = _STEPS_A_TURN * max(1, len(motion.phases.corners))
    for posed in (all_rests(motion), pauses(motion)):
        if posed[0].size > fewest:
            return posed
    return np.empty(0, dtype=np.int64), np.empty(0), np.empty(0)


def all_rests(motion: RecordedMotion) -> tuple[IntArray, FloatArray, FloatArray]:
    """Middle rows, positions and directions of arrival of all measured rests."""
    rests = measured_rests(motion)
    lasts = np.array([stretch.last for stretch in motion.phases.stretches])
    senses = np.array([float(stretch.direction) for stretch in motion.phases.stretches])
    before = np.clip(np.searchsorted(lasts, rests.row) - 1, 0, None)
    return rests.row, rests.position_m, senses[before] if rests.row.size else np.empty(0)
