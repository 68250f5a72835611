"""Valves that stick and slip in a given cycle: of one mass and damping, the F_s - F_c with which the stem has it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Final

import numpy as np

from estimators.likelihood.jump_cycle import JumpCycle
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from valve.errors import MotionError
from valve.motion import simulate_motion
from valve.parameters import ValveParameters
from valve.stem import Mode, StemState

# Own choices, from random valves that stick and slip between the rows.
_PERIODS: Final = (  # of the stem's swing, in cycles
    *(0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9),
    *(0.94, 0.97, 0.985, 0.993),
)
_DAMPINGS: Final = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
_FINE_DAMPINGS: Final = (  # where two cycles tell the mass
    *(0.01, 0.02, 0.03, 0.045, 0.06, 0.075, 0.09, 0.12, 0.15, 0.18, 0.21, 0.25, 0.3, 0.35, 0.42, 0.5),
)
_LIMITS: Final = (0.003, 0.02)  # DV, of the ramp's speed: when the first jump of a ramp comes hangs on it
_MASSES_KG: Final = (0.01, 200.0)
_FORCES: Final = (0.01, 0.55)  # of what the ramp adds in a cycle: F_s - F_c
_HALVINGS: Final = 24
_NEAR: Final = 1.0e-5  # of F_s - F_c
_SAME: Final = 1.0e-3  # of the cycle
_RUN: Final = 7  # cycles, of which the first two come to be like the others
_PLACES: Final = 64  # of a cycle
_EVENTS: Final = 200
_SHARES_BESIDE: Final = (0.99, 1.0, 1.01)
_DAMPINGS_BESIDE: Final = (0.2, 0.4, 0.55, 0.7, 0.85, 1.2, 1.5)
_NEAR_BOTH: Final = 0.3  # of the other cycle
_BOTH_STEPS: Final = 8
_UNLIKE: Final = 0.05  # of the wave's square: more is no wave of jumps


@dataclass(frozen=True, slots=True)
class _Stem:
    """A stem that jumps in the cycle: its swing as a share of the cycle, its damping, DV as one of the ramp's speed.

    ``more_n`` is F_s - F_c, ``below_n`` how far the mean friction is below F_s, N, and ``waves_m`` the amplitude of the
    wave and those of its overtones, m.
    """

    share: float
    damping: float
    limit: float
    mass_kg: float
    viscous: float
    more_n: float
    below_n: float
    waves_m: FloatArray


def valves_like(
    here: dict[str, float], motion: RecordedMotion, cycle: JumpCycle, others: Sequence[JumpCycle] = ()
) -> list[dict[str, float]]:
    """Return the values by name of the valves whose jumps are like the measured wave, the likest first.

    ``here`` are the values of all unknowns at a fit, of which those that a cycle tells nothing of are kept. The
    ``others`` are cycles that ramps of other rates may have: of each damping the masses with which a stem has one of
    these too come first.
    """
    k, moving_n, preload_n = _balance(here, motion, cycle)
    found: list[tuple[bool, float, dict[str, float]]] = []
    for damping, limit in product(_FINE_DAMPINGS if others else _DAMPINGS, _LIMITS):
        stems = [_stem(cycle, k, share, damping, limit) for share in _PERIODS]
        both = [stem for other in others for stem in _of_both(cycle, k, stems, other)]
        alone = [stem for stem in stems if stem is not None and damping in _DAMPINGS]
        for stem in (*both, *alone):
            unlike, coulomb_n = _unlike(stem, cycle), moving_n + stem.below_n - stem.more_n
            if coulomb_n > 0.0 and unlike < _UNLIKE:
                own = {"m": stem.mass_kg, "k": k, "F_v": stem.viscous, "F_c": coulomb_n, "d": stem.more_n / coulomb_n}
                own |= {"DV": limit * cycle.rate_n_per_s / k, "F_0": preload_n}
                found.append((stem not in both, unlike, here | own))
    return [values for _, _, values in sorted(found, key=lambda one: one[:2])]


def valves_beside(here: dict[str, float], cycle: JumpCycle) -> list[dict[str, float]]:
    """Return the values by name of valves that jump in this cycle with other masses and dampings than ``here``."""
    k, speed = here["k"], cycle.rate_n_per_s / here["k"]
    own_share = 2.0 * math.pi * math.sqrt(here["m"] / k) / cycle.period_s
    own_damping = 0.5 * here["F_v"] / math.sqrt(k * here["m"])
    static_n, limit = here["F_c"] * (1.0 + here["d"]), here["DV"] / speed
    found = []
    for share, damping in product(_SHARES_BESIDE, _DAMPINGS_BESIDE):
        stem = _stem(cycle, k, share * own_share, damping * own_damping, limit)
        if stem is not None and static_n > stem.more_n:
            coulomb_n = static_n - stem.more_n
            own = {"m": stem.mass_kg, "F_v": stem.viscous, "F_c": coulomb_n, "d": stem.more_n / coulomb_n}
            found.append(here | own)
    return found


def _balance(here: dict[str, float], motion: RecordedMotion, cycle: JumpCycle) -> tuple[float, float, float]:
    """Spring rate, N/m, the mean friction that the ramps show, and the preload, N."""
    uniform, k = motion.uniform, here["k"]
    # behind a lag that is not known the force is late, which looks like friction
    if uniform is not None and uniform.preload_n is not None and not motion.command_only:
        return uniform.spring_n_per_m, uniform.friction_n, uniform.preload_n
    return k, here["F_c"] + here["F_v"] * cycle.rate_n_per_s / k, here["F_0"]


def _stem(cycle: JumpCycle, k: float, share: float, damping: float, limit: float) -> _Stem | None:
    """Return the stem of this mass, damping and DV that jumps in the cycle; None where there is none."""
    mass_kg = k * (share * cycle.period_s / (2.0 * math.pi)) ** 2
    if not _MASSES_KG[0] < mass_kg < _MASSES_KG[1]:
        return None
    viscous = 2.0 * damping * math.sqrt(k * mass_kg)
    solved = _stiction(cycle, mass_kg, k, viscous, limit * cycle.rate_n_per_s / k)
    return None if solved is None else _Stem(share, damping, limit, mass_kg, viscous, *solved)


def _of_both(cycle: JumpCycle, k: float, stems: list[_Stem | None], other: JumpCycle) -> Iterator[_Stem]:
    """Yield the stems, between two of these masses, that have the ``other`` cycle on the ramps of its rate too."""

    def too_long(stem: _Stem) -> float:
        limit = stem.limit * cycle.rate_n_per_s / k
        gained_n = other.period_s * other.rate_n_per_s
        valve = ValveParameters(stem.mass_kg, k, stem.viscous, gained_n, gained_n + stem.more_n, limit, 0.0)
        rests_s = _rests_s(valve, other)
        return math.nan if rests_s is None else _period(rests_s) / other.period_s - 1.0

    for one, two in pairwise(stems):
        if one is None or two is None:
            continue
        low, high = (one, too_long(one)), (two, too_long(two))
        if not low[1] * high[1] < 0.0 or max(abs(low[1]), abs(high[1])) > _NEAR_BOTH:
            continue
        for _ in range(_BOTH_STEPS):
            share = low[0].share + (high[0].share - low[0].share) * low[1] / (low[1] - high[1])
            middle = _stem(cycle, k, share, one.damping, one.limit)
            off = math.nan if middle is None else too_long(middle)
            if middle is None or math.isnan(off):
                break
            low, high = ((middle, off), high) if off * low[1] > 0.0 else (low, (middle, off))
            if abs(off) < _SAME:
                yield middle
                break


def _unlike(stem: _Stem, cycle: JumpCycle) -> float:
    """How far the stem's jumps are from the measured wave, as a share of its square.

    By the amplitudes alone, for the least error of k and F_0 puts them out of step.
    """
    off_m = stem.waves_m[: cycle.waves_m.size] - cycle.waves_m
    return float(off_m @ off_m) / float(cycle.waves_m @ cycle.waves_m)


def _stiction(
    cycle: JumpCycle, mass_kg: float, spring: float, viscous: float, limit: float
) -> tuple[float, float, FloatArray] | None:
    """F_s - F_c with which the stem jumps in this cycle, how far the mean friction is below F_s, N, and the wave's
    amplitude and those of its overtones, m.

    None where no F_s - F_c gives the cycle: the stem slides, or its swing is slower.
    """
    gained_n = cycle.period_s * cycle.rate_n_per_s
    low_n, high_n = _FORCES[0] * gained_n, _FORCES[1] * gained_n

    def valve(more_n: float) -> ValveParameters:
        return ValveParameters(mass_kg, spring, viscous, gained_n, gained_n + more_n, limit, 0.0)

    if _rests_s(valve(high_n), cycle) is None:
        return None
    for _ in range(_HALVINGS):
        middle_n = math.sqrt(low_n * high_n)
        rests_s = _rests_s(valve(middle_n), cycle)
        if rests_s is None or _period(rests_s) < cycle.period_s:
            low_n = middle_n
        else:
            high_n = middle_n
        if high_n < (1.0 + _NEAR) * low_n:
            break
    rests_s = _rests_s(valve(high_n), cycle)
    if rests_s is None or abs(_period(rests_s) / cycle.period_s - 1.0) > _SAME:
        return None
    out_s = np.linspace(rests_s[-2], rests_s[-1], _PLACES, endpoint=False)
    begin_n = gained_n + high_n
    position_m = simulate_motion(valve(high_n), *_ramp(begin_n, cycle), out_s, initial=StemState(0.0)).position_m
    friction_n = float(np.mean(begin_n + cycle.rate_n_per_s * out_s - spring * position_m))
    off_m = position_m - cycle.rate_n_per_s / spring * out_s
    return high_n, begin_n - friction_n, np.abs(np.fft.rfft(off_m))[1:] * 2.0 / _PLACES


def _ramp(begin_n: float, cycle: JumpCycle) -> tuple[list[float], list[float]]:
    end_s = _RUN * cycle.period_s
    return [0.0, end_s], [begin_n, begin_n + cycle.rate_n_per_s * end_s]


def _rests_s(valve: ValveParameters, cycle: JumpCycle) -> list[float] | None:
    """Instants at which the stem comes to rest on a ramp, s, from its third rest on; None where it has too few."""
    corners = _ramp(valve.static_friction_n, cycle)
    try:
        motion = simulate_motion(valve, *corners, [], initial=StemState(0.0), most_events=_EVENTS)
    except MotionError:
        return None
    rests_s: list[float] = motion.events.time_s[motion.events.mode == Mode.STUCK].tolist()
    return rests_s[2:] if len(rests_s) > _RUN // 2 else None


def _period(rests_s: list[float]) -> float:
    return (rests_s[-1] - rests_s[0]) / (len(rests_s) - 1)
