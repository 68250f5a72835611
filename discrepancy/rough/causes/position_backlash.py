"""Lost motion between the stem and the position sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Cause, Fitted, FloatArray, parameter
from estimators.engine.laws import LawParameter, Where
from valve.effects.base import Effect
from valve.effects.position_backlash import PositionBacklash as PlayEffect
from valve.messages import say

_HALVINGS: Final = 40
_INSTANT_S: Final = 1.0e-4  # a lag that is none


def _crossing_s(play_n: FloatArray, jump_n: float, rate_n_per_s: FloatArray, late_s: float) -> FloatArray:
    """How long after its breakaway a stem has gone k times its way = ``play_n``, s, shape (n,); 0 without a play.

    A damped stem, T late, behind a force that rises at r and friction that drops by the jump J:
    k x = J (1 - exp(-t/T)) + r (t - T (1 - exp(-t/T))).
    """
    rate = np.maximum(rate_n_per_s, 1.0e-9)
    if late_s < _INSTANT_S:
        return np.asarray(np.maximum(play_n - jump_n, 0.0) / rate)
    low_s, high_s = np.zeros(play_n.size), np.maximum(play_n, 0.0) / rate + late_s
    for _ in range(_HALVINGS):
        middle_s = 0.5 * (low_s + high_s)
        settled = -np.expm1(-middle_s / late_s)
        is_beyond = jump_n * settled + rate * (middle_s - late_s * settled) > play_n
        low_s, high_s = np.where(is_beyond, low_s, middle_s), np.where(is_beyond, middle_s, high_s)
    return np.where(play_n > 0.0, high_s, 0.0)


class PositionBacklash(Cause):
    """A sensor that trails the stem by half of its play.

    In motion k play/2 looks like friction. At a breakaway it does so too if the stem goes on as it came, and has the
    other sign if it turns: so a test in which the stem rests and goes on shows it. The reading of a stem that turns
    moves when the stem has crossed the play, and by then the force has gone on.
    """

    name: ClassVar[str] = "position_backlash"
    action: ClassVar[str] = say(
        "position_backlash_action", "Look at the linkage between stem and position sensor: a worn pin, a loose clamp."
    )
    needs_spring: ClassVar[bool] = True

    def natural(self) -> tuple[LawParameter, ...]:
        """Up to 5 % of the travel."""
        return (parameter("play_m", "m", 0.0, 0.05 * self.setting.travel_m, spread=0.008 * self.setting.travel_m),)

    def friction_n(self, values: FloatArray, where: Where) -> FloatArray:
        """Return the spring's force over half of the play; none over the way of a slip that crosses it."""
        half_n = 0.5 * values[0] * self.setting.spring_n_per_m
        return np.where(where.direction * where.before < 0.0, 0.0, half_n)

    def breakaway_n(self, values: FloatArray, where: Where, share: float) -> FloatArray:
        """Return the same where the stem goes on; where it turns the opposite, and what the force gained meanwhile."""
        half_n = np.full(where.count, 0.5 * values[0] * self.setting.spring_n_per_m)
        rate = np.abs(where.rate_n_per_s)
        jump_n = max(share - 1.0, 0.0) * max(self.setting.friction_n - float(half_n.max(initial=0.0)), 0.0)
        # a play hides the jump from the plain valve: then it is taken to reach across
        jump_n = max(jump_n, 2.0 * float(half_n.max(initial=0.0)))
        gained_n = rate * _crossing_s(2.0 * half_n, jump_n, rate, self.setting.late_s)
        turns = where.direction * where.before < 0.0
        return np.asarray(where.direction * where.before * half_n + np.where(turns, gained_n, 0.0))

    @override
    def effect(self, values: FloatArray, short_n: float = 0.0) -> Effect:
        """Return the effect that a simulated valve takes."""
        return PlayEffect(float(max(values[0], 0.0)))

    def sentence(self, fitted: Mapping[str, Fitted]) -> str:
        """Return what a fitter is told."""
        return say(
            "lost_motion", "The position reading has {play} of lost motion.", play=fitted["play_m"].in_words("mm")
        )
