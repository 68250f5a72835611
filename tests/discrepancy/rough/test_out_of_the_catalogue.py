"""What is in no catalogue is given no name, whichever cause explains a part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.rough.creeping import moves_at_rest
from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import Verdict
from estimators.engine.reading import Reading, read
from tests.bench.blind.cases import HELD_OUT, blind_case
from tests.support.rough_valves import case
from valve.effects.base import Effect
from valve.effects.position_lag import PositionLag


@pytest.mark.parametrize(
    ("seed", "oddity"),
    [
        (9104, "slipping_bracket"),  # a spring of two rates, beside which four breakaways differ by half of F_s
        (9111, "creeping_stem"),  # it does not yield: its way grows with time
        (9118, "wandering_zero"),  # a drift and a tight spot, beside which they do so too
        (9841, "wandering_spring"),  # a drift of friction, where the force wanders alike both ways
        (9878, "slipping_bracket"),  # the same, where the position moves while the stem rests
    ],
)
def test_a_cause_that_explains_a_part_of_what_is_odd_is_not_named(seed: int, oddity: str) -> None:
    made = blind_case(seed, "odd")
    assert made.oddity == oddity
    (recording,) = made.recordings
    found = diagnose(recording, made.nameplate, held_out=((HELD_OUT, made.held_out),))
    assert found.verdict in {Verdict.UNEXPLAINED, Verdict.NONE}
    assert found.causes == ()


def test_a_bracket_that_slips_is_no_reading_that_lags() -> None:
    made = case("large", "multi_rate", "usual", seed=504)
    recording, travel_m = made.recording, made.nameplate.actuator.travel_m
    rng, slipped_m = np.random.default_rng(504), np.zeros(made.recording.samples)
    slips_s = np.sort(rng.uniform(0.1, 0.9, 5)) * recording.duration_s
    sizes_m = rng.uniform(-0.03, 0.03, 5) * travel_m
    for at_s, size_m in zip(slips_s, sizes_m, strict=True):
        slipped_m += size_m * (recording.time_s > at_s)
    found = diagnose(replace(recording, position_m=recording.position_m + slipped_m), made.nameplate)
    assert found.verdict is Verdict.UNEXPLAINED
    assert "more than packings do" in found.message


@pytest.mark.parametrize(
    ("sequence", "grade", "effects"), [("diagnostic", "hard", ()), ("triangle", "usual", (PositionLag(0.4),))]
)
def test_a_position_that_stays_while_the_stem_rests_is_told_from_one_that_wanders(
    sequence: str, grade: str, effects: tuple[Effect, ...]
) -> None:
    made = case("nominal", sequence, grade, seed=31, effects=effects)
    for drift, moves in ((0.0, False), (3.0e-4, True)):  # of the travel in a second, to and fro within 20 s
        time_s = made.recording.time_s
        wandering_m = drift * made.nameplate.actuator.travel_m * 20.0 / np.pi * np.sin(time_s * np.pi / 20.0)
        reading = read(replace(made.recording, position_m=made.recording.position_m + wandering_m), made.nameplate)
        assert isinstance(reading, Reading)
        assert (moves_at_rest(reading) is not None) is moves


def test_a_pause_of_hours_costs_no_more_than_the_rows_that_there_are() -> None:
    made = blind_case(9841, "odd")
    (recording,) = made.recordings
    half = recording.samples // 2
    later_s = np.where(
        np.arange(recording.samples) < half, 0.0, 6.0 * 3600.0
    )  # a grid of this time would not fit into memory
    found = diagnose(replace(recording, time_s=recording.time_s + later_s), made.nameplate)
    assert found.verdict in {Verdict.UNEXPLAINED, Verdict.NONE}
