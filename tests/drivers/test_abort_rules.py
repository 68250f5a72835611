"""Each rule that ends a test, at the limit at which it begins to count, by a clock that the test sets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers import abort_rules
from drivers.abort_rules import AbortRules
from drivers.addresses import TcpAddress
from drivers.device import connect_valve
from drivers.faults import NoAnswerError
from drivers.maps.reference import StatusBit
from drivers.outcome import Sample
from drivers.permissive_rules import PermissiveRules
from drivers.permissive_watch import PermissiveWatch
from drivers.recent import window_s
from drivers.transport import Transport
from tests.support.played_device import LIMITS, WIRING
from tests.support.reference_device import SPAN_PA
from valve.errors import DeviceError, EquipmentError, MeasurementError, WireError

LONGEST_S = 10.0
ENTRY_PA = 20_000.0
MANUAL = 1 << StatusBit.LOOP_IN_MANUAL
Fault = EquipmentError | MeasurementError | None


class Watched:
    """A test under the rules; ``now_s`` is the time, and a look takes none of it."""

    now_s = 100.0

    def __init__(self, period_s: float = 0.02, position_m: tuple[float, float] | None = None) -> None:
        limits = replace(LIMITS, position_m=position_m)
        wiring = replace(WIRING, limits=limits, permissives=PermissiveRules(supply_pa=(140_000.0, 200_000.0)))
        device = connect_valve(wiring, {"bus": Transport(TcpAddress("bus", "127.0.0.1", 1))})
        self.rules = AbortRules(device, limits, LONGEST_S, period_s)
        self.device = device
        self.watch = PermissiveWatch(device, permitted=False)
        self.began_s = self.now_s
        self.rules.begin(self.sample())
        self.asked_pa = [ENTRY_PA]

    def sample(
        self,
        output_pa: float = ENTRY_PA,
        *,
        position_m: float = 0.05,
        pressure_pa: float = ENTRY_PA,
        status: int = MANUAL,
        supply_pa: float = 160_000.0,
    ) -> Sample:
        return Sample(self.now_s, self.now_s, position_m, pressure_pa, output_pa, status, supply_pa)

    def look(self, output_pa: float = ENTRY_PA, **shown: float) -> Fault:
        return self.rules.fault(self.sample(output_pa, **shown))  # type: ignore[arg-type]  # status is an integer

    def miss(self, times: int = 1) -> Fault:
        for _ in range(times):
            self.rules.missed(NoAnswerError("no answer"))
        return self.rules.fault(None)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Watched]]:
    class Clock:
        @staticmethod
        def monotonic() -> float:
            return Watched.now_s

    monkeypatch.setattr(abort_rules, "time", Clock)
    yield Watched
    Watched.now_s = 100.0


def test_a_test_may_last_five_seconds_longer_than_planned(watched: type[Watched]) -> None:
    test = watched()
    for after_s, ends in ((LONGEST_S + 4.9, False), (LONGEST_S + 5.1, True)):
        watched.now_s = test.began_s + after_s
        fault = test.look()
        assert isinstance(fault, MeasurementError) == ends


def test_half_of_the_looks_within_two_seconds_five_at_least_end_it_when_they_fail(watched: type[Watched]) -> None:
    test = watched()
    assert test.miss(4) is None
    assert isinstance(test.miss(), WireError)
    good = watched()
    for number in range(200):  # a line that loses two of five looks gives gaps
        watched.now_s += 0.02
        assert (good.look() if number % 5 < 3 else good.miss()) is None
    for number in range(200):
        watched.now_s += 0.02
        fault = good.look() if number % 2 else good.miss()
        if fault is not None:
            break
    assert isinstance(fault, WireError)


@pytest.mark.parametrize(("period_s", "silence_s"), [(0.02, 1.0), (1.0, 2.0)])
def test_silence_ends_it_after_a_second_or_two_periods_but_not_by_one_failure(
    watched: type[Watched], period_s: float, silence_s: float
) -> None:
    test = watched(period_s)
    watched.now_s += 3.0 * silence_s
    assert test.miss() is None
    test.look()
    watched.now_s += 0.95 * silence_s
    assert test.miss(2) is None
    watched.now_s += 0.1 * silence_s
    assert isinstance(test.miss(), WireError)


def test_a_second_without_a_position_ends_it(watched: type[Watched]) -> None:
    test = watched()
    watched.now_s += 0.95
    assert test.look(position_m=math.nan) is None
    assert test.look() is None
    watched.now_s += 0.95
    assert test.look(position_m=math.nan) is None
    watched.now_s += 0.1
    assert "no valid position" in str(test.look(position_m=math.nan))


@pytest.mark.parametrize("period_s", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("value", ["position", "pressure"])
@pytest.mark.parametrize(("valid_of", "ends"), [((1, 20), True), ((1, 2), True), ((4, 5), False)])
def test_a_valid_value_now_and_then_does_not_hide_that_its_sensor_is_lost(
    watched: type[Watched], value: str, valid_of: tuple[int, int], ends: bool, period_s: float
) -> None:
    test = watched(period_s)
    invalid = {"position_m" if value == "position" else "pressure_pa": math.nan}
    fault: Fault = None
    while fault is None and watched.now_s < test.began_s + 14.0:
        for number in range(valid_of[1]):
            watched.now_s += period_s
            fault = test.look() if number < valid_of[0] else test.look(**invalid)
            if fault is not None:
                break
    if ends:
        assert f"no valid {value}" in str(fault)
        assert f"check the {value} sensor" in str(fault)
        assert watched.now_s - test.began_s < 2.2 * max(1.0, 2.0 * period_s) + 2.0 * period_s
    else:
        assert fault is None or isinstance(fault, MeasurementError)  # its longest time is over


def test_a_gauge_that_showed_nothing_before_the_test_is_not_missed_in_it(watched: type[Watched]) -> None:
    test = watched()
    test.rules.begin(test.sample(pressure_pa=math.nan))
    for _ in range(200):
        watched.now_s += 0.02
        assert test.look(pressure_pa=math.nan) is None


def test_a_slow_test_may_be_blind_for_two_of_its_periods(watched: type[Watched]) -> None:
    test = watched(period_s=1.0)
    watched.now_s += 1.9
    assert test.look(position_m=math.nan) is None
    watched.now_s += 0.2
    assert isinstance(test.look(position_m=math.nan), DeviceError)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pressure_beyond_the_limits_by_a_twentieth_of_their_span_ends_it_when_it_is_seen_twice(
    watched: type[Watched], sign: float
) -> None:
    test = watched()
    edge_pa = SPAN_PA if sign > 0.0 else 0.0
    for _ in range(3):
        assert test.look(pressure_pa=edge_pa + sign * 0.049 * SPAN_PA) is None
    beyond_pa = edge_pa + sign * 0.051 * SPAN_PA
    assert test.look(pressure_pa=beyond_pa) is None
    watched.now_s += 1.01
    assert test.look(pressure_pa=beyond_pa) is None
    watched.now_s += 0.5
    assert test.look() is None
    assert "is outside" in str(test.look(pressure_pa=beyond_pa))


@pytest.mark.parametrize("position_m", [0.019, 0.091])
def test_a_stem_beyond_its_limits_ends_it_when_it_is_seen_twice(watched: type[Watched], position_m: float) -> None:
    test = watched(position_m=(0.02, 0.09))
    assert test.look(position_m=position_m) is None
    assert "position" in str(test.look(position_m=position_m))


def test_a_device_at_its_safe_value_ends_it_at_once(watched: type[Watched]) -> None:
    assert "watchdog tripped" in str(watched().look(status=MANUAL | 1 << StatusBit.AT_SAFE_VALUE))


def ends_after_s(test: Watched, output_pa: float, *, most_s: float = 3.0) -> float:
    """Time from the last command to the fault while the output stays; infinite if there is none."""
    began_s = test.now_s
    while test.now_s < began_s + most_s:
        if test.look(output_pa) is not None:
            return test.now_s - began_s
        type(test).now_s += 0.02
    return math.inf


def test_an_output_that_never_follows_ends_it_half_a_second_after_it_should_have(watched: type[Watched]) -> None:
    test = watched()
    watched.now_s += 10.0 * 0.02
    test.look()
    test.rules.commanded(50_000.0)
    # half a second in which an output may lag, and half a second in which it showed what nobody wants any more
    assert ends_after_s(test, ENTRY_PA) == pytest.approx(1.0, abs=0.07)


def test_an_output_within_the_tolerance_follows(watched: type[Watched]) -> None:
    test = watched()
    test.rules.commanded(50_000.0)
    assert ends_after_s(test, 50_099.0) == math.inf
    assert test.rules.believed


def test_a_sample_of_an_output_that_is_behind_is_not_believed_until_the_device_has_shown_a_lag(
    watched: type[Watched],
) -> None:
    test = watched()
    test.look()
    test.rules.commanded(21_000.0)
    test.look(ENTRY_PA)
    assert not test.rules.believed  # it followed at once until now
    watched.now_s += 0.02
    test.rules.commanded(22_000.0)
    test.look(21_000.0)
    assert test.rules.believed  # one command behind, as the look before


def stepped(test: Watched, shown_behind: int) -> bool:
    """Command 500 Pa more, show the command this many steps behind it; whether that was believed."""
    type(test).now_s += 0.02
    newest_pa = test.asked_pa[-1] + 500.0
    test.asked_pa.append(newest_pa)
    test.rules.commanded(newest_pa)
    test.look(test.asked_pa[-1 - shown_behind])
    return test.rules.believed


def test_a_device_that_shows_two_commands_at_once_again_is_held_to_it(watched: type[Watched]) -> None:
    test = watched()
    assert not stepped(test, 1)
    assert stepped(test, 0)
    assert stepped(test, 1)  # one at once is not enough to take its lag back
    assert [stepped(test, 0) for _ in range(4)] == [True] * 4
    assert not stepped(test, 1)


def test_a_device_that_was_prompt_for_long_costs_three_gaps_when_it_begins_to_lag(watched: type[Watched]) -> None:
    test = watched()
    assert all(stepped(test, 0) for _ in range(40))
    assert [stepped(test, 1) for _ in range(5)] == [False, False, False, True, True]


def test_an_output_that_goes_back_to_a_command_before_the_one_it_showed_is_not_believed(
    watched: type[Watched],
) -> None:
    test = watched()
    for _ in range(4):
        stepped(test, 1)
    assert stepped(test, 3) is False
    assert stepped(test, 1)


def test_the_third_foreign_output_within_two_seconds_ends_it(watched: type[Watched]) -> None:
    test = watched()
    test.rules.commanded(50_000.0)
    watched.now_s += 0.6
    test.rules.commanded(50_000.0)
    for apart_s, ends in ((1.1, False), (0.95, True)):
        faults = []
        for _ in range(3):
            faults.append(test.rules.foreign(80_000.0))
            watched.now_s += apart_s
        assert faults[:2] == [None, None]
        assert (faults[2] is not None) == ends
        watched.now_s += 5.0


def test_what_was_asked_for_within_half_a_second_is_nobody_elses(watched: type[Watched]) -> None:
    test = watched()
    test.rules.commanded(50_000.0)
    watched.now_s += 0.45
    test.rules.commanded(50_000.0)
    assert [test.rules.foreign(output_pa) for output_pa in (20_000.0, 35_000.0, 50_099.0, 19_901.0)] == [None] * 4
    watched.now_s += 0.1
    test.rules.commanded(50_000.0)
    assert [test.rules.foreign(20_000.0) is None for _ in range(3)] == [True, True, False]


@pytest.mark.parametrize(
    ("shown", "reason"),
    [
        ({"status": 0}, "no longer in manual"),
        ({"status": MANUAL | 1 << StatusBit.INTERLOCK}, "interlock"),
        ({"status": MANUAL | 1 << StatusBit.SUPPLY_LOW}, "air supply"),
        ({"supply_pa": 139_999.0}, "air supply"),
        ({"supply_pa": 200_001.0}, "air supply"),
        ({"supply_pa": math.nan}, "air supply"),
    ],
)
def test_a_permissive_that_is_lost_for_two_looks_within_a_second_ends_it(
    watched: type[Watched], shown: dict[str, float], reason: str
) -> None:
    test = watched()
    test.rules.begin(test.sample(), watch=test.watch)
    assert test.look(**shown) is None
    watched.now_s += 1.01
    assert test.look(**shown) is None
    assert test.look() is None
    assert reason in str(test.look(**shown))


@pytest.mark.parametrize(("waived", "permitted"), [("bench test", False), ("", True)])
def test_a_waived_or_permitted_manual_mode_is_not_watched(waived: str, permitted: bool) -> None:
    wiring = replace(WIRING, permissives=PermissiveRules(manual_waived=waived))
    device = connect_valve(wiring, {"bus": Transport(TcpAddress("bus", "127.0.0.1", 1))})
    watch = PermissiveWatch(device, permitted=permitted)
    automatic = Sample(0.0, 0.0, 0.05, ENTRY_PA, ENTRY_PA, 0)
    assert [watch.judge(automatic) for _ in range(3)] == [None] * 3


@pytest.mark.parametrize("invalid", [{"position_m": math.nan}, {"pressure_pa": math.nan, "position_m": math.nan}])
def test_samples_that_are_beyond_a_limit_and_invalid_in_turns_end_it_as_soon_as_those_that_are_not_in_turns(
    watched: type[Watched], invalid: dict[str, float]
) -> None:
    test = watched(position_m=(0.02, 0.09))
    ends = []
    for look in range(400):
        watched.now_s += 0.02
        ends.append(test.look(**(invalid if look % 2 else {"position_m": 0.12})))
        if ends[-1] is not None:
            break
    assert "position 0.12 m is outside" in str(ends[-1])
    assert len(ends) <= 4


@pytest.mark.parametrize("period_s", [0.02, 1.0])
@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"position_m": 0.16}, "where no stem can be"),
        ({"position_m": 0.14}, "limits.band_m"),
        ({"pressure_pa": 2.0 * SPAN_PA}, "is outside"),
        ({"status": 0}, "no longer in manual"),
        ({"supply_pa": math.nan}, "air supply"),
    ],
)
@pytest.mark.parametrize("between", [{}, {"position_m": math.nan}, None])
def test_no_rule_is_reset_by_what_comes_between(
    watched: type[Watched], bad: dict[str, float], said: str, between: dict[str, float] | None, period_s: float
) -> None:
    test = watched(period_s)
    wiring = replace(
        test.device.wiring,
        limits=replace(LIMITS, band_m=0.03 if said == "limits.band_m" else None),
        permissives=PermissiveRules(supply_pa=(140_000.0, 200_000.0), position_m=(0.0, 0.15)),
    )
    device = connect_valve(wiring, {"bus": Transport(TcpAddress("bus", "127.0.0.1", 1))})
    rules = AbortRules(device, wiring.limits, 1000.0, period_s)
    rules.begin(test.sample(), watch=PermissiveWatch(device, permitted=False, within_s=window_s(period_s)))
    fault: Fault = None
    for look in range(6):
        watched.now_s += period_s
        if look % 2 == 0:
            fault = rules.fault(test.sample(**bad))  # type: ignore[arg-type]  # status is an integer
        elif between is None:
            rules.missed(NoAnswerError("no answer"))
            fault = rules.fault(None)
        else:
            fault = rules.fault(test.sample(**between))  # type: ignore[arg-type]
        if fault is not None:
            break
    assert said in str(fault)
