"""Breakaways that scatter, and what scatters them without being scatter: each is drawn by itself, or it is another."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest

from discrepancy.rough.causes.breakaway_scatter import BreakawayScatter
from discrepancy.rough.causes.seen import View

_STATIC_N = 1000.0
_COUNT = 40
_SCATTER = 0.2


def _view(away: npt.NDArray[np.float64], own: float = 0.001) -> View:
    """Breakaways to and fro whose forces are off by these shares of F_s, each known to a share of it."""
    count = away.size
    way = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    rows = SimpleNamespace(
        is_slide=np.zeros(count, np.bool_),
        variance_n2=np.full(count, (own * _STATIC_N) ** 2),
        direction=way,
        travel_m=0.03 + 0.01 * way,
        time_s=np.linspace(0.0, 120.0, count),
    )
    null = SimpleNamespace(problem=SimpleNamespace(rows=rows), left_n=_STATIC_N * away)
    setting = SimpleNamespace(static_n=_STATIC_N, full_force_n=10.0 * _STATIC_N)
    return cast(View, SimpleNamespace(null=null, setting=setting))


def _by_chance() -> npt.NDArray[np.float64]:
    return _SCATTER * np.random.default_rng(7).standard_normal(_COUNT)


def _wave() -> npt.NDArray[np.float64]:
    return np.asarray(1.4 * _SCATTER * np.sin(np.arange(_COUNT)))


def test_breakaways_that_differ_by_chance_scatter() -> None:
    seen = BreakawayScatter().seen(_view(_by_chance()))
    assert seen is not None
    scatter = seen.fitted["scatter"]
    assert scatter.value == pytest.approx(_SCATTER, rel=0.3)
    # the interval that is told says what the decision said: more than packings do
    assert scatter.value - 1.96 * scatter.std_error > 0.08


def test_breakaways_known_no_better_than_packings_scatter_tell_nothing() -> None:
    # quick ramps in slow rows: a healthy valve was named
    assert BreakawayScatter().seen(_view(2.0 * _by_chance(), 0.2)) is None


@pytest.mark.parametrize("sense", ["friction", "force"])
def test_breakaways_that_are_like_the_last_do_not_scatter(sense: str) -> None:
    wave = _wave()
    # a spring or a zero that wanders adds to one direction what it takes from the other
    away = wave if sense == "friction" else wave * np.where(np.arange(_COUNT) % 2 == 0, 1.0, -1.0)
    assert BreakawayScatter().seen(_view(away)) is None
    # the same ones in another order are by chance
    assert BreakawayScatter().seen(_view(np.random.default_rng(11).permutation(away))) is not None


def test_two_bursts_of_sticking_do_not_make_the_others_scatter() -> None:
    away = 0.05 * np.random.default_rng(5).permutation(np.repeat([-1.0, 1.0], 15))
    away[[4, 23]] = -0.45, -0.4
    assert BreakawayScatter().seen(_view(away)) is None
