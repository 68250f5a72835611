"""Each rule about what a stem can do, at the limit at which it begins to count."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import pytest

from drivers.faults import FrozenSensorError, NoBreakawayError
from drivers.outcome import Sample
from drivers.permissive_rules import PermissiveRules
from drivers.stem_rules import StemRules
from tests.support.played_device import LIMITS, WIRING
from tests.support.reference_device import SPAN_PA
from valve.errors import DeviceError

TRAVEL_M = 0.1
PERIOD_S = 0.02


def rules(*, band_m: float | None = None, unrest_m: float = 0.0) -> StemRules:
    wiring = replace(
        WIRING, limits=replace(LIMITS, band_m=band_m), permissives=PermissiveRules(position_m=(0.0, TRAVEL_M))
    )
    begun = StemRules(wiring)
    begun.begin(Sample(0.0, 0.0, 0.05, 0.0, 0.0), unrest_m)
    return begun


def ended(
    begun: StemRules,
    looks: Iterable[int],
    position_m: Callable[[int], float] = lambda _: 0.05,
    pressure_pa: Callable[[int], float] = lambda _: 0.0,
    output_pa: Callable[[int], float] | None = None,
) -> tuple[int, DeviceError] | None:
    """The look at which it ended, and why; the output is the pressure where nothing else is said."""
    for look in looks:
        acting_pa = pressure_pa(look)
        asked_pa = acting_pa if output_pa is None else output_pa(look)
        fault = begun.fault(Sample(look * PERIOD_S, look * PERIOD_S, position_m(look), acting_pa, asked_pa))
        if fault is not None:
            return look, fault
    return None


def stepped(share: float, at: int = 1) -> Callable[[int], float]:
    """A pressure that is 0 before this look and then this share of the limits' span."""
    return lambda look: 0.0 if look < at else share * SPAN_PA


@pytest.mark.parametrize(("share", "ends"), [(0.94, False), (0.96, True)])
def test_a_stem_that_stands_against_all_but_a_twentieth_of_the_span_for_a_second_is_stuck(
    share: float, ends: bool
) -> None:
    found = ended(rules(), range(200), pressure_pa=stepped(share))
    assert (found is not None) == ends
    if found is not None:
        assert isinstance(found[1], NoBreakawayError)
        assert found[0] == pytest.approx(51, abs=1)


@pytest.mark.parametrize(("moved", "ends"), [(0.9e-3, True), (1.1e-3, False)])
def test_a_thousandth_of_the_travel_is_a_motion(moved: float, ends: bool) -> None:
    def position_m(look: int) -> float:
        return 0.05 + (moved * TRAVEL_M if look % 2 else 0.0)

    assert (ended(rules(), range(100), position_m, stepped(0.96)) is not None) == ends


@pytest.mark.parametrize(("moved_m", "ends"), [(0.9e-5, True), (1.1e-5, False)])
def test_where_the_travel_is_not_known_ten_micrometres_are_a_motion(moved_m: float, ends: bool) -> None:
    begun = StemRules(replace(WIRING, permissives=PermissiveRules()))
    begun.begin(Sample(0.0, 0.0, 0.05, 0.0, 0.0), 0.0)
    assert (ended(begun, range(100), lambda look: 0.05 + moved_m * (look % 2), stepped(0.96)) is not None) == ends


def test_three_times_the_unrest_at_entry_is_a_motion_where_that_is_more() -> None:
    def moving(by_m: float) -> Callable[[int], float]:
        return lambda look: 0.05 + (by_m if look % 2 else 0.0)

    assert ended(rules(unrest_m=1.0e-4), range(100), moving(2.9e-4), stepped(0.96)) is not None
    assert ended(rules(unrest_m=1.0e-4), range(100), moving(3.1e-4), stepped(0.96)) is None


@pytest.mark.parametrize(("same", "kind"), [(18, NoBreakawayError), (22, FrozenSensorError)])
def test_a_sensor_with_noise_that_shows_the_same_twenty_times_is_frozen(same: int, kind: type[DeviceError]) -> None:
    # the fault comes at look 51; until `same` looks before it the position still had its noise
    def position_m(look: int) -> float:
        return 0.05 + (1.0e-6 * (look % 2) if look < 51 - same else 0.0)

    found = ended(rules(unrest_m=2.0e-6), range(200), position_m, stepped(0.96))
    assert found is not None
    assert type(found[1]) is kind


def test_without_a_pressure_the_output_counts_behind_the_slowest_positioner() -> None:
    found = ended(rules(), range(1000), pressure_pa=lambda _: math.nan, output_pa=stepped(0.96))
    assert found is not None
    # behind 1 s of lag 0.85 of the span are there after 1.9 s of 0.96, and a second later it is stuck
    lag_s = -math.log1p(-0.85 / 0.96)
    assert found[0] * PERIOD_S == pytest.approx(lag_s + 1.0, abs=0.1)
    assert ended(rules(), range(1000), pressure_pa=lambda _: math.nan, output_pa=stepped(0.94)) is None


@pytest.mark.parametrize("position_m", [-0.001, 0.101])
def test_a_position_where_no_stem_can_be_ends_it_at_the_third_look_within_a_second(position_m: float) -> None:
    found = ended(rules(), range(200), lambda look: position_m if look in {2, 3, 70, 71, 90} else 0.05)
    assert found is not None
    assert found[0] == 90


def test_a_stem_that_leaves_its_band_twice_within_a_second_ends_it() -> None:
    found = ended(rules(band_m=0.01), range(200), lambda look: 0.0601 if look in {2, 60, 105} else 0.0599)
    assert found is not None
    assert found[0] == 105


def spikes(size: float, at: set[int]) -> Callable[[int], float]:
    return lambda look: 0.05 + (size * TRAVEL_M if look in at else 0.0)


def test_three_jumps_to_and_fro_within_two_seconds_are_no_stems() -> None:
    assert ended(rules(), range(120), spikes(0.051, {10, 50, 110})) is not None  # 2.0 s from the first to the last
    assert ended(rules(), range(120), spikes(0.051, {10, 50, 112})) is None
    assert ended(rules(), range(120), spikes(0.049, {10, 50, 110})) is None


def test_a_jump_that_does_not_come_back_to_where_it_began_is_no_spike() -> None:
    def position_m(look: int) -> float:
        rests_m = 0.05 + 0.003 * (sum(look > jump for jump in (10, 50, 100)) % 2)
        return rests_m + (0.0085 if look in {10, 50, 100} else 0.0)

    assert ended(rules(), range(120), position_m) is None


def test_a_jump_with_the_pressure_is_no_spike() -> None:
    jumps = {10, 50, 100}
    pulsed = ended(rules(), range(120), spikes(0.06, jumps), lambda look: 0.04 * SPAN_PA * (look in jumps))
    assert pulsed is None


def test_after_a_step_of_the_pressure_a_stem_may_swing_for_four_seconds() -> None:
    swinging = {look for look in range(12, 205) if look % 4 == 0}
    assert ended(rules(), range(205), spikes(0.06, swinging), stepped(0.06, at=10)) is None
    found = ended(rules(), range(205), spikes(0.06, swinging), stepped(0.04, at=10))
    assert found is not None
    late = {look for look in range(212, 240) if look % 4 == 0}
    assert ended(rules(), range(240), spikes(0.06, late), stepped(0.06, at=10)) is not None


@pytest.mark.parametrize(("size", "ends_at"), [(0.31, 10), (0.29, None)])
def test_spikes_are_seen_on_a_fast_ramp_and_between_late_looks_too(size: float, ends_at: int | None) -> None:
    begun, late_s = rules(), 0.08  # 6 % of the span and of the travel from look to look, there and back
    for look in range(20):
        share = 0.06 * min(look, 20 - look)
        position_m = TRAVEL_M * (share + size * (look % 3 == 0))
        fault = begun.fault(Sample(look * late_s, look * late_s, position_m, share * SPAN_PA, share * SPAN_PA))
        if fault is not None:
            assert "to and fro" in str(fault)
            assert look == ends_at
            return
    assert ends_at is None


@pytest.mark.parametrize(
    ("asked", "drifted", "ends"), [(0.76, 0.009, True), (0.74, 0.009, False), (0.76, 0.011, False)]
)
def test_a_pressure_that_stays_while_the_output_goes_over_three_quarters_of_the_span_is_a_stuck_positioner(
    asked: float, drifted: float, ends: bool
) -> None:
    def pressure_pa(look: int) -> float:
        return drifted * SPAN_PA * (look % 2)

    def position_m(look: int) -> float:
        return 0.05 + 0.001 * (look % 2)  # it moves, so that it is not the stem that stands

    found = ended(rules(), range(200), position_m, pressure_pa, stepped(asked))
    assert (found is not None) == ends
    if found is not None:
        assert "check the I/P" in str(found[1])
        assert found[0] == pytest.approx(51, abs=1)


def test_once_it_stands_down_nothing_is_said_of_a_stem_that_does_not_move() -> None:
    for pressure_pa in (stepped(1.0), stepped(0.0)):
        begun = rules()
        begun.stand_down()
        assert ended(begun, range(200), pressure_pa=pressure_pa, output_pa=stepped(1.0)) is None


def test_a_stem_that_moved_has_another_second_after_the_next_swing_of_the_pressure() -> None:
    found = ended(
        rules(),
        range(300),
        lambda look: 0.05 if look < 46 else 0.051,
        lambda look: 0.96 * SPAN_PA if 1 <= look < 60 else 0.0,
    )
    assert found is not None
    assert found[0] == pytest.approx(110, abs=1)


def test_a_pressure_that_moved_has_another_second_after_the_next_swing_of_the_output() -> None:
    found = ended(
        rules(),
        range(300),
        lambda look: 0.05 + 0.001 * (look % 2),
        lambda look: 0.0 if look < 46 else 0.05 * SPAN_PA,
        lambda look: 0.76 * SPAN_PA if 1 <= look < 60 else 0.0,
    )
    assert found is not None
    assert found[0] == pytest.approx(110, abs=1)


@pytest.mark.parametrize(("share", "ends"), [(0.29, False), (0.31, True)])
def test_the_limits_may_say_within_which_pressure_a_healthy_stem_moves(share: float, ends: bool) -> None:
    begun = StemRules(replace(WIRING, limits=replace(LIMITS, breakaway_pa=0.3 * SPAN_PA)))
    begun.begin(Sample(0.0, 0.0, 0.05, 0.0, 0.0), 0.0)
    assert (ended(begun, range(100), pressure_pa=stepped(share)) is not None) == ends
