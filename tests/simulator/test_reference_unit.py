from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from drivers.registers import Table
from simulator.faults import Fault, FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Happening
from simulator.reference_unit import ReferenceUnit
from simulator.sensor import Sensor
from simulator.transducer import Transducer
from simulator.unit import Refusal
from tests.simulator.plants import (
    CAPTURE_STATE,
    CONTROL,
    CORNER_COUNT,
    CORNERS,
    HEARTBEAT,
    INDEX,
    LIVE,
    LIVE_WORDS,
    PERIOD,
    POSITION_SPAN_M,
    PRESSURE_SPAN_PA,
    RANGE_PA,
    RUN_NUMBER,
    RUN_OWNER,
    SAFE,
    TAKEN,
    TIMEOUT,
    WANTED,
    WATCHDOG_STATE,
    WINDOW,
    WINDOW_WORDS,
    corner_words,
    crc,
    f32,
    floats,
    from_codes,
    number,
    reference,
    u32,
    valve,
)
from valve.motion import simulate_motion, simulate_waveform
from valve.waveform import Waveform, triangle

RUN = 77
QUANTISED_PA = (RANGE_PA[1] - RANGE_PA[0]) / 65535


class Device:
    """A reference unit with its valve and a master's habits; ``at_s`` is the simulated time of what is next."""

    def __init__(self, settings: object = None) -> None:
        self.valve, self.unit = reference(settings)  # type: ignore[arg-type]  # None means the usual one
        self.at_s = 0.0

    def read(self, address: int, count: int) -> list[int]:
        return self.unit.read(Table.HOLDING, address, count, self.at_s)

    def write(self, address: int, words: list[int]) -> None:
        self.unit.write(address, words, self.at_s)

    def own(self, run: int = RUN) -> None:
        self.write(RUN_OWNER, u32(run))

    def command(self, pressure_pa: float, run: int = RUN) -> None:
        self.write(RUN_NUMBER, u32(run) + f32(pressure_pa))

    @property
    def owner(self) -> int:
        return number(self.read(RUN_OWNER, 2))

    def live(self) -> list[float]:
        """Position, pressure, output and supply."""
        words = self.read(LIVE, LIVE_WORDS)
        assert words[-1] == crc(b"".join(word.to_bytes(2, "big") for word in words[:-1]))
        return floats(words[2:10])

    @property
    def status(self) -> int:
        return self.read(26, 1)[0]

    @property
    def happenings(self) -> list[Happening]:
        return [event.happening for event in self.valve.record.events]

    def start_capture(self, waveform: Waveform, period_s: float, wanted: int) -> None:
        words = corner_words(list(waveform.time_s), list(waveform.pressure_pa))
        for first in range(0, len(words), 120):
            self.write(CORNERS + first, words[first : first + 120])
        self.write(CORNER_COUNT, [waveform.time_s.size])
        self.write(PERIOD, u32(round(period_s * 1e6)) + u32(wanted))
        self.write(CONTROL, [1])

    def samples(self, wanted: int) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        """Every sample of a capture, shape (wanted, 3), through the window and with its CRC checked."""
        rows: list[int] = []
        for index in range(0, wanted, 40):
            self.write(INDEX, u32(index))
            words = self.read(WINDOW, WINDOW_WORDS)
            assert number(words) == index
            assert words[-1] == crc(b"".join(word.to_bytes(2, "big") for word in words[:-1]))
            rows += words[2:-1]
        return np.array(rows).reshape(-1, 3)[:wanted]


def test_identity_tells_a_reference_device_by_its_canary() -> None:
    device = Device()
    assert device.read(0, 6) == [0x4257, 0x4159, 1, 0, 1, 1]


def test_polled_positions_are_those_of_the_exact_motion_of_what_was_commanded() -> None:
    device = Device()
    device.own()
    commands = [(0.5 * i, 8.0e4 * abs(math.sin(0.37 * i))) for i in range(1, 60)]
    polls = [0.013 + 0.041 * i for i in range(700)]
    found = {}
    for device.at_s, pressure_pa in sorted([*commands, *((at_s, -1.0) for at_s in polls)]):
        if pressure_pa < 0.0:
            found[device.at_s] = device.live()
        else:
            device.command(pressure_pa)
    levels_pa = device.valve.settings.transducer.quantised(np.array([p for _, p in commands]))
    corner_s = [0.0, *itertools.chain.from_iterable((t, t) for t, _ in commands), polls[-1] + 1.0]
    corner_pa = [0.0, 0.0, *itertools.chain.from_iterable((p, p) for p in levels_pa)]
    exact = simulate_motion(
        device.valve.settings.parameters, corner_s, 0.06452 * np.array(corner_pa), sorted(found)
    ).position_m
    positions = np.array([found[at_s][0] for at_s in sorted(found)])
    resolution_m = device.valve.settings.position.resolution
    assert np.ptp(positions) > 0.05
    assert np.abs(positions - exact).max() <= resolution_m / 2 + 1.0e-8  # float32 in the register
    asked = [levels_pa[max(i for i, (t, _) in enumerate(commands) if t < at_s)] for at_s in sorted(found) if at_s > 0.5]
    assert [found[at_s][2] for at_s in sorted(found) if at_s > 0.5] == pytest.approx(asked, rel=1e-6)


@pytest.mark.parametrize("looks", [[60.0], [*np.arange(0.0371, 60.0, 0.0893), 60.0]])
def test_captured_samples_are_those_of_the_exact_motion_whenever_somebody_looks(looks: list[float]) -> None:
    device = Device()
    device.at_s = 3.0
    device.own()
    waveform = triangle(20.0, 3, *RANGE_PA)
    device.start_capture(waveform, 0.001, 60_001)
    for look_s in looks:
        device.at_s = 3.0 + look_s
        device.live()
    assert device.read(CAPTURE_STATE, 1) == [2]
    assert number(device.read(TAKEN, 2)) == 60_001
    rows = device.samples(60_001)
    exact = simulate_waveform(device.valve.settings.parameters, waveform, 0.06452, 0.001).position_m
    position_m = from_codes(rows[:, 0], POSITION_SPAN_M)
    assert np.abs(position_m - exact).max() <= device.valve.settings.position.resolution * 0.501
    pressure_pa = waveform.at(np.linspace(0.0, 60.0, 60_001))
    assert np.abs(from_codes(rows[:, 1], PRESSURE_SPAN_PA) - pressure_pa).max() <= 91000 / 65534 * 0.501
    assert np.abs(from_codes(rows[:, 2], RANGE_PA) - pressure_pa).max() <= 82737 / 65534 * 0.501
    assert device.samples(60_040)[60_001:].tolist() == [[0xFFFF] * 3] * 39


def test_a_capture_is_the_same_with_noise_however_often_somebody_looks() -> None:
    settings = valve(position=Sensor(POSITION_SPAN_M, 2.0e-5, seed=5), transducer=Transducer(RANGE_PA, lag_s=0.2))
    found = []
    for looks in ([5.0], [0.3, 0.30001, 1.7, 4.2, 5.0]):
        device = Device(settings)
        device.own()
        device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.002, 2001)
        for device.at_s in looks:
            device.live()
        found.append(device.samples(2001))
    # the lagged pressure's chords begin anew at each look: half a code of the position at most
    assert np.abs(found[0] - found[1]).max() <= 1
    assert np.count_nonzero(found[0] != found[1]) < 200


def test_samples_not_yet_taken_are_missing_and_progress_is_told() -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 401)
    device.at_s = 1.0
    assert device.read(CAPTURE_STATE, 1) == [1]
    assert number(device.read(TAKEN, 2)) == 101
    assert device.status & 1 << 4
    rows = device.samples(120)
    assert (rows[:101] != 0xFFFF).all()
    assert (rows[101:] == 0xFFFF).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda device: device.write(CORNER_COUNT, [0]),
        lambda device: device.write(CORNER_COUNT, [1025]),
        lambda device: device.write(CORNERS, corner_words([0.1], [0.0])),
        lambda device: device.write(CORNERS, corner_words([0.0, 3.0, 2.0], [0.0, 1.0, 2.0])),
        lambda device: device.write(CORNERS + 4, corner_words([2.0], [9.0e4])),
        lambda device: device.write(CORNERS + 4, corner_words([2.0], [math.nan])),
        lambda device: device.write(PERIOD, u32(0)),
        lambda device: device.write(WANTED, u32(0)),
        lambda device: device.write(WANTED, u32(400_001)),
        lambda device: device.write(RUN_OWNER, u32(0)),
    ],
)
def test_a_capture_that_cannot_be_is_refused_and_nothing_moves(change: object) -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 11)
    device.at_s = 10.0
    device.write(CONTROL, [3])
    at_rest = device.live()
    change(device)  # type: ignore[operator]  # a parameter of the test
    with pytest.raises(Refusal) as refused:
        device.write(CONTROL, [1])
    assert refused.value.code == 3
    device.at_s = 20.0
    assert device.live() == at_rest
    assert device.read(CAPTURE_STATE, 1) == [0]


def test_a_command_during_a_capture_aborts_it_and_takes_effect() -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(20.0, 3, *RANGE_PA), 0.001, 60_001)
    device.at_s = 5.0
    device.command(1.0e4)
    assert device.read(CAPTURE_STATE, 1) == [3]
    device.at_s = 30.0
    assert device.live()[1:3] == pytest.approx([1.0e4, 1.0e4], abs=1.0)
    assert number(device.read(TAKEN, 2)) == 5001


def test_an_aborted_capture_holds_the_pressure_of_that_moment() -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(20.0, 3, *RANGE_PA), 0.001, 60_001)
    device.at_s = 5.0
    device.write(CONTROL, [2])
    device.at_s = 9.0
    assert device.live()[2] == pytest.approx(RANGE_PA[1] / 2, abs=1.0)


def test_a_command_without_the_owners_number_is_acknowledged_and_does_nothing() -> None:
    device = Device()
    for run in (0, 5):
        device.command(4.0e4, run)  # nobody owns it
    device.own(6)
    device.command(4.0e4, 5)
    device.write(RUN_NUMBER + 2, f32(4.0e4))  # the number is missing from this write
    device.at_s = 1.0
    assert device.live()[1:3] == pytest.approx([0.0, 0.0], abs=2.0)
    device.command(4.0e4, 6)
    assert device.live()[2] == pytest.approx(4.0e4, abs=1.0)
    assert device.happenings.count(Happening.FENCED) == 4
    assert device.happenings.count(Happening.COMMANDED) == 1


def test_a_device_is_taken_only_when_it_is_free() -> None:
    device = Device()
    device.own(5)
    device.own(6)
    assert device.owner == 5
    device.own(0)
    assert device.owner == 0
    device.own(6)
    assert device.owner == 6
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 401)
    device.own(0)
    assert device.owner == 6  # not while a capture runs
    device.at_s = 4.0
    device.own(0)
    assert device.owner == 0


def test_a_silent_master_lets_the_watchdog_drive_the_safe_value_at_its_own_time() -> None:
    device = Device()
    device.own()
    device.write(SAFE, f32(2.0e4))
    device.write(TIMEOUT, [1500])
    device.at_s = 1.0
    device.command(7.0e4)
    device.at_s = 60.0  # nobody looked in between
    assert device.read(WATCHDOG_STATE, 1) == [2]
    assert device.owner == 0
    assert device.status & 1
    trip = next(event for event in device.valve.record.events if event.happening is Happening.WATCHDOG_TRIPPED)
    assert trip.time_s == pytest.approx(2.5)
    levels = device.valve.settings.transducer.quantised(np.array([7.0e4, 2.0e4])) * 0.06452
    exact = simulate_motion(
        device.valve.settings.parameters,
        [0.0, 1.0, 1.0, 2.5, 2.5, 60.0],
        [0.0, 0.0, levels[0], levels[0], levels[1], levels[1]],
        [60.0],
    ).position_m
    assert device.live()[0] == pytest.approx(exact[0], abs=device.valve.settings.position.resolution)


def test_a_capture_shows_the_safe_value_from_the_trip_on() -> None:
    """The corner table would have gone on; the trajectory of the valve itself is judged, sample by sample."""
    device, watched = Device(), Device()
    for each in (device, watched):
        each.own()
        each.write(TIMEOUT, [2000])
        each.start_capture(triangle(20.0, 1, *RANGE_PA), 0.01, 2001)
    device.at_s = 12.0
    assert device.read(CAPTURE_STATE, 1) == [3]
    assert number(device.read(TAKEN, 2)) == 201
    for watched.at_s in np.arange(0.0, 12.01, 0.1):
        watched.live()
    track = watched.valve.record.track
    assert track.asked_pa[track.time_s < 1.95] == pytest.approx(8273.7 * track.time_s[track.time_s < 1.95], abs=1.0)
    assert (track.asked_pa[track.time_s > 2.05] == 0.0).all()
    assert device.live()[0] == watched.live()[0]


def test_a_command_or_a_changed_heartbeat_feeds_the_watchdog_and_a_repeated_one_does_not() -> None:
    device = Device()
    device.own()
    device.write(TIMEOUT, [1000])
    for step in range(1, 10):
        device.at_s = 0.9 * step
        if step % 2:
            device.write(HEARTBEAT, [step])
        else:
            device.command(1.0e4)
    assert device.read(WATCHDOG_STATE, 1) == [1]
    device.at_s = 8.1 + 0.6
    device.write(HEARTBEAT, [9])  # as it was
    device.command(3.0e4, RUN + 1)  # fenced
    device.at_s = 8.1 + 1.001
    device.write(HEARTBEAT, [9])
    assert device.read(WATCHDOG_STATE, 1) == [2]


def test_a_tripped_watchdog_stays_tripped_until_it_is_armed_anew_or_switched_off() -> None:
    device = Device()
    device.write(TIMEOUT, [1000])
    device.at_s = 2.0
    device.write(HEARTBEAT, [1])
    assert device.read(WATCHDOG_STATE, 1) == [2]
    device.write(TIMEOUT, [1000])
    assert device.read(WATCHDOG_STATE, 1) == [1]
    device.write(TIMEOUT, [0])
    device.at_s = 100.0
    assert device.read(WATCHDOG_STATE, 1) == [0]


def test_a_watchdog_acts_also_when_the_position_is_read_through_another_device() -> None:
    first, second = SoftwareValve(valve("A")), SoftwareValve(valve("B"))
    commander = ReferenceUnit(1, first)
    reader = ReferenceUnit(2, second, position=first)
    commander.write(TIMEOUT, [1000], 0.0)
    commander.write(RUN_OWNER, u32(RUN), 0.0)
    commander.write(RUN_NUMBER, u32(RUN) + f32(8.0e4), 0.0)
    reader.read(Table.HOLDING, LIVE, LIVE_WORDS, 0.9)
    assert first.stem.position_m > 0.05
    (position_m,) = floats(reader.read(Table.HOLDING, LIVE + 2, 2, 30.0))
    assert first.asked_pa == 0.0
    assert position_m < 0.03  # F_s/k
    assert math.isnan(floats(commander.read(Table.HOLDING, LIVE + 2, 2, 30.0))[0])  # it has no sensor


@pytest.mark.parametrize("wrong", [-10.0, 82740.0, math.nan, math.inf])
def test_a_pressure_outside_the_transducers_range_is_refused(wrong: float) -> None:
    device = Device()
    device.own()
    for address, words in ((RUN_NUMBER, u32(RUN) + f32(wrong)), (SAFE, f32(wrong))):
        with pytest.raises(Refusal) as refused:
            device.write(address, words)
        assert refused.value.code == 3
    assert floats(device.read(SAFE, 2)) == [0.0]
    assert Happening.COMMANDED not in device.happenings


@pytest.mark.parametrize(
    ("address", "words"), [(0, [1, 2]), (6, [0]), (18, [0, 0]), (32, [1]), (35, [1, 2]), (41, [0]), (4096 + 1000, [1])]
)
def test_a_write_to_what_is_no_writable_whole_register_is_refused_with_exception_2(
    address: int, words: list[int]
) -> None:
    with pytest.raises(Refusal) as refused:
        Device().write(address, words)
    assert refused.value.code == 2


@pytest.mark.parametrize(("address", "count"), [(6, 1), (14, 4), (73, 2), (999, 2), (5096, 1), (7999, 2), (8122, 2)])
def test_an_address_without_a_register_is_refused_with_exception_2(address: int, count: int) -> None:
    with pytest.raises(Refusal) as refused:
        Device().read(address, count)
    assert refused.value.code == 2
    with pytest.raises(Refusal):
        Device().unit.read(Table.INPUT, 0, 1, 0.0)


def test_a_restart_counts_up_and_forgets_owner_watchdog_capture_and_output() -> None:
    device = Device()
    device.own()
    device.write(TIMEOUT, [5000])
    device.start_capture(triangle(20.0, 1, *RANGE_PA), 0.01, 2001)
    device.valve.inject(Fault(FaultKind.RESTART, 3.0))
    device.at_s = 10.0
    assert device.read(5, 1) == [2]
    assert device.owner == 0
    assert device.read(WATCHDOG_STATE, 1) == [0]
    assert device.read(CAPTURE_STATE, 1) == [0]
    assert device.live()[2] == 0.0
    restart = next(event for event in device.valve.record.events if event.happening is Happening.RESTARTED)
    assert restart.time_s == 3.0


def test_an_ignored_write_is_acknowledged_and_changes_nothing() -> None:
    device = Device(valve(faults=(Fault(FaultKind.IGNORED_WRITES, 1.0, 2.0),)))
    device.own()
    device.at_s = 1.5
    device.command(4.0e4)
    device.own(0)
    device.at_s = 2.5
    assert device.owner == RUN
    assert device.live()[2] == 0.0
    device.command(4.0e4)
    assert device.live()[2] == pytest.approx(4.0e4, abs=1.0)
