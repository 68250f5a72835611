"""Which rows of a recording a valve's motion is compared with: in sections without a break, each from a rest on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.likelihood.inputs.command_steps import written_steps
from estimators.likelihood.inputs.pressure_lines import MeasuredPath, measured_path
from estimators.likelihood.inputs.row_timing import position_doubts
from estimators.motion.phases import After
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.row_blocks import block_firsts, block_means
from estimators.proof.whole_motion import SOON_S, Corners, Section, WholeMotion
from estimators.samples import FloatArray, IntArray, Samples
from valve.nameplate import Nameplate
from valve.recording import Acquisition, Recording

_FEWEST_ROWS: Final = 20
_DOUBT: Final = 4.0  # times the uncertainty of a breakaway's instant
_ONE_INSTANT: Final = 0.005  # of a period: what is left to a converter where both channels are read at one instant
_KNOWN: Final = 0.1  # own choice, of the position's noise: what the force's noise may make in it


def whole_motion(motion: RecordedMotion, left_out_s: Sequence[float] = ()) -> WholeMotion | None:
    """Return what a valve's motion is compared with; None where no force was measured, or no noise limits the fit.

    From each of the breakaways at ``left_out_s`` on, s, the motion is left out until the next rest.
    """
    samples, recording, nameplate = motion.samples, motion.recording, motion.nameplate
    if recording is None or nameplate is None or motion.command_only or samples.position_noise_m <= 0.0:
        return None
    path = measured_path(recording, recording.actuator_force_n(nameplate))
    if not isinstance(path, MeasuredPath):
        return None
    corners, late = path.corners(np.zeros(1)), path.corners(np.full(1, SOON_S))
    edges = np.searchsorted(samples.time_s, path.breaks_s.mean(axis=1) if path.breaks_s.size else []).tolist()
    parts = [slice(first, stop) for first, stop in pairwise([0, *edges, samples.count])]
    for number, breakaway in enumerate(motion.phases.breakaways):
        if breakaway.time_s in left_out_s:
            parts = [part for whole in parts for part in _without(motion, whole, number, left_out_s)]
    firsts, sections = block_firsts(motion), []
    tread_s = _tread_s(recording, nameplate)
    sizes = np.hypot(1.0, _doubts_m(motion, recording, tread_s) / samples.position_noise_m)
    for rows in parts:
        section = _section(motion, rows, firsts, sizes, corners=corners, late=late)
        if section is not None:
            sections.append(section)
    if not sections:
        return None
    silent = recording.provenance.acquisition is Acquisition.FILE and path.delay.prior_sd > 0.9 * samples.period_s
    rates = np.abs(motion.phases.force_rate[[one.row for one in motion.phases.breakaways]])
    unsure_m = path.noise_n * float(np.ptp(samples.position_m) / np.ptp(samples.force_n))
    return WholeMotion(
        sections=tuple(sections),
        noise_m=samples.position_noise_m,
        delay_sd_s=_ONE_INSTANT * samples.period_s if silent else path.delay.prior_sd,
        delay_doubt_s=path.delay.prior_sd if silent else 0.0,
        stops=motion.stops,
        force_is_sure=unsure_m <= _KNOWN * samples.position_noise_m,
        breakaway_rate_n_per_s=float(np.median(rates)) if rates.size else 0.0,
        is_stepped=tread_s > 0.0,
    )


def _tread_s(recording: Recording, nameplate: Nameplate) -> float:
    """How long a polled command usually stayed on a step, s; 0 where it is not known to have gone in steps."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if recording.command_pa is None or area_m2 is None:
        return 0.0
    steps = written_steps(recording, area_m2 * recording.command_pa)
    return 0.0 if steps is None else float(np.median(np.diff(steps.step_s)))


def _doubts_m(motion: RecordedMotion, recording: Recording, tread_s: float) -> FloatArray:
    """One standard deviation of each position by what is not known of its instant, m, shape (n,).

    A polled command is a staircase, and the force that was read at each of its treads is drawn as a line: a stem that
    follows at once is anywhere within a tread of it.
    """
    samples = motion.samples
    doubts = position_doubts(recording, samples.time_s, samples.position_m, samples.position_noise_m)
    return np.hypot(doubts.total_m, np.abs(motion.phases.velocity) * tread_s / math.sqrt(12.0))


def _without(motion: RecordedMotion, part: slice, number: int, left_out_s: Sequence[float]) -> list[slice]:
    """The part without what follows this breakaway: up to it, and from before the next one that is driven and kept."""
    samples, breakaways = motion.samples, motion.phases.breakaways
    if not part.start <= breakaways[number].row < part.stop:
        return [part]
    driven = {stretch.first for stretch in motion.phases.stretches if stretch.driven}
    stop, again = part.stop, part.stop
    for breakaway in breakaways[number:]:
        sure_s = breakaway.time_s - _DOUBT * breakaway.within_s - 3.0 * samples.period_s
        row = int(np.searchsorted(samples.time_s, sure_s))
        if breakaway is breakaways[number]:
            stop = row
        elif breakaway.time_s not in left_out_s and breakaway.row + 1 in driven:
            again = row
            break
    return [slice(part.start, max(stop, part.start)), slice(min(again, part.stop), part.stop)]


def _section(
    motion: RecordedMotion, rows: slice, firsts: IntArray, sizes: FloatArray, *, corners: Corners, late: Corners
) -> Section | None:
    """The rows from their first rest on, in blocks; None where there is none, or hardly a row after it.

    ``sizes`` (n,) are the errors of all rows, that of a polled row's instant included, in the noise's deviations.
    """
    samples = motion.samples
    if rows.stop - rows.start < _FEWEST_ROWS:
        return None
    begin, start_m = _beginning(motion, rows)
    if rows.stop - begin < _FEWEST_ROWS:
        return None
    own = np.concatenate([[begin], firsts[(firsts > begin) & (firsts < rows.stop)]]) - begin
    time_s, position_m = samples.time_s[begin : rows.stop], samples.position_m[begin : rows.stop]
    middle_s = block_means(time_s - time_s[0], own)
    square_s2 = block_means((time_s - time_s[0]) ** 2, own)
    half_s = np.sqrt(np.clip(square_s2 - middle_s**2, 0.0, None))
    lengths = np.diff(np.append(own, time_s.size)).astype(np.float64)
    half_s[lengths == 1.0] = 0.0
    followed_s = time_s[0] + np.stack([middle_s - half_s, middle_s + half_s], axis=1).ravel()
    return Section(
        corners=_cut(corners, float(time_s[0])),
        late=_cut(late, float(time_s[0])),
        time_s=followed_s,
        position_m=block_means(position_m, own),
        rows=lengths,
        # neighbours' instants may be wrong together: their mean is no surer than one of them
        weight=np.sqrt(lengths / (1.0 + lengths * (block_means(sizes[begin : rows.stop] ** 2, own) - 1.0))),
        start_m=start_m,
    )


def _beginning(motion: RecordedMotion, rows: slice) -> tuple[int, float]:
    """First row to compare, and the position there, m: at rest; what moves before the first rest is left out."""
    samples, phases = motion.samples, motion.phases
    own = [stretch for stretch in phases.stretches if rows.start <= stretch.first < rows.stop]
    moving = any(stretch.first <= rows.start <= stretch.last for stretch in phases.stretches)
    if not moving and (not own or (own[0].after is not After.UNKNOWN and own[0].first > rows.start + 2)):
        last = own[0].first if own else rows.stop
        # its end may be in motion already
        return rows.start, _mean(samples, rows.start, last - max(3, (last - rows.start) // 10))
    for breakaway in phases.breakaways:
        if rows.start < breakaway.row < rows.stop:
            sure_s = breakaway.time_s - 4.0 * breakaway.within_s - 3.0 * samples.period_s
            begin = min(breakaway.row, max(rows.start + 1, int(np.searchsorted(samples.time_s, sure_s))))
            return begin, breakaway.rest_m
    return rows.start, float(samples.position_m[rows.start])


def _mean(samples: Samples, first: int, stop: int) -> float:
    return float(samples.position_m[first : max(stop, first + 1)].mean())


def _cut(corners: Corners, first_s: float) -> Corners:
    """The corners from this time on."""
    time_s, force_n = corners
    later = time_s > first_s
    begin_n = float(np.interp(first_s, time_s, force_n))
    return np.concatenate([[first_s], time_s[later]]), np.concatenate([[begin_n], force_n[later]])
