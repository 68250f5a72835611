"""Rests and breakaways are found as the simulated valve made them, on all grades, at 1 and 20 ms."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from estimators.engine.sections import sections_of
from tests.support.published_recordings import stroked
from tests.support.rough_valves import RoughCase, case
from valve.effects.position_lag import PositionLag

_NEAR_S = 0.06  # an instant that far from a true one is another


def _compared(found: RoughCase) -> tuple[int, int, int]:
    """Return the numbers of true breakaways (the first move has none seen), missed ones and false ones."""
    reading = read(found.recording, found.nameplate)
    assert isinstance(reading, Reading)
    seen_s = np.array([move.began_s for move in reading.segmentation.breakaways])
    true_s = found.truth.breakaways_s
    missed = sum(not (np.abs(seen_s - one) < _NEAR_S).any() for one in true_s)
    false = sum(not (np.abs(true_s - one) < _NEAR_S).any() for one in seen_s)
    return true_s.size, missed, false


@pytest.mark.parametrize(
    "valve", ["nominal", "small", *(pytest.param(one, marks=pytest.mark.long) for one in ("rough", "large"))]
)
@pytest.mark.parametrize("sequence", ["triangle", pytest.param("multi_rate", marks=pytest.mark.long)])
@pytest.mark.parametrize("grade", ["ideal", pytest.param("mild", marks=pytest.mark.long), "usual"])
def test_every_breakaway_is_found_and_none_is_made_up(valve: str, sequence: str, grade: str) -> None:
    # an ideal packing's breakaways are noted only where it has one
    packing = {"breakaway_scatter": 1.0e-9} if grade == "ideal" else {}
    true, missed, false = _compared(case(valve, sequence, grade, 1.0e-3, seed=3, packing=packing))

    assert missed <= max(1, true // 20)
    assert false == 0


@pytest.mark.parametrize("sequence", ["triangle", "multi_rate"])
def test_a_hard_packing_makes_few_breakaways_up(sequence: str) -> None:
    counts = np.array([_compared(case(valve, sequence, "hard", 1.0e-3, seed=4)) for valve in ("nominal", "small")])

    assert counts[:, 2].sum() <= 0.1 * counts[:, 0].sum()


@pytest.mark.parametrize(("valve", "sequence", "lag_s"), [("rough", "triangle", 0.3), ("nominal", "multi_rate", 0.1)])
def test_the_tail_of_a_reading_that_lags_is_no_row_of_rests(valve: str, sequence: str, lag_s: float) -> None:
    true, missed, false = _compared(case(valve, sequence, "usual", 1.0e-3, seed=3, effects=[PositionLag(lag_s)]))

    assert missed <= max(1, true // 20)
    assert false == 0


@pytest.mark.parametrize("valve", ["nominal", "large"])
def test_rests_are_found_in_polled_rows(valve: str) -> None:
    true, missed, false = _compared(case(valve, "multi_rate", "usual", 2.0e-2, seed=5))

    assert missed <= max(1, true // 20)
    assert false <= 1


def test_a_rest_lies_where_the_stem_rested() -> None:
    found = case("nominal", "triangle", "usual", 1.0e-3, seed=6)
    reading = read(found.recording, found.nameplate)
    assert isinstance(reading, Reading)

    for move in reading.segmentation.breakaways[1:]:
        true_m = found.truth.breakaways_m[np.argmin(np.abs(found.truth.breakaways_s - move.began_s))]
        assert abs(reading.segmentation.rests[move.rest].level_m - true_m) < 2.0e-6


@pytest.mark.parametrize("seed", [8402, 8408])
def test_what_sets_off_on_a_fast_ramp_is_no_second_rest(seed: int) -> None:
    found = case("large", "multi_rate", "usual", 1.0e-3, seed=seed)
    reading = read(found.recording, found.nameplate)
    assert isinstance(reading, Reading)
    rests = reading.segmentation.rests

    for move in reading.segmentation.breakaways:
        true_s = found.truth.breakaways_s[np.argmin(np.abs(found.truth.breakaways_s - move.began_s))]
        assert reading.time_s[rests[move.rest].first] < true_s


def test_a_stem_that_slips_again_and_again_is_not_taken_for_one_that_slides() -> None:
    # the rests are a few times as long as what noise hides: F_c came out 9 % too large, with an interval of 1 %
    test = stroked({"m": 7.1, "k": 1.58e5, "F_v": 790.0, "F_c": 318.0, "F_s": 404.0, "DV": 3.7e-5}, noise_m=1.5e-5)
    reading = read(test.recording, test.nameplate)
    assert isinstance(reading, Reading)
    assert len(reading.segmentation.breakaways) > 100
    estimate, truth = RoughFrictionEstimator().estimate(test.recording, test.nameplate), test.truth.by_symbol()

    for symbol, most in (("k", 0.002), ("F_c", 0.04), ("F_s", 0.03)):
        one = estimate.parameters[symbol]
        assert one.value is not None, one.note
        assert one.ci95 is not None
        assert one.value == pytest.approx(truth[symbol], rel=most)
        assert one.ci95[0] < truth[symbol] < one.ci95[1]


_QUICK = {"m": 0.31, "k": 2.4e5, "F_v": 20.0, "F_c": 240.0, "F_s": 420.0, "DV": 1.7e-5}  # it slips within 3.6 ms


def test_a_slip_within_four_rows_is_followed_as_it_goes() -> None:
    # steps of a row each put F_c 4 % too low, with an interval of 0.6 %
    test = stroked(_QUICK, noise_m=1.0e-6, period_s=1.0e-3, cycles=1)
    estimate = RoughFrictionEstimator().estimate(test.recording, test.nameplate)

    for symbol, most in (("k", 1.0e-4), ("m", 0.01), ("F_c", 0.015), ("F_s", 0.005)):
        assert estimate.value(symbol) == pytest.approx(_QUICK[symbol], rel=most)


def test_a_slip_may_come_to_rest_as_the_recording_ends() -> None:
    test = stroked(_QUICK, noise_m=1.0e-6, period_s=1.0e-3, cycles=1)
    rows = measured_rows(test.recording).recording
    whole = read(rows, test.nameplate)
    assert isinstance(whole, Reading)
    slip = whole.segmentation.breakaways[-1]
    cut = read(rows.rows(rows.time_s < whole.time_s[slip.last] + 0.002), test.nameplate)
    assert isinstance(cut, Reading)
    last = sections_of(cut, Known(1.0e-3, 1.0e-3)).sections[-1]

    assert cut.segmentation.breakaways[-1].next_rest < 0
    assert last.free < last.time_s.size
