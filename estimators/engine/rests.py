"""The rests between the steps of a force: what they tell of the spring, the preload and the friction.

A stem that slides after a step and does not swing comes to rest where the force no longer drives it:
s (U - k x - F_0) = F_c - o E, with E the force that drove it beyond F_c and o the share by which it overshoots. So
the rests take the place of the blocks of driven motion in the balance. Between which forces a stem broke away is
what ``brackets`` makes of the same steps.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import NORMAL_95, student_95
from estimators.engine.balance import Balance, Blocks, balance
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.stepped import Held, Stepped

FloatArray = npt.NDArray[np.float64]

_FEWEST_RESTS: Final = 5  # after slides, both directions among them
_SWUNG_PERCENT: Final = 5.0  # of a slide: a stem that swung back rests anywhere between -F_c and F_c
_OVERSHOOTS: Final = (3.0e-3, 0.15)  # of a slide, where its shape says none, and where it is not seen
_COLOURED_S: Final = 0.1  # rows so near to each other share their noise
_BEYOND: Final = 5.0  # errors by which a rest on a stop is off the balance
_HELD: Final = 1.5  # times what usually moves a stem on
_MOST_TIMES: Final = 19.0  # 97.5 % of valves have one of at most so many times as much, e^(1.96 * 1.5)
_LONGER: Final = 3.0  # of a slide that is cut by half, its lag over its tail


def balance_of_rests(reading: Reading, found: Stepped) -> tuple[Balance, tuple[Held, ...]] | None:
    """Return the balance of the rests after slides, and the slides onto a travel stop; None with too few others.

    Rests on a stop are left out: there the stem is held by more than friction.
    """
    slides = [one for one in found.held if _rests_on_friction(one)]
    if not slides:
        return None
    band_m = 2.0 * reading.segmentation.band_m
    ends_m = [one.answer.end_m for one in slides]
    outer = [one for one in slides if not min(ends_m) + band_m < one.answer.end_m < max(ends_m) - band_m]
    held = _held_outwards(found)
    on_stop = [one for one in outer if one in held]
    inner = _balance(reading, found, [one for one in slides if one not in outer])
    if inner is not None:
        on_stop += [one for one in outer if one not in on_stop and _is_held(one, inner)]
    rests = _balance(reading, found, [one for one in slides if one not in on_stop]) or inner
    return None if rests is None else (rests, tuple(on_stop))


def _held_outwards(found: Stepped) -> list[Held]:
    """Slides after which more of the same direction moved nothing than moved the stem on after other slides."""
    rested: Held | None = None
    moved_n: list[float] = []
    unmoved_n: list[tuple[Held, float]] = []
    for one in found.held:
        if rested is not None:
            onward_n = rested.sign * (one.after_n - rested.after_n)
            if not one.answer.moved:
                unmoved_n.append((rested, onward_n))
            elif one.sign == rested.sign:
                moved_n.append(onward_n)
        if one.answer.moved:
            rested = one
    usual_n = float(np.median(moved_n)) if moved_n else math.inf
    return [one for one, onward_n in unmoved_n if onward_n > _HELD * usual_n]


def _rests_on_friction(held: Held) -> bool:
    answer = held.answer
    swung = answer.overshoot_percent is not None and answer.overshoot_percent > _SWUNG_PERCENT
    return answer.moved and answer.settled and held.sign * (held.after_n - held.before_n) > 0.0 and not swung


def _is_held(held: Held, inner: Balance) -> bool:
    """Whether a stem at rest is driven on by more than the friction that the other rests show."""
    slopes = np.array([held.answer.end_m, 1.0, held.sign, 0.0])
    left_n = held.sign * (held.after_n - float(slopes @ inner.values))
    rough = inner.roughness
    own_n = math.sqrt(rough.common_n**2 + rough.own_n**2 + rough.wander_n**2 + rough.error_n**2)
    error_n = math.sqrt(max(float(slopes @ inner.joint @ slopes), 0.0) + own_n**2)
    return left_n > _BEYOND * error_n + 0.1 * inner.known("F_c").value


def _balance(reading: Reading, found: Stepped, slides: list[Held]) -> Balance | None:
    """The balance with the rests of these slides for blocks; its fourth value is the share that they overshoot."""
    if len(slides) < _FEWEST_RESTS:
        return None
    time_s, rows = reading.time_s, []
    for one in slides:
        step = one.answer.step
        length_s = 0.25 * float(time_s[step.last] - time_s[step.row])
        middle_s = 0.5 * float(time_s[step.row] + time_s[step.last])
        count = max(1.0, min(0.25 * (step.last - step.row), length_s / _COLOURED_S))
        rows.append((middle_s, one.answer.end_m, one.after_n, one.sign, count, length_s))
    time, travel, force, sign, count, length = np.ascontiguousarray(np.array(rows).T)
    started_m = np.array([one.answer.start_m for one in slides])
    # what drove each slide is not known before the balance: without any overshoot, then with what that one says
    beyond_n, rests, widths = reading.spring_n_per_m * np.abs(travel - started_m), None, (_OVERSHOOTS[0],) * 2
    if not found.damped:
        widths = _OVERSHOOTS
    for width in widths:
        rests = balance(
            Blocks(time, travel, -sign * beyond_n, force, sign, count, length),
            noise_m=reading.noise_m,
            travel_m=reading.travel_m,
            has_spring=True,
            force_noise_n=reading.samples.force_noise_n / math.sqrt(float(count.min())),
            lag=Known(0.0, width),
            fewest_blocks=_FEWEST_RESTS,
        )
        if rests is None or min(rests.known("k").value, rests.known("F_c").value) <= 0.0:
            return None
        spring, preload, coulomb, _ = rests.values
        beyond_n = np.maximum(sign * (force - spring * started_m - preload) - coulomb, 0.0)
    return None if rests is None else _widened(rests, found)


def _widened(rests: Balance, found: Stepped) -> Balance:
    """Return the balance with what a few rests leave open: the friction between them, and where a stem stops at DV.

    It stops short of where the force would lead, by what it is late at that speed.
    """
    values, joint = rests.values.copy(), rests.joint.copy()
    coulomb, preload = rests.symbols.index("F_c"), rests.symbols.index("F_0")
    usual_n = found.short_n(rests.known("k").value)
    # a slide that is cut short has a shorter tail than its lag
    most_n = min(_MOST_TIMES * _LONGER * usual_n, 0.9 * values[coulomb])
    short_n = min(usual_n, 0.5 * most_n)
    values[coulomb] -= short_n
    joint[coulomb, coulomb] += ((most_n - short_n) / NORMAL_95) ** 2 + found.swing_n**2
    joint[preload, preload] += found.swing_n**2
    rough, direction = rests.roughness, rests.blocks.direction
    between = 0.25 * sum(1.0 / int((direction == way).sum()) for way in (1.0, -1.0))
    for at in (coulomb, preload):
        joint[at, at] += between * (rough.common_n**2 + rough.own_n**2)
    # as many rests for three values: Student's t
    freedom = max(1, rests.blocks.count - 3)
    joint *= (student_95(freedom) / NORMAL_95) ** 2
    return replace(rests, symbols=("k", "F_0", "F_c", "overshoot"), values=values, joint=joint)
