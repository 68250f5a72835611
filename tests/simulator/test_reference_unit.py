from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.registers import Table
from simulator.faults import Fault, FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Happening
from simulator.recorded import recorded
from simulator.reference_unit import ReferenceUnit
from simulator.sensor import Sensor
from simulator.transducer import Transducer
from simulator.unit import Refusal
from tests.support.rough_valves import rough_valve
from tests.support.simulated_plants import (
    ABORT,
    CAPTURE,
    CAPTURE_STATE,
    CLAIM,
    CORNERS,
    INDEX,
    LIVE,
    LIVE_WORDS,
    POSITION_SPAN_M,
    PREPARE,
    PRESSURE_SPAN_PA,
    RANGE_PA,
    RELEASE,
    RUN_NUMBER,
    RUN_OWNER,
    SAFE,
    START,
    TAKEN,
    WATCHDOG,
    WATCHDOG_STATE,
    WINDOW,
    WINDOW_WORDS,
    capture_words,
    claim_words,
    corner_words,
    crc,
    f32,
    floats,
    from_codes,
    number,
    reference,
    u32,
    valve,
    watchdog_words,
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
        self._heartbeat = 0

    def read(self, address: int, count: int) -> list[int]:
        return self.unit.read(Table.HOLDING, address, count, self.at_s)

    def write(self, address: int, words: list[int]) -> None:
        self.unit.write(address, words, self.at_s)

    def own(self, run: int = RUN) -> None:
        self.write(CLAIM, claim_words(run))

    def release(self, run: int = RUN) -> None:
        self.write(CLAIM, claim_words(run, RELEASE))

    def watch(self, timeout_ms: int, *, safe_pa: float = 0.0, run: int = RUN, beat: bool = True) -> None:
        self._heartbeat += beat
        self.write(WATCHDOG, watchdog_words(run, timeout_ms, self._heartbeat, safe_pa))

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
        self.control(START, words, round(period_s * 1e6), wanted)

    def control(self, control: int, corners: list[int] = [], period_us: int = 1000, wanted: int = 1) -> None:  # noqa: B006 - read only
        self.write(CAPTURE, capture_words(self.owner, control, corners, period_us, wanted))

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


def test_a_rough_valve_is_captured_over_the_wire_as_it_is_recorded_without_one() -> None:
    settings = replace(rough_valve("nominal", "usual", 3), start_pa=0.0)
    waveform = triangle(4.0, 1, *RANGE_PA)
    recording, _ = recorded(settings, waveform, 0.001)
    device = Device(settings)
    device.at_s = 1.0
    device.own()
    device.start_capture(waveform, 0.001, 4001)
    for device.at_s in (1.7, 2.4, 4.9, 5.0):
        device.live()
    rows = device.samples(4001)
    assert settings.pressure is not None
    assert recording.pressure_pa is not None
    # the white noise of a capture has other numbers; the rest is the same to a step of a word and of the converter
    sensors = ((0, settings.position, recording.position_m), (1, settings.pressure, recording.pressure_pa))
    for column, sensor, expected in sensors:
        errors = from_codes(rows[:, column], sensor.span) - expected
        spread = math.sqrt(2.0 * sensor.noise_rms**2 + sensor.resolution**2 / 3.0)
        assert np.std(errors) < 1.5 * spread
        assert np.abs(errors).max() < 8.0 * spread
        assert np.std(expected) > 100.0 * spread


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


RISE = corner_words([0.0, 2.0, 4.0], [0.0, 8.0e4, 0.0])


@pytest.mark.parametrize(
    ("table", "corners", "period_us", "wanted"),
    [
        (RISE, [], 1000, 11),
        (RISE, RISE[:4], 1000, 11),
        (RISE, [*RISE[:-1], 1], 1000, 11),  # the table is not what the block vouches for
        ([0] * 4096, [0] * 4100, 1000, 11),
        (corner_words([0.1, 1.0], [0.0, 1.0]), None, 1000, 11),
        (corner_words([0.0, 3.0, 2.0], [0.0, 1.0, 2.0]), None, 1000, 11),
        (corner_words([0.0, 2.0], [0.0, 9.0e4]), None, 1000, 11),
        (corner_words([0.0, 2.0], [0.0, math.nan]), None, 1000, 11),
        (RISE, None, 0, 11),
        (RISE, None, 1000, 0),
        (RISE, None, 1000, 400_001),
    ],
)
def test_a_capture_that_cannot_be_is_refused_and_nothing_moves(
    table: list[int], corners: list[int] | None, period_us: int, wanted: int
) -> None:
    device = Device()
    device.own()
    for first in range(0, len(table), 120):
        device.write(CORNERS + first, table[first : first + 120])
    at_rest = device.live()
    with pytest.raises(Refusal) as refused:
        device.control(START, table if corners is None else corners, period_us, wanted)
    assert refused.value.code == 3
    device.at_s = 20.0
    assert device.live() == at_rest
    assert device.read(CAPTURE_STATE, 1) == [0]


def test_a_second_start_while_a_capture_runs_is_refused() -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 401)
    device.at_s = 1.0
    for control in (START, PREPARE):
        with pytest.raises(Refusal):
            device.control(control, RISE, 10_000, 401)
    device.at_s = 4.0
    assert number(device.read(TAKEN, 2)) == 401


def test_preparing_a_capture_forgets_the_samples_of_the_one_before() -> None:
    device = Device()
    device.own()
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 401)
    device.at_s = 5.0
    device.control(PREPARE, RISE)
    assert device.read(CAPTURE_STATE, 1) == [0]
    assert number(device.read(TAKEN, 2)) == 0
    assert (device.samples(401) == 0xFFFF).all()
    assert device.read(CAPTURE, 9) == capture_words(RUN, PREPARE, RISE, 1000, 1)


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
    device.control(ABORT)
    device.at_s = 9.0
    assert device.live()[2] == pytest.approx(RANGE_PA[1] / 2, abs=1.0)


def test_a_command_without_the_owners_number_is_acknowledged_and_does_nothing() -> None:
    device = Device()
    for run in (0, 5):
        device.command(4.0e4, run)  # nobody owns it
    device.own(6)
    device.command(4.0e4, 5)
    device.at_s = 1.0
    assert device.live()[1:3] == pytest.approx([0.0, 0.0], abs=2.0)
    device.command(4.0e4, 6)
    assert device.live()[2] == pytest.approx(4.0e4, abs=1.0)
    assert device.happenings.count(Happening.FENCED) == 3
    assert device.happenings.count(Happening.COMMANDED) == 1


def test_a_device_is_taken_only_when_it_is_free() -> None:
    device = Device()
    device.own(0)
    device.own(5)
    device.own(6)
    assert device.owner == 5
    device.release(6)
    assert device.owner == 5
    device.release(5)
    assert device.owner == 0
    device.own(6)
    assert device.owner == 6
    device.start_capture(triangle(4.0, 1, *RANGE_PA), 0.01, 401)
    device.release(6)
    assert device.owner == 6  # not while a capture runs
    device.at_s = 4.0
    device.release(6)
    assert device.owner == 0


def test_a_release_switches_the_watchdog_off() -> None:
    device = Device()
    device.own()
    device.watch(1000)
    device.release()
    device.at_s = 100.0
    assert device.read(WATCHDOG_STATE, 1) == [0]
    assert Happening.WATCHDOG_TRIPPED not in device.happenings


def test_a_silent_master_lets_the_watchdog_drive_the_safe_value_at_its_own_time() -> None:
    device = Device()
    device.own()
    device.watch(1500, safe_pa=2.0e4)
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


def test_the_watchdog_counts_the_masters_seconds_however_fast_the_valves_clock_runs() -> None:
    software = SoftwareValve(valve())
    unit = ReferenceUnit(1, software, speed=10.0)
    unit.write(CLAIM, claim_words(RUN), 0.0)
    unit.write(WATCHDOG, watchdog_words(RUN, 2000, 1), 0.0)
    assert unit.read(Table.HOLDING, WATCHDOG_STATE, 1, 19.9) == [1]
    assert unit.read(Table.HOLDING, WATCHDOG_STATE, 1, 20.1) == [2]


def test_a_capture_shows_the_safe_value_from_the_trip_on() -> None:
    """The corner table would have gone on; the trajectory of the valve itself is judged, sample by sample."""
    device, watched = Device(), Device()
    for each in (device, watched):
        each.own()
        each.watch(2000)
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
    device.watch(1000)
    for step in range(1, 10):
        device.at_s = 0.9 * step
        if step % 2:
            device.watch(1000)
        else:
            device.command(1.0e4)
    assert device.read(WATCHDOG_STATE, 1) == [1]
    device.at_s = 8.1 + 0.6
    device.watch(1000, beat=False)  # as it was
    device.command(3.0e4, RUN + 1)  # fenced
    device.at_s = 8.1 + 1.001
    device.watch(1000)
    assert device.read(WATCHDOG_STATE, 1) == [2]


def test_a_tripped_watchdog_stays_tripped_until_a_new_owner_sets_it() -> None:
    device = Device()
    device.own()
    device.watch(1000)
    device.at_s = 2.0
    device.watch(1000)
    assert device.read(WATCHDOG_STATE, 1) == [2]
    device.own(RUN + 1)
    device.watch(1000, run=RUN + 1)
    assert device.read(WATCHDOG_STATE, 1) == [1]
    device.watch(0, run=RUN + 1)
    device.at_s = 100.0
    assert device.read(WATCHDOG_STATE, 1) == [0]


def test_a_watchdog_acts_also_when_the_position_is_read_through_another_device() -> None:
    first, second = SoftwareValve(valve("A")), SoftwareValve(valve("B"))
    commander = ReferenceUnit(1, first)
    reader = ReferenceUnit(2, second, position=first)
    commander.write(CLAIM, claim_words(RUN), 0.0)
    commander.write(WATCHDOG, watchdog_words(RUN, 1000, 1), 0.0)
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
    for address, words in ((RUN_NUMBER, u32(RUN) + f32(wrong)), (WATCHDOG, watchdog_words(RUN, 9, 9, wrong))):
        with pytest.raises(Refusal) as refused:
            device.write(address, words)
        assert refused.value.code == 3
    assert floats(device.read(SAFE, 2)) == [0.0]
    assert Happening.COMMANDED not in device.happenings


@pytest.mark.parametrize(
    ("address", "words"),
    [
        (0, [1, 2]),
        (6, [0]),
        (18, [0, 0]),
        (32, [1]),
        (34, f32(4.0e4)),  # a command without a run
        (35, [1, 2]),
        (36, [0, 7]),
        (40, [0, 7]),
        (46, [0]),  # a watchdog's timeout without a run
        (50, [0]),
        (54, [2]),
        (4096 + 1000, [1]),
    ],
)
def test_a_write_that_is_no_whole_block_is_refused_with_exception_2(address: int, words: list[int]) -> None:
    with pytest.raises(Refusal) as refused:
        Device().write(address, words)
    assert refused.value.code == 2


@pytest.mark.parametrize(
    ("address", "count"), [(6, 1), (14, 4), (39, 1), (81, 2), (999, 2), (5096, 1), (7999, 2), (8122, 2)]
)
def test_an_address_without_a_register_is_refused_with_exception_2(address: int, count: int) -> None:
    with pytest.raises(Refusal) as refused:
        Device().read(address, count)
    assert refused.value.code == 2
    with pytest.raises(Refusal):
        Device().unit.read(Table.INPUT, 0, 1, 0.0)


def test_a_restart_counts_up_and_forgets_owner_watchdog_capture_and_output() -> None:
    device = Device()
    device.own()
    device.watch(5000)
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
    device.release()
    device.at_s = 2.5
    assert device.owner == RUN
    assert device.live()[2] == 0.0
    device.command(4.0e4)
    assert device.live()[2] == pytest.approx(4.0e4, abs=1.0)


STALE = {  # writes of run 1 that a device which was frozen carries out late
    "command": (RUN_NUMBER, u32(1) + f32(7.0e4)),
    "take": (CLAIM, claim_words(1)),
    "release": (CLAIM, claim_words(1, RELEASE)),
    "watchdog off": (WATCHDOG, watchdog_words(1, 0, 7)),
    "watchdog slower and elsewhere": (WATCHDOG, watchdog_words(1, 60_000, 8, 8.0e4)),
    "heartbeat": (WATCHDOG, watchdog_words(1, 2000, 9, 1.0e4)),
    "prepare": (CAPTURE, capture_words(1, PREPARE, RISE, 2000, 5)),
    "start": (CAPTURE, capture_words(1, START, RISE, 1000, 11)),
    "abort": (CAPTURE, capture_words(1, ABORT, RISE, 1000, 11)),
    "nobody's release": (CLAIM, claim_words(0, RELEASE)),
    "nobody's command": (RUN_NUMBER, u32(0) + f32(7.0e4)),
}


@pytest.mark.parametrize("stale", STALE)
@pytest.mark.parametrize("capturing", [False, True])
def test_a_late_write_of_a_run_that_has_ended_changes_nothing_for_the_next(stale: str, capturing: bool) -> None:
    devices = Device(), Device()
    address, words = STALE[stale]
    for device in devices:
        device.own(1)
        device.release(1)
        device.own(2)
        device.watch(2000, safe_pa=1.0e4, run=2)
        device.write(CORNERS, RISE)
        if capturing:
            device.write(CAPTURE, capture_words(2, START, RISE, 1000, 4001))
        else:
            device.command(3.0e4, 2)
        device.at_s = 1.0
    disturbed, undisturbed = devices
    disturbed.write(address, words)
    assert disturbed.happenings[-1] is Happening.FENCED
    for at_s in (1.0, 1.5, 1.99, 2.01, 8.0):  # the watchdog trips at 2 s in both
        for device in devices:
            device.at_s = at_s
        assert disturbed.read(0, 6) == undisturbed.read(0, 6)
        assert disturbed.live() == undisturbed.live()
        for first, count in ((32, 7), (RUN_OWNER, 2), (WATCHDOG, 7), (CAPTURE, 15), (INDEX, 2)):
            assert disturbed.read(first, count) == undisturbed.read(first, count)
    assert disturbed.read(WATCHDOG_STATE, 1) == [2]
    if capturing:
        assert (disturbed.samples(4001) == undisturbed.samples(4001)).all()


def test_corners_that_come_late_stop_the_next_start_and_touch_no_running_capture() -> None:
    device = Device()
    device.own(2)
    device.write(CORNERS, RISE)
    late = corner_words([0.0, 1.0], [8.0e4, 0.0])
    device.write(CORNERS, late)
    with pytest.raises(Refusal):
        device.write(CAPTURE, capture_words(2, START, RISE, 1000, 4001))
    device.write(CORNERS, RISE)
    device.write(CAPTURE, capture_words(2, START, RISE, 1000, 4001))
    device.at_s = 1.0
    device.write(CORNERS, late)
    device.at_s = 3.0
    assert device.live()[2] == pytest.approx(4.0e4, abs=1.0)
