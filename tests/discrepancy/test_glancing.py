"""A short look at a cause where the plain valve leaves noise alone, and what a round makes of it."""

from __future__ import annotations

from typing import Final

import pytest

from discrepancy import selection
from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.forces import VIBRATION
from discrepancy.glancing import glance
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import begun, screen
from discrepancy.selection import choose
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise
from tests.blind.cases import blind_case

# The plain valve led to its lowest: a wide DV stands in for what shakes, and 1.14 of the noise's variance is left.
PLAIN: Final = {
    "m": 1.52, "k": 212198.38, "F_v": 52754.105, "F_c": 859.39659, "d": 0.19439874, "F_0": 2701.1656,
    "DV": 0.0015394498, "first_rise": 5.539884, "x_0": -2.8893537e-05,
}  # fmt: skip
MUCH: Final = 300.0  # of a cost, where the true model takes 549


@pytest.fixture(scope="module")
def plain() -> Fit:
    """A far overdamped stem that is shaken by a fifth of its noise."""
    case = blind_case(10037, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    model = Model(observed, baseline_unknowns(observed, 0.0098, 1300.0))
    fit = start_fit(model, model.unknowns.point(PLAIN))
    assert is_noise(fit)
    return fit


@pytest.mark.parametrize("off", [0.0, 1.0e-13])
def test_a_shaken_stem_is_seen_though_each_line_costs_more_as_it_stands(plain: Fit, off: float) -> None:
    fit = start_fit(plain.model, plain.point * (1.0 + off))
    setting = setting_of(fit)
    [candidate] = screen(fit, [VIBRATION], setting)
    assert begun(fit, candidate, setting).cost > fit.cost
    assert fit.cost - glance(fit, candidate, setting).cost > MUCH


def test_a_round_keeps_what_the_glance_led_to_where_a_search_ends_above_it(
    plain: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = setting_of(plain)
    [candidate] = screen(plain, [VIBRATION], setting)
    monkeypatch.setattr(selection, "refits", lambda *_: [(VIBRATION, begun(plain, candidate, setting))])
    found = choose(plain, [VIBRATION], lambda _share, _phase: None)
    assert found.causes == (VIBRATION,)
    assert found.best.values["vibration.frequency_hz"] == pytest.approx(24.604, rel=1.0e-3)
