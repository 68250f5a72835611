"""Friction at the seat, hidden in valves that a test takes down to closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis, Verdict
from simulator.recorded import recorded
from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case as judged
from tests.support.rough_valves import VALVES, rough_valve
from valve.effects.local_friction import LocalFriction
from valve.nameplate import Signal
from valve.waveform import Waveform


def _found(valve: str, rise: float, width: float, seed: int) -> RoughDiagnosis:
    """The diagnosis of a test that goes by F_c below the bench set, so that the stem comes back to closed."""
    parameters, nameplate = VALVES[valve]
    actuator = nameplate.actuator
    assert actuator.diaphragm_area_m2 is not None
    friction_n = parameters.coulomb_friction_n
    range_pa = (20.0e3 - friction_n / actuator.diaphragm_area_m2, 100.0e3)
    effects = [LocalFriction(rise * friction_n, 0.0, width * actuator.travel_m)] if rise else []
    made = rough_valve(valve, "usual", seed, effects=effects)
    assert made.pressure is not None
    signal = Signal((4.0, 20.0), range_pa)
    made = replace(
        made,
        nameplate=replace(nameplate, signal=signal),
        transducer=replace(made.transducer, range_pa=range_pa),
        pressure=replace(made.pressure, span=(0.0, 110.0e3)),
    )
    # three strokes from where the stem rests at 0
    strokes_pa = np.array([20.0e3, *(3 * (range_pa[1], range_pa[0]))])
    recording, _ = recorded(made, Waveform("strokes", 10.0 * np.arange(7, dtype=np.float64), strokes_pa), 1.0e-3)
    return diagnose(recording, made.nameplate)


@pytest.mark.parametrize(
    ("valve", "rise", "width"), [("large", 0.4, 0.03), pytest.param("small", 0.8, 0.02, marks=pytest.mark.long)]
)
def test_friction_at_the_seat_is_named_with_its_size(valve: str, rise: float, width: float) -> None:
    found = _found(valve, rise, width, 51)
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["seat_friction"]
    friction_n = VALVES[valve][0].coulomb_friction_n
    assert found.causes[0].parameters["rise_n"].value == pytest.approx(rise * friction_n, rel=0.3)
    assert "near closed" in found.causes[0].sentence


@pytest.mark.long
def test_slow_rows_that_hardly_show_a_breakaway_hide_no_friction_at_the_seat() -> None:
    # on rows of 20 ms its breakaways seem to differ by 23 N of 40, known to a third: nothing to leave a cause open for
    analysis, _ = diagnosed(judged("hidden", 258, sizes=(0.5477225575051662,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == ["seat_friction"]


def test_a_healthy_valve_that_closes_has_no_friction_at_its_seat() -> None:
    assert _found("large", 0.0, 0.03, 52).causes == ()
