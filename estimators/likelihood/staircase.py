"""A stem that sticks and slips: its rests and jumps, whose steps are too short to be motions for the usual phases."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.likelihood.level_kernel import level_runs
from estimators.likelihood.start import breakaway_balance
from estimators.motion.phases import After, Phases, Stretch
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.rests import Breakaway
from estimators.motion.static_friction import breakaway_forces
from estimators.motion.stops import stops_beyond
from estimators.motion.windowed_slope import windowed_slope
from estimators.samples import BoolArray, FloatArray, IntArray, Samples, prepare
from valve.nameplate import Nameplate
from valve.recording import Recording

# Own choices, tried on random valves that stick and slip at 1 to 20 ms.
_LEVEL_SIGMAS: Final = 4.5
_FEWEST_ROWS: Final = 3
_FEWEST_STEPS: Final = 6  # where the usual phases hold some; 2 where they hold none
_FEWEST_AT_ALL: Final = 2
_MIDST: Final = 0.2  # of a jump
_BEGUN: Final = 0.1  # of what is left of a jump, in its first rows
_FEWEST_BEGUN: Final = 4  # rows of a jump in whose midst the recording begins, or goes on after a gap
_MORE_STEPS: Final = 2  # times the breakaways that the usual phases have
_AS_MANY: Final = 0.7  # of them are enough where the jumps are brief
_BRIEF: Final = 0.3  # of the rests
_DRIVEN: Final = 0.25  # of a jump: what the force changed by in that time moved the stem, so that it slid
_ON_STOP: Final = 1.02  # times the largest force at a breakaway, of which a jumping stem shows many
_CREEPS: Final = 0.3  # of the mean speed about it: a run with so much slope is no rest
_CLEAR: Final = 25.0
_PIECE: Final = 0.2  # of a usual rest: a shorter run is a piece of a jump
_FAR_LONGER: Final = 10.0  # times a jump
_OF_A_RAMP: Final = 0.5
_NEIGHBOURS: Final = 15  # on each side of a run, that tell whether the stem creeps there
_MORE_NOISE: Final = 1.3
_GRID_STEPS: Final = 3.0
_APART_SIGMAS: Final = 5.0
_QUANTILE: Final = 0.1
_QUANTILE_SIGMAS: Final = 0.1257  # of the absolute value of a normal number
_MAD_TO_SIGMA: Final = 1.4826  # of the normal distribution
_LEAST: Final = 1.0e-9  # of the range


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """Runs of rows at rest: ``rows`` (k, 2), first and last; their ``level_m`` (k,); the noise about them, m."""

    rows: IntArray
    level_m: FloatArray
    noise_m: float


def read_staircase(
    recording: Recording, nameplate: Nameplate, motion: RecordedMotion | Outcome
) -> RecordedMotion | None:
    """Return the motion as rests and jumps; None where it has few of them, or the usual phases hold as many."""
    samples = prepare(recording, nameplate) if isinstance(motion, Outcome) else motion.samples
    if isinstance(samples, Outcome):
        return None
    # pieces of the jumps may outnumber the rests, whether or not the stem also slides on other ramps
    rests = find_rests(samples) or find_rests(samples, among_pieces=True)
    if rests is None:
        return None
    stretches, breakaways = _steps(samples, rests)
    fewest = float(_FEWEST_AT_ALL)
    if not isinstance(motion, Outcome):
        moving = np.median([stretch.last - stretch.first + 1 for stretch in stretches]) if stretches else np.inf
        is_brief = moving < _BRIEF * float(np.median(np.diff(rests.rows, axis=1)))
        is_brief = is_brief and not _slides(motion, stretches, breakaways)
        fewest = max(_FEWEST_STEPS, (_AS_MANY if is_brief else _MORE_STEPS) * len(motion.phases.breakaways))
    if len(breakaways) < fewest or not _jumps_beyond_grid(samples, breakaways):
        return None
    half_window = _half_window(samples, breakaways)
    velocity = windowed_slope(samples, samples.position_m, half_window)
    moving = np.abs(velocity[[breakaway.row for breakaway in breakaways]])
    phases = Phases(
        velocity=velocity,
        half_window=half_window,
        moving_speed=float(np.median(moving)),
        stretches=tuple(stretches),
        breakaways=tuple(breakaways),
        corners=np.empty(0, dtype=np.int64),
        force_rate=windowed_slope(samples, samples.force_n, half_window),
    )
    if samples.position_noise_m > 0.0:
        samples = replace(samples, position_noise_m=rests.noise_m)
    if isinstance(motion, RecordedMotion):
        return replace(motion, samples=samples, phases=phases, uniform=None, shared={})
    return RecordedMotion(
        samples=samples,
        phases=phases,
        uniform=None,
        uniform_outcome=Outcome.NO_UNIFORM_MOTION,
        stops=None,
        action=nameplate.actuator.action,
        moving_mass_kg=nameplate.actuator.moving_mass_kg,
        command_only=recording.force_n is None and recording.pressure_pa is None,
    )


def tells_spring(motion: RecordedMotion) -> bool:
    """Whether the stem slid evenly, or broke away in one sense from places apart, so that a balance tells k.

    Of jumps to and fro between two places, whose F_s is not known, a spring of any rate has the balance.
    """
    levels = [[one.rest_m for one in motion.phases.breakaways if one.direction == sense] for sense in (-1, 1)]
    apart_m = max((float(np.ptp(own)) for own in levels if own), default=0.0)
    return motion.uniform is not None or apart_m > _APART_SIGMAS * motion.samples.position_noise_m


def _half_window(samples: Samples, breakaways: list[Breakaway]) -> int:
    """Rows on each side of one in which its speed is seen: about two jumps, and no more than a part of a ramp.

    Over a ramp and back the mean speed is none, however fast the stem is driven.
    """
    rows = np.array([breakaway.row for breakaway in breakaways])
    sense = np.array([breakaway.direction for breakaway in breakaways])
    turned = np.flatnonzero(np.diff(sense, prepend=-sense[0]))
    ramp = float(np.median(np.diff(rows[turned]))) if turned.size > 1 else math.inf
    widest = min(_OF_A_RAMP * ramp, samples.count / 10.0)
    return int(np.clip(2.0 * float(np.median(np.diff(rows))), 2.0, max(widest, 2.0)))


def with_stops(motion: RecordedMotion) -> RecordedMotion:
    """Return the motion with the stops that a stem without uniform motion rested on, by the balance of its breakaways.

    Between two breakaways the force on it goes from one F_s to the other; on a stop it goes on.
    """
    samples, phases = motion.samples, motion.phases
    balance = breakaway_balance(samples, phases.breakaways)
    if motion.uniform is not None or motion.stops is not None or balance is None:
        return motion
    spring, static_n, preload_n = (float(value) for value in balance)
    forces = breakaway_forces(samples, phases, spring, preload_n)
    most_n = static_n if forces is None else max(float(forces.friction_n.max()), static_n)
    return replace(motion, stops=stops_beyond(samples, phases, (spring, preload_n), most_n, excess=_ON_STOP), shared={})


def _slides(motion: RecordedMotion, stretches: list[Stretch], breakaways: list[Breakaway]) -> bool:
    """Whether a good part of each motion between two rests is that of the ramp, by the balance of its breakaways.

    A uniform motion may be none but the ends of jumps, and its spring is anything then.
    """
    if motion.uniform is None or not stretches:
        return False
    first = np.array([stretch.first - 1 for stretch in stretches])
    last = np.array([stretch.last for stretch in stretches])
    moved_m = np.abs(motion.samples.position_m[last] - motion.samples.position_m[first])
    driven_n = np.abs(motion.samples.force_n[last] - motion.samples.force_n[first])
    balance = breakaway_balance(motion.samples, breakaways)
    spring = motion.uniform.spring_n_per_m if balance is None else float(balance[0])
    return float(np.median(driven_n / moved_m)) > _DRIVEN * spring


def _jumps_beyond_grid(samples: Samples, breakaways: list[Breakaway]) -> bool:
    """Whether the jumps are longer than steps of the sensor's grid, which look like rests and jumps too."""
    jumps_m = np.abs(np.diff([breakaway.rest_m for breakaway in breakaways]))
    return float(np.median(jumps_m)) > _GRID_STEPS * samples.position_step_m


def find_rests(samples: Samples, *, among_pieces: bool = False) -> Rests | None:
    """Return the runs of rows at one level, where the stem rests between jumps and does not creep.

    ``among_pieces``: of jumps that are slow enough for runs of their own, each far shorter than the rests.
    """
    position_m = samples.position_m
    range_m = float(np.ptp(position_m))
    least_m = max(_least_noise(position_m), samples.position_step_m, _LEAST * range_m)
    noise_m = max(min(samples.position_noise_m, least_m), _LEAST * range_m)
    rows = level_runs(position_m, samples.run_last, _LEVEL_SIGMAS * noise_m, _FEWEST_ROWS)
    if rows.shape[0] <= _FEWEST_AT_ALL:
        return None
    level_m = np.array([float(position_m[first : last + 1].mean()) for first, last in rows])
    slope, squares_s2 = _slopes(samples, rows)
    speed = np.gradient(level_m, 0.5 * (samples.time_s[rows[:, 0]] + samples.time_s[rows[:, 1]]))
    surely = np.abs(slope) * np.sqrt(squares_s2) > _LEVEL_SIGMAS * noise_m
    kept = ~(surely & (np.abs(slope) > _CREEPS * np.abs(speed)))
    # what each run tells of its slope, none more than a clear one; together they show what creeps in short pieces
    weight = np.minimum(squares_s2 * speed * speed / noise_m**2, _CLEAR)
    drift = np.divide(slope, speed, out=np.zeros_like(slope), where=speed != 0.0)
    if _creep_together(kept, weight, drift):
        # a stem may rest on slow ramps and slide on fast ones
        kept &= _long(rows) if among_pieces else _still_together(np.where(kept, weight, 0.0), drift)
        if among_pieces and _creep_together(kept, weight, drift):
            return None
    # a few rows of a long jump lie within the noise as well
    kept[kept] = _long(rows[kept]) | _apart(rows)[kept]
    if np.count_nonzero(kept) <= _FEWEST_AT_ALL:
        return None
    rows, level_m = rows[kept], level_m[kept]
    off_m = [position_m[first : last + 1] - mean_m for (first, last), mean_m in zip(rows, level_m, strict=True)]
    lost = math.sqrt(1.0 + rows.shape[0] / float(np.diff(rows, axis=1).sum()))
    # the median, for a run may begin with the end of a jump
    scatter_m = _MAD_TO_SIGMA * lost * float(np.median(np.abs(np.concatenate(off_m))))
    if scatter_m > _MORE_NOISE * max(samples.position_noise_m, noise_m):
        return None  # what creeps or rings is no rest
    return Rests(rows, level_m, max(scatter_m, samples.position_step_m / math.sqrt(12.0), _LEAST * range_m))


def _creep_together(kept: BoolArray, weight: FloatArray, drift: FloatArray) -> bool:
    """Whether the kept runs creep, all of them together, shapes (k,)."""
    return float((weight * drift)[kept].sum()) > _CREEPS * float(weight[kept].sum())


def _long(rows: IntArray) -> BoolArray:
    """Which runs, shape (k,), are not far shorter than the one in which the middle one of the rows about it lies.

    The two longest about it, where the force itself may have rested, do not count.
    """
    counts = rows[:, 1] - rows[:, 0] + 1
    usual = np.empty(counts.size)
    for number in range(counts.size):
        about = np.sort(counts[max(number - 2 * _NEIGHBOURS, 0) : number + 2 * _NEIGHBOURS + 1])
        about = about[:-2] if about.size > _NEIGHBOURS else about
        usual[number] = about[np.searchsorted(np.cumsum(about), 0.5 * float(about.sum()))]
    return np.asarray(counts > _PIECE * usual)


def _apart(rows: IntArray) -> BoolArray:
    """Which runs, shape (k,), are far longer than the jumps on both sides of them: pieces of a jump are not.

    Beside the rests after a reversal, which are the longest, a ramp's own may be short.
    """
    between = np.concatenate([[1], rows[1:, 0] - rows[:-1, 1] - 1, [1]])
    longer = np.maximum(between[:-1], between[1:])
    is_between = np.minimum(between[:-1], between[1:]) > 0
    return np.asarray(is_between & (rows[:, 1] - rows[:, 0] + 1 > _FAR_LONGER * longer))


def _still_together(weight: FloatArray, drift: FloatArray) -> BoolArray:
    """Which runs, shape (k,), are among neighbours that together do not creep: as many before as after."""
    width = min(2 * _NEIGHBOURS + 1, weight.size)
    about = np.ones(width)
    together = np.convolve(weight * drift, about, mode="same"), np.convolve(weight, about, mode="same")
    return np.asarray(together[0] <= _CREEPS * together[1])


def _least_noise(position_m: FloatArray) -> float:
    """Noise of the stillest rows, m, by the least second differences; about all rows' where none is stiller."""
    second_m = np.abs(np.diff(position_m, 2))
    return float(np.quantile(second_m, _QUANTILE)) / (_QUANTILE_SIGMAS * math.sqrt(6.0))


def _slopes(samples: Samples, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Slope of the position over each run, m/s, and the sum of its squared times about their mean, s^2; (k,)."""
    slope, squares = np.zeros(rows.shape[0]), np.zeros(rows.shape[0])
    for number, (first, last) in enumerate(rows):
        time_s = samples.time_s[first : last + 1]
        time_s = time_s - time_s.mean()
        squares[number] = float(time_s @ time_s)
        slope[number] = float(time_s @ samples.position_m[first : last + 1]) / squares[number]
    return slope, squares


def _in_motion(samples: Samples, first: int, rest: int, level_m: float, least_m: float) -> Stretch | None:
    """Return the end of the jump in which the rows from ``first`` on begin, before the ``rest`` at this level.

    None where no more than ``least_m`` of it is left.
    """
    way_m = level_m - float(samples.position_m[first])
    if rest < first + _FEWEST_BEGUN or abs(way_m) < least_m:
        return None
    begun_m = abs(float(samples.position_m[first + _FEWEST_BEGUN - 1] - samples.position_m[first]))
    if begun_m < _BEGUN * least_m:
        return None  # it rests there, for fewer rows than count as a rest
    direction = 1 if way_m > 0.0 else -1
    return Stretch(first, rest - 1, direction, After.UNKNOWN, driven=True)


def _steps(samples: Samples, rests: Rests) -> tuple[list[Stretch], list[Breakaway]]:
    """Jumps from one level to the next; a rest that goes on at the same level is one rest."""
    stretches: list[Stretch] = []
    breakaways: list[Breakaway] = []
    rows, level_m = rests.rows, rests.level_m
    least_m = max(_APART_SIGMAS * rests.noise_m, _MIDST * float(np.median(np.abs(np.diff(level_m)))))
    begun = _in_motion(samples, 0, int(rows[0, 0]), float(level_m[0]), least_m)
    stretches += [] if begun is None else [begun]
    for number, other in pairwise(range(level_m.size)):
        rise_m = float(level_m[other] - level_m[number])
        counts = rows[[number, other], 1] - rows[[number, other], 0] + 1
        if abs(rise_m) <= _APART_SIGMAS * rests.noise_m * float(np.sqrt((1.0 / counts).sum())):
            continue
        before, after = int(rows[number, 1]), int(rows[other, 0])
        if samples.run_first[after] > before:
            first = int(samples.run_first[after])
            begun = _in_motion(samples, first, after, float(level_m[other]), least_m)
            stretches += [] if begun is None else [begun]
            continue
        direction = 1 if rise_m > 0.0 else -1
        stretches.append(Stretch(before + 1, max(before + 1, after - 1), direction, After.BREAKAWAY, driven=True))
        half_step_s = 0.5 * float(samples.time_s[before + 1] - samples.time_s[before])
        at_s = float(samples.time_s[before]) + half_step_s
        breakaways.append(Breakaway(before, direction, at_s, half_step_s, float(level_m[number])))
    return stretches, breakaways
