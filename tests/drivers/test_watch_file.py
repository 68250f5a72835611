"""What is kept of a valve in service: which windows, in which file, and what a crash leaves of it."""

from __future__ import annotations

from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
import structlog

from drivers.motion.moved_windows import LEAD_S, TAIL_S, FloatArray, MovedWindows
from drivers.motion.watch_file import WatchFileWriter, day_of, days_in, folder_of, read_watch_file
from drivers.motion.watch_keeper import WatchedValve, WatchKeeper
from drivers.watch_rules import WatchRules
from valve.errors import ConfigurationError, RecordingError

DAY = date(2026, 11, 21)
PERIOD_S = 0.1
NOISE_M = 2.0e-5


def rows(count: int, first_s: float = 0.0, position_m: float | FloatArray = 0.05, seed: int = 1) -> FloatArray:
    noise_m = NOISE_M * np.random.default_rng(seed).standard_normal(count)
    time_s = first_s + PERIOD_S * np.arange(count)
    return np.column_stack((time_s, position_m + noise_m, np.full(count, 4.0e4), np.full(count, 4.1e4)))


def in_blocks(whole: FloatArray, windows: MovedWindows) -> FloatArray:
    return np.concatenate([windows.take(block) for block in np.array_split(whole, len(whole) // 50)])


def test_a_stem_at_rest_is_not_kept_and_noise_is_no_motion() -> None:
    windows = MovedWindows(0.1)
    assert len(in_blocks(rows(36_000), windows)) == 0
    assert windows.moved == 0


@pytest.mark.parametrize("slip_m", [2.0e-4, -2.0e-3])
def test_a_slip_is_kept_with_what_led_to_it_and_what_followed(slip_m: float) -> None:
    at_s = 1803.3
    whole = rows(36_000)
    whole[whole[:, 0] >= at_s, 1] += slip_m
    kept = in_blocks(whole, MovedWindows(0.1))
    assert kept[0, 0] == pytest.approx(at_s - LEAD_S, abs=10.0)
    assert kept[-1, 0] == pytest.approx(at_s + TAIL_S, abs=10.0)
    assert np.allclose(np.diff(kept[:, 0]), PERIOD_S)


def test_a_slow_creep_is_kept_too() -> None:
    whole = rows(36_000)
    whole[:, 1] += 2.0e-6 * whole[:, 0]  # 7 mm an hour
    kept = in_blocks(whole, MovedWindows(0.1))
    assert len(kept) > 0.9 * len(whole)


def test_motions_that_are_near_each_other_make_one_window() -> None:
    whole = rows(36_000)
    for at_s in (1200.0, 1500.0):
        whole[whole[:, 0] >= at_s, 1] += 1.0e-3
    kept = in_blocks(whole, MovedWindows(0.1))
    assert np.allclose(np.diff(kept[:, 0]), PERIOD_S)
    assert np.ptp(kept[:, 0]) == pytest.approx(300.0 + LEAD_S + TAIL_S, abs=15.0)


def written(folder: Path, count: int = 3) -> Path:
    place = day_of(folder, "FV-101", DAY)
    writer = WatchFileWriter(place, {"period_s": PERIOD_S})
    for number in range(count):
        writer.append(rows(50, 5.0 * number))
    unclosed = place.path.read_bytes()  # as a process that is killed leaves it
    writer.close()
    place.path.write_bytes(unclosed)
    return place.path


def test_a_file_that_nobody_closed_is_read_whole(quick_path: Path) -> None:
    header, found = read_watch_file(written(quick_path))
    assert (header["valve"], header["day"], header["period_s"]) == ("FV-101", "2026-11-21", PERIOD_S)
    assert np.allclose(found, np.concatenate([rows(50, 5.0 * number) for number in range(3)]), rtol=1.0e-6)


@pytest.mark.parametrize("cut", [1, 11, 600])
def test_a_torn_end_is_left_out_and_cut_off_by_whoever_goes_on(quick_path: Path, cut: int) -> None:
    path = written(quick_path)
    path.write_bytes(path.read_bytes()[:-cut])
    assert len(read_watch_file(path)[1]) == 100
    again = WatchFileWriter(day_of(quick_path, "FV-101", DAY), {})
    assert again.rows == 100
    again.append(rows(50, 20.0))
    again.close()
    assert read_watch_file(path)[1][:, 0].tolist() == pytest.approx(
        np.concatenate([rows(100)[:, 0], rows(50, 20.0)[:, 0]]).tolist()
    )


def test_a_damaged_block_hides_nothing_of_those_behind_it(quick_path: Path) -> None:
    path = written(quick_path)
    data = bytearray(path.read_bytes())
    data[-1500] ^= 1
    path.write_bytes(bytes(data))
    assert read_watch_file(path)[1][:, 0].tolist() == pytest.approx(
        np.concatenate([rows(50)[:, 0], rows(50, 10.0)[:, 0]]).tolist()
    )


def test_a_file_without_its_header_says_so(quick_path: Path) -> None:
    path = written(quick_path)
    path.write_bytes(b"nothing\n" + path.read_bytes())
    with pytest.raises(RecordingError, match=r"2026-11-21\.watch: it has no header of breakaway/watched/1"):
        read_watch_file(path)


@pytest.mark.parametrize("tag", ["FV-101", "..", "../../etc/passwd", "a/b c", "Ventil Ä 12", "ü" * 64])
def test_every_tag_has_a_folder_of_its_own_below_that_of_all(quick_path: Path, tag: str) -> None:
    place = folder_of(quick_path, tag)
    assert place.parent == quick_path
    assert place.name not in {".", ".."}
    assert place.resolve().parent == quick_path.resolve()
    WatchFileWriter(day_of(quick_path, tag, DAY), {}).close()
    assert [one.day for one in days_in(quick_path, tag)] == [DAY]


async def test_files_are_removed_after_their_days_and_a_full_one_takes_no_more(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rules = WatchRules(PERIOD_S, keep_days=2, zone=ZoneInfo("UTC"))
    for back in range(5):
        WatchFileWriter(day_of(quick_path, "FV-101", DAY - timedelta(days=back)), {}).close()
    monkeypatch.setattr("drivers.motion.watch_keeper.MOST_ROWS", 600)
    keeper = WatchKeeper(quick_path)
    valve = WatchedValve("FV-101", rules, 0.1, "breakaway 0")
    for number in range(20):
        moving = 0.05 + 0.01 * number + np.linspace(0.0, 0.01, 50)
        keeper.take(valve, rules.span_of(DAY), [tuple(row) for row in rows(50, 5.0 * number, moving).tolist()])
    await keeper.close()
    assert [one.day for one in days_in(quick_path, "FV-101")] == [DAY - timedelta(days=2), DAY - timedelta(days=1), DAY]
    assert len(read_watch_file(day_of(quick_path, "FV-101", DAY).path)[1]) == 600
    assert keeper.kept["FV-101"] == 600


async def test_rows_that_the_disk_does_not_take_in_time_are_counted_and_said_once(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.watch_keeper._MOST_WAITING", 1)
    rules = WatchRules(PERIOD_S, zone=ZoneInfo("UTC"))
    keeper, valve = WatchKeeper(quick_path), WatchedValve("FV-101", rules, 0.1, "breakaway 0")
    moving = [tuple(row) for row in rows(50, 0.0, 0.05 + np.linspace(0.0, 0.01, 50)).tolist()]
    with structlog.testing.capture_logs() as said:
        for _ in range(3):  # the event loop hears of none that is written meanwhile
            keeper.take(valve, rules.span_of(DAY), moving)
    await keeper.close()
    assert keeper.dropped == {"FV-101": 100}
    assert sum("not kept" in one["event"] for one in said) == 1


async def test_a_clock_that_goes_years_ahead_removes_no_samples(quick_path: Path) -> None:
    rules = WatchRules(PERIOD_S, keep_days=3, zone=ZoneInfo("UTC"))
    week = [DAY - timedelta(days=back) for back in (2, 1, 0)]
    for day in week:
        WatchFileWriter(day_of(quick_path, "FV-101", day), {}).close()
    keeper, valve = WatchKeeper(quick_path), WatchedValve("FV-101", rules, 0.1, "breakaway 0")
    keeper.take(valve, rules.span_of(date(2036, 1, 1)), [tuple(row) for row in rows(50).tolist()])
    await keeper.close()
    assert [one.day for one in days_in(quick_path, "FV-101")] == week


async def test_yesterday_is_there_to_be_judged_when_today_begins(quick_path: Path) -> None:
    rules = WatchRules(PERIOD_S, keep_days=1, zone=ZoneInfo("UTC"))
    keeper, valve = WatchKeeper(quick_path), WatchedValve("FV-101", rules, 0.1, "breakaway 0")
    for number in range(3):
        moving = rows(50, 86_400.0 * number, 0.05 + np.linspace(0.0, 0.01, 50))
        keeper.take(valve, rules.span_of(DAY + timedelta(days=number)), [tuple(row) for row in moving.tolist()])
    await keeper.close()
    assert [one.day for one in days_in(quick_path, "FV-101")] == [DAY + timedelta(days=1), DAY + timedelta(days=2)]


async def test_a_file_whose_header_is_damaged_is_kept_beside_the_new_one_for_as_long(quick_path: Path) -> None:
    path = written(quick_path)
    damaged = b"nothing" + path.read_bytes()
    rules = WatchRules(PERIOD_S, keep_days=2, zone=ZoneInfo("UTC"))
    valve = WatchedValve("FV-101", rules, 0.1, "breakaway 0")
    moving = [tuple(row) for row in rows(50, 90.0, 0.05 + np.linspace(0.0, 0.01, 50)).tolist()]
    with structlog.testing.capture_logs() as said:
        for _ in range(2):  # as whoever is started again finds it, and again
            path.write_bytes(damaged)
            keeper = WatchKeeper(quick_path)
            for _ in range(3):
                keeper.take(valve, rules.span_of(DAY), moving)
            await keeper.close()
    asides = sorted(path.parent.glob("*.damaged*"))
    assert [one.name for one in asides] == ["2026-11-21.watch.damaged", "2026-11-21.watch.damaged-2"]
    assert [one.read_bytes() for one in asides] == [damaged, damaged]
    assert read_watch_file(path)[1][0, 0] == pytest.approx(90.0)
    assert [one["kept"] for one in said if "damaged" in one["event"]] == [one.name for one in asides]
    keeper = WatchKeeper(quick_path)
    for later in (1, 2, 3):
        keeper.take(valve, rules.span_of(DAY + timedelta(days=later)), moving)
    await keeper.close()
    assert not list(path.parent.glob("2026-11-21*"))


BERLIN = ZoneInfo("Europe/Berlin")


def test_a_night_belongs_to_the_day_on_which_it_begins() -> None:
    rules = WatchRules(0.1, time(22), time(5), zone=BERLIN)
    inside = rules.span_at(datetime(2026, 11, 22, 2, tzinfo=BERLIN))
    assert inside is not None
    assert inside.day == DAY
    assert (inside.begins, inside.ends) == (
        datetime(2026, 11, 21, 21, tzinfo=UTC),
        datetime(2026, 11, 22, 4, tzinfo=UTC),
    )
    assert rules.span_at(inside.ends) is None
    assert rules.span_at(inside.ends - timedelta(seconds=1)) == inside
    assert rules.span_at(inside.begins - timedelta(seconds=1)) is None


def test_the_night_in_which_clocks_change_has_an_hour_more() -> None:
    night = WatchRules(0.1, time(22), time(5), zone=BERLIN).span_of(date(2026, 10, 24))
    assert night.ends - night.begins == timedelta(hours=8)
    whole = WatchRules(0.1, zone=BERLIN).span_of(date(2026, 10, 25))
    assert whole.ends - whole.begins == timedelta(hours=25)
    assert WatchRules(0.1, zone=BERLIN).span_at(whole.ends - timedelta(seconds=1)) == whole


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"period_s": 0.001}, "watch.period_s is 0.001 s, it must be from 0.02 to 10 s"),
        ({"begins": time(22)}, "belong together"),
        ({"begins": time(22), "ends": time(22)}, "are both 22:00"),
        ({"keep_days": 0}, "watch.keep_days is 0, it must be from 1 to 365"),
    ],
)
def test_rules_that_contradict_themselves_are_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigurationError, match=said):
        WatchRules(**{"period_s": 0.1, **wrong})  # type: ignore[arg-type]
