"""A command over the gaps of its recording: the I/P goes on behind it, and the stem moves on."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.exact_motion import ExactMotionEstimator
from estimators.likelihood.inputs.command_gaps import over_gaps
from estimators.likelihood.inputs.input_path import TransducerPath, input_path
from estimators.likelihood.lines.stretches import KnownCorners
from tests.benchmarks.random_valves import what_is_wrong
from tests.estimators.likelihood.test_transducer_path import NAMEPLATE, TRIANGLE, commanded
from tests.estimators.random_valves import random_test
from valve.recording import Recording

pytestmark = pytest.mark.long

PERIOD_S = 0.02


def stretch(*corners: tuple[float, float]) -> KnownCorners:
    time_s, value = np.array(corners).T
    return KnownCorners(time_s.copy(), value.copy())


def drawn(before: KnownCorners, after: KnownCorners) -> list[KnownCorners]:
    gap_s = np.array([[before.last_s, after.first_s]])
    stretches, breaks_s = over_gaps((before, after), gap_s, PERIOD_S)
    assert breaks_s.shape == (len(stretches) - 1, 2)
    return [one for one in stretches if isinstance(one, KnownCorners)]


def test_a_ramp_goes_on_through_a_gap_however_long() -> None:
    (whole,) = drawn(stretch((0.0, 0.0), (1.0, 10.0)), stretch((8.0, 80.0), (9.0, 90.0)))
    assert whole.value == pytest.approx(10.0 * whole.time_s)


def test_two_lines_meet_within_a_short_gap() -> None:
    (whole,) = drawn(stretch((0.0, 0.0), (1.0, 10.0)), stretch((1.4, 10.0), (2.4, 0.0)))
    assert np.interp(1.2, whole.time_s, whole.value) == pytest.approx(12.0)
    assert np.interp(1.1, whole.time_s, whole.value) == pytest.approx(11.0)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (((0.0, 0.0), (1.0, 10.0)), ((4.0, 10.0), (5.0, 0.0))),  # a long gap may hide more than one corner
        (((0.0, 0.0), (1.0, 10.0)), ((1.2, 90.0), (2.2, 100.0))),  # lines that do not meet in it
        (((0.0, 5.0), (1.0, 5.0)), ((1.2, 5.0), (2.2, 5.0))),  # two holds may be of two recordings
    ],
    ids=["long", "apart", "holds"],
)
def test_what_does_not_go_on_stays_apart(
    before: tuple[tuple[float, float], ...], after: tuple[tuple[float, float], ...]
) -> None:
    assert len(drawn(stretch(*before), stretch(*after))) == 2


def test_the_pressure_is_still_behind_after_a_gap() -> None:
    time_s, command_pa = commanded(TRIANGLE, PERIOD_S)
    # 0.3 s in the middle of a ramp, and 0.3 s about a corner
    present = ~(((time_s > 4.0) & (time_s < 4.3)) | ((time_s > 9.85) & (time_s < 10.15)))
    values, wanted_s = np.array([0.4, 0.1]), np.linspace(0.0, TRIANGLE.duration_s, 4001)
    forces = []
    for rows in (np.ones(time_s.size, dtype=np.bool_), present):
        recording = Recording(time_s[rows], np.zeros(int(rows.sum())), command_pa=command_pa[rows])
        path = input_path(recording, NAMEPLATE)
        assert isinstance(path, TransducerPath)
        assert path.breaks_s.size == 0
        forces.append(np.interp(wanted_s, *path.corners(values)))
    assert forces[1] == pytest.approx(forces[0], abs=1.0e-5 * float(np.ptp(forces[0])))


def test_a_stem_that_jumps_in_a_gap_is_followed_through_it() -> None:
    # three gaps, one of 50 ms in the middle of a jump: with the stem begun anew after each, and a pressure that has
    # settled, the fit ended at 6.8 times the noise
    test = random_test(3001)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert what_is_wrong(estimate, test) == ()
    assert estimate.value("m") == pytest.approx(test.truth.mass_kg, rel=0.01), estimate.message
    assert estimate.value("F_v") == pytest.approx(test.truth.by_symbol()["F_v"], rel=0.05)
    # on ramps of one rate the lag stands for friction, and both for no more than that
    assert estimate.value("F_c") is None
    assert "cannot be told apart" in estimate.parameters["F_c"].note
