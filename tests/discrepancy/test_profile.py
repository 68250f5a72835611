"""A bent valley is walked to its lowest place, and intervals reach as far as the cost stays low."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar, Final

import numpy as np
import pytest

from discrepancy.choice import Choice
from discrepancy.intervals import standard_errors, with_errors_and_ways
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.profile import at_the_lowest, profiled
from discrepancy.registry import CAUSES
from discrepancy.unknowns import Unknown, Unknowns
from estimators.samples import FloatArray

ROWS: Final = 400
# two directions of unit length
ACROSS: Final = np.sin(0.1 * np.arange(ROWS)) / np.linalg.norm(np.sin(0.1 * np.arange(ROWS)))
ALONG: Final = np.where(np.arange(ROWS) % 2 == 0, 1.0, -1.0) / math.sqrt(ROWS)
NOISE: Final = np.random.default_rng(5).standard_normal(ROWS)
LEFT: Final = NOISE - ACROSS * (ACROSS @ NOISE) - ALONG * (ALONG @ NOISE)


class Bent(Model):
    """A valley b = a^3 with the lowest place at a = 0, steep across and flat along."""

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Noise, across the valley, along it."""
        a, b = point
        return np.asarray(LEFT + 1.0e4 * (b - a**3) * ACROSS + 5.0 * a * ALONG)


class Fading(Model):
    """What ``a`` does fades where it is large: the cost goes flat beside its bottom."""

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Noise, and a wave that is no stronger than 2.2 of it."""
        return np.asarray(LEFT + 2.2 * math.tanh(point[0]) * ALONG + point[1] * ACROSS)


def at(kind: type[Model], a: float, b: float) -> Fit:
    entries = [Unknown(name, -10.0, 10.0, unit=1.0) for name in ("flow_force.decay_m", "k")]
    observed: Any = SimpleNamespace(weight=np.ones(ROWS), count=ROWS)
    return start_fit(kind(observed, Unknowns(tuple(entries))), np.array([a, b]))


def test_a_fit_on_the_side_of_a_bent_valley_is_led_to_its_lowest_place() -> None:
    stuck = at(Bent, 1.0, 1.0)
    lowest = profiled(stuck)
    assert abs(lowest.point[0]) < 0.2  # its standard error
    assert lowest.cost < stuck.cost - 20.0


def test_intervals_reach_as_far_as_the_cost_stays_low() -> None:
    fit = at(Fading, 0.0, 0.0)
    assert standard_errors(fit) == pytest.approx([1.0 / 2.2, 1.0], rel=1.0e-3)
    half = 1.96 * standard_errors(profiled(fit))[0]
    # 2.2 tanh(a) = 1.96 is reached between two places of the walk
    assert half == pytest.approx(1.06 * math.atanh(1.96 / 2.2), rel=0.06)


def test_the_others_follow_along_the_valley() -> None:
    _, errors, ways = with_errors_and_ways(at(Bent, 1.0, 1.0))
    assert ways[0] == pytest.approx([1.0, 3.0], rel=1.0e-3)
    assert errors == pytest.approx(standard_errors(at(Bent, 1.0, 1.0)))


def test_a_lowest_place_that_no_valve_can_have_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    stuck = at(Bent, 1.0, 1.0)
    choice = Choice(stuck, stuck, (CAUSES["flow_force"],), (), (), ())
    monkeypatch.setattr("discrepancy.profile.setting_of", lambda _: None)
    monkeypatch.setattr("discrepancy.profile.is_possible", lambda *_: False)
    assert at_the_lowest(choice).best is stuck
    monkeypatch.setattr("discrepancy.profile.is_possible", lambda *_: True)
    assert at_the_lowest(choice).best.cost < stuck.cost - 20.0
    healthy = replace(choice, causes=())
    assert at_the_lowest(healthy) is healthy


class Counted(Fading):
    """A straight valley whose motions are counted."""

    followed: ClassVar[list[FloatArray]] = []

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Noise and two straight directions."""
        self.followed.append(point)
        return np.asarray(LEFT + point[0] * ALONG + point[1] * ACROSS)


def test_no_walk_is_made_where_the_cost_rises_as_the_point_says() -> None:
    fit = descend(at(Counted, 0.01, 0.3), most_steps=20)
    before = standard_errors(fit)
    Counted.followed.clear()
    walked = profiled(fit)
    # slopes forward and backward of two unknowns, and one motion to either end of the interval
    assert len(Counted.followed) == 6
    assert standard_errors(walked) == pytest.approx(before, rel=1.0e-6)


def test_a_straight_valley_keeps_its_intervals() -> None:
    fit = descend(at(Fading, 0.01, 0.3), most_steps=20)
    assert standard_errors(profiled(fit))[1] == pytest.approx(1.0, rel=1.0e-3)
