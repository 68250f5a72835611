"""What is in no catalogue is given no name, whichever cause explains a part of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import Verdict
from tests.bench.blind.cases import HELD_OUT, blind_case
from tests.support.rough_valves import case


@pytest.mark.parametrize(
    ("seed", "oddity"),
    [
        (9104, "slipping_bracket"),  # a spring of two rates, beside which four breakaways differ by half of F_s
        (9111, "creeping_stem"),  # it does not yield: its way grows with time
        (9118, "wandering_zero"),  # a drift and a tight spot, beside which they do so too
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
