"""Recording files: what is written is read back bit by bit, and a bad file is one clear sentence."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from valve.errors import RecordingError
from valve.nameplate import Actuator, Nameplate, Signal
from valve.quantisation import find_grid
from valve.recording import CHANNELS, INTERVAL_CHANNELS, Acquisition, FloatArray, Provenance, Recording
from valve.recording_files import file_sha256, read_recording, recording_from_bytes, write_csv, write_parquet

NAMEPLATE = Nameplate(
    "FV-101",
    Actuator(travel_m=0.1016, diaphragm_area_m2=0.06452, bench_set_pa=(0.0, 82737.0)),
    Signal((4.0, 20.0), (0.0, 82737.0)),
)
NAN = float("nan")


def ticks(rows: int, period_s: float) -> FloatArray:
    return np.arange(rows, dtype=np.float64) * np.float64(period_s)


def bits(channel: FloatArray | None) -> npt.NDArray[np.int64] | None:
    return None if channel is None else channel.view(np.int64)


def assert_same(read: Recording, written: Recording) -> None:
    for name in ("time_s", *CHANNELS, *INTERVAL_CHANNELS):
        np.testing.assert_array_equal(bits(getattr(read, name)), bits(getattr(written, name)), err_msg=name)


def converted(values: FloatArray, low: float, high: float) -> FloatArray:
    """Return what a 16-bit converter of this range and ``Register.decode`` make of ``values``."""
    scale = (high - low) / 65534
    raw = np.clip(np.rint((values - low) / scale), 0, 65534)
    return np.asarray(scale * raw + low)


def sixty_seconds(position_noise_m: float = 20.0e-6) -> Recording:
    """60 s of 1 kHz, three channels of 16 bit: command, pressure and position of a triangle test."""
    random = np.random.default_rng(20)
    time_s = ticks(60_000, 0.001)
    share = 1.0 - np.abs((time_s % 20.0) / 10.0 - 1.0)
    low_m, high_m = (float(np.float32(end)) for end in (-0.005, 0.1066))
    return Recording(
        time_s,
        converted(0.1016 * share + random.normal(0.0, position_noise_m, time_s.size), low_m, high_m),
        pressure_pa=converted(82737.0 * share + random.normal(0.0, 5.0, time_s.size), 0.0, 140000.0),
        command_pa=converted(82737.0 * share, 0.0, 82737.0),
        provenance=Provenance(Acquisition.CAPTURED, tag="FV-101", requested_period_s=0.001, notes="20 °C"),
    )


# ---------------------------------------------------------------- round trips

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
cells = st.one_of(st.just(NAN), numbers)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    rows = draw(st.integers(1, 40))
    column = arrays.arrays(np.float64, rows, elements=cells)
    times = draw(arrays.arrays(np.float64, rows, elements=st.floats(-1e9, 1e9), unique=True))
    position_m = draw(column)
    position_m[0] = draw(numbers)
    pressure_pa = draw(column)
    pressure_pa[-1] = draw(numbers)
    return Recording(np.sort(times), position_m, pressure_pa=pressure_pa, command_pa=draw(st.none() | column))


@given(recordings())
@settings(max_examples=60, deadline=None, derandomize=True)
def test_any_recording_comes_back_bit_by_bit_from_csv_and_parquet(
    tmp_path_factory: pytest.TempPathFactory, recording: Recording
) -> None:
    folder = tmp_path_factory.mktemp("round")
    write_csv(recording, folder / "a.csv")
    write_parquet(recording, folder / "a.parquet")
    assert_same(read_recording(folder / "a.parquet"), recording)
    assert_same(read_recording(folder / "a.csv"), recording)


@given(
    steps=st.lists(st.integers(0, 65534) | st.none(), min_size=3, max_size=200),
    low=st.floats(-1e3, 1e3, width=32),
    span=st.floats(0.0078125, 1e5, width=32),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_converter_steps_come_back_bit_by_bit(
    tmp_path_factory: pytest.TempPathFactory, steps: list[int | None], low: float, span: float
) -> None:
    position_m = np.array([NAN if step is None else span / 65534 * step + low for step in steps])
    position_m[0] = low
    recording = Recording(ticks(len(steps), 0.001), position_m, force_n=np.zeros(len(steps)))
    path = tmp_path_factory.mktemp("steps") / "a.parquet"
    write_parquet(recording, path)
    assert_same(read_recording(path), recording)


def test_sixty_seconds_of_three_converter_channels_need_less_than_100_kib(tmp_path: Path) -> None:
    recording = sixty_seconds()
    write_parquet(recording, tmp_path / "a.parquet")
    size = (tmp_path / "a.parquet").stat().st_size
    assert_same(read_recording(tmp_path / "a.parquet"), recording)
    assert size <= 100 * 1024, f"{size / 1024:.0f} KiB"


def test_converter_channels_are_kept_as_integers_with_their_scale(tmp_path: Path) -> None:
    write_parquet(sixty_seconds(), tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    assert {str(field.type) for field in table.schema} == {"int32"}
    metadata = table.schema.metadata[b"breakaway"].decode()
    assert '"unit": "Pa"' in metadata
    assert '"scale": 1.2625' in metadata  # 82737 Pa / 65534


def test_values_that_lie_on_no_grid_are_kept_as_float64(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(size=500)
    write_parquet(Recording(np.arange(500.0), noise, force_n=noise), tmp_path / "a.parquet")
    assert str(pq.read_schema(tmp_path / "a.parquet").field("position_m").type) == "double"


def test_minus_zero_is_not_lost() -> None:
    assert find_grid(np.array([0.0, -0.0, 1.0])) is None


def test_provenance_and_exchange_times_come_back(tmp_path: Path) -> None:
    provenance = Provenance(
        Acquisition.POLLED, "FV-1", "triangle", "2026-11-21T02:00:00+01:00", "breakaway 0.1.0", "x", 0.01, 0.002, "ä"
    )
    time_s = ticks(5, 0.01)
    written_s = np.where(np.arange(5) == 2, np.nan, time_s - 0.002)
    written = Recording(
        time_s,
        time_s,
        force_n=time_s,
        sent_s=time_s - 0.001,
        received_s=time_s + 0.001,
        write_sent_s=written_s - 0.0005,
        written_s=written_s,
        provenance=provenance,
    )
    write_parquet(written, tmp_path / "a.parquet")
    read = read_recording(tmp_path / "a.parquet")
    assert read.provenance == provenance
    assert_same(read, written)
    assert read.gaps == 0
    write_csv(written, tmp_path / "a.csv")
    read = read_recording(tmp_path / "a.csv")
    assert_same(read, written)
    assert read.provenance == Provenance(Acquisition.POLLED)  # the times of the writes say so


def test_a_csv_without_the_times_of_writes_does_not_say_how_it_was_taken(tmp_path: Path) -> None:
    time_s = ticks(5, 0.01)
    write_csv(Recording(time_s, time_s, force_n=time_s, sent_s=time_s, received_s=time_s + 0.001), tmp_path / "a.csv")
    assert read_recording(tmp_path / "a.csv").provenance == Provenance()


def test_reading_parquet_loads_no_library_while_a_valve_moves(tmp_path: Path) -> None:
    write_parquet(sixty_seconds(), tmp_path / "a.parquet")
    reads = "import sys, pathlib; from valve.recording_files import read_recording; before = set(sys.modules); "
    reads += "read_recording(pathlib.Path(sys.argv[1])); "
    reads += "print([name for name in set(sys.modules) - before if name.startswith('pyarrow')])"
    done = subprocess.run(
        [sys.executable, "-c", reads, str(tmp_path / "a.parquet")], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_write_parquet_returns_the_sha256_of_the_file(tmp_path: Path) -> None:
    digest = write_parquet(sixty_seconds(), tmp_path / "a.parquet")
    assert digest == hashlib.sha256((tmp_path / "a.parquet").read_bytes()).hexdigest()
    assert digest == file_sha256(tmp_path / "a.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["a.parquet"]


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "a.parquet").mkdir()
    (tmp_path / "a.parquet" / "kept").write_text("x")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_parquet(sixty_seconds(), tmp_path / "a.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["a.parquet"]


def test_sixty_thousand_rows_of_csv_are_read_in_well_below_a_tenth_of_a_second(tmp_path: Path) -> None:
    write_csv(sixty_seconds(), tmp_path / "a.csv")
    taken_s = []
    for _ in range(7):
        start_s = time.process_time()
        read_recording(tmp_path / "a.csv", NAMEPLATE)
        taken_s.append(time.process_time() - start_s)
    assert min(taken_s) < 0.1


# ---------------------------------------------------------------- what is accepted

GOOD = "time_s,command_pa,position_m\n0,0,0\n0.1,5e4,0.05\n0.2,,nan\n"


@pytest.mark.parametrize(
    "text",
    [
        GOOD,
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n"),
        GOOD.rstrip("\n"),
        '"time_s","command_pa","position_m"\n0,0,0\n0.1,5e4,0.05\n0.2,,nan\n',
        "position_m, time_s ,command_pa\n 0,0,0\n0.05, 0.1 ,5e4\nNaN,0.2,\n",
        "\n" + GOOD.replace("\n0.1", "\n\n0.1"),
    ],
)
def test_a_good_file_is_read_however_it_was_saved(text: str) -> None:
    recording = recording_from_bytes(text.encode(), "a.csv")
    assert recording.command_pa is not None
    np.testing.assert_array_equal(recording.time_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(recording.command_pa, [0.0, 5.0e4, NAN])
    np.testing.assert_array_equal(recording.position_m, [0.0, 0.05, NAN])


def test_a_command_in_milliamperes_becomes_pressure_by_the_nameplate() -> None:
    data = b"time_s,command_ma,position_m\n0,4,0\n1,12,0.05\n2,,0.1\n"
    command_pa = recording_from_bytes(data, "a.csv", NAMEPLATE).command_pa
    assert command_pa is not None
    np.testing.assert_allclose(command_pa, [0.0, 41368.5, NAN])


def test_a_parquet_file_of_others_is_read_and_a_wrong_suffix_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    columns = {"time_s": [0, 1], "position_m": pa.array([0.5, None], pa.float32()), "force_n": [1.0, 2.0]}
    pq.write_table(pa.table(columns), path)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.position_m, [0.5, NAN])
    assert recording.provenance == Provenance()


# ---------------------------------------------------------------- what is refused

HEADER = "time_s,command_pa,position_m\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        (" \n\n", "the file is empty"),
        (HEADER, "a header and no row"),
        (HEADER + "\n \n", "a header and no row"),
        ("time_s,pressure_psi,position_m\n0,1,2\n", "unknown column 'pressure_psi'; there are time_s"),
        ("time_s,command_pa\n0,1\n", "column position_m is missing"),
        ("position_m,command_pa\n0,1\n", "column time_s is missing"),
        ("time_s,position_m\n0,1\n", "none of the columns command_pa, command_ma"),
        ("time_s,command_pa,position_m,time_s\n0,1,2,3\n", "column 'time_s' stands in it twice"),
        ("time_s,command_pa,command_ma,position_m\n0,1,2,3\n", "both there, remove one"),
        ("0,1,2\n1,2,3\n", "row 1 holds numbers, it must be a header"),
        ("time_s;command_pa;position_m\n0;1;2\n", "stand between semicolons"),
        ("time_s;command_pa;position_m\n", "a header line and no rows: export a time that has values"),
        ("time_s\tcommand_pa\tposition_m\n0\t1\t2\n", "stand between tabs"),
        (HEADER + "0,1,2\n1,abc,3\n", r"row 2 \(line 3 of the file\), column command_pa: 'abc' is not a number"),
        (HEADER + '0,1,2\n1,"2,5",3\n', r"row 2 .*column command_pa: '2,5' is not a number: .*decimal point"),
        (HEADER + "0,1,2\n0,1,5,3,0,4\n", r"row 2 .* has 6 cells and the header has 3: .*decimal point"),
        (HEADER + "0,1,2\n1,2\n", r"row 2 .* has 2 cells and the header has 3"),
        (HEADER + "0,1,2\n1,2,3\n0.5,2,3\n", r"row 3, column time_s: time goes from 1.0 to 0.5 s, it must increase"),
        (HEADER + "0,1,2\n0,2,3\n", r"row 2, column time_s: time goes from 0.0 to 0.0 s"),
        (HEADER + "0,1,2\n,2,3\n", "row 2, column time_s: it is missing"),
        (HEADER + "0,1,inf\n", "row 1, column position_m: it is infinite"),
        (HEADER + "0,1,1e999\n", "row 1, column position_m: it is infinite"),
        (HEADER + "0,1,\n1,1,nan\n", "column position_m holds no value"),
        ("time_s,command_ma,position_m\n0,4,0\n", "in mA and no nameplate is given"),
    ],
)
def test_a_bad_csv_file_is_one_sentence(text: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says) as caught:
        recording_from_bytes(text.encode(), "bad.csv")
    message = str(caught.value)
    assert message.startswith("bad.csv: ")
    assert "\n" not in message
    assert len(message) < 300


def test_bytes_that_are_no_text_are_refused() -> None:
    with pytest.raises(RecordingError, match="no text in UTF-8"):
        recording_from_bytes(bytes(range(128, 256)) * 4, "bad.csv")
    with pytest.raises(RecordingError, match="unknown column"):
        recording_from_bytes(b"\x00" * 64, "bad.csv")
    with pytest.raises(RecordingError, match=r"row 2 .*is not a number"):
        recording_from_bytes(HEADER.encode() + b"0,1,2\n1,\xff,3\n", "bad.csv")


@pytest.mark.parametrize("content", [b"PAR1", b"PAR1" + b"\x00" * 200, b"PAR1....PAR1"])
def test_a_damaged_parquet_file_is_one_sentence(content: bytes) -> None:
    with pytest.raises(RecordingError, match="cannot be read as a Parquet file"):
        recording_from_bytes(content, "bad.parquet")


def test_every_truncation_of_a_parquet_file_is_refused(tmp_path: Path) -> None:
    write_parquet(Recording(np.arange(5.0), np.ones(5), force_n=np.ones(5)), tmp_path / "a.parquet")
    data = (tmp_path / "a.parquet").read_bytes()
    for length in range(4, len(data), 17):
        with pytest.raises(RecordingError):
            recording_from_bytes(data[:length], "cut.parquet", says_parquet=True)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"time_s": [0.0], "position_m": [1.0], "valve": [1.0]}, "unknown column 'valve'"),
        ({"time_s": [0.0], "force_n": [1.0]}, "column position_m is missing"),
        ({"time_s": ["a"], "position_m": [1.0], "force_n": [1.0]}, "column time_s holds string"),
        ({"time_s": pa.array([], pa.float64()), "position_m": pa.array([], pa.float64())}, "columns and no row"),
        ({"time_s": [1.0, 0.0], "position_m": [1.0, 2.0], "force_n": [1.0, 2.0]}, "row 2, column time_s"),
    ],
)
def test_a_parquet_file_with_wrong_columns_is_one_sentence(
    tmp_path: Path, columns: dict[str, object], says: str
) -> None:
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(RecordingError, match=says):
        read_recording(tmp_path / "a.parquet")


def test_a_file_that_cannot_be_opened_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text.parquet").write_text(GOOD)
    for path, says in (
        (tmp_path, "it is a folder"),
        (tmp_path / "none.csv", "no such file"),
        (tmp_path / "text.parquet", "does not start as a Parquet file"),
        (Path("a\0b"), "cannot be read"),
    ):
        with pytest.raises(RecordingError, match=says):
            read_recording(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        file_sha256(tmp_path / "none.csv")


# ---------------------------------------------------------------- wrong units


def csv_of(position: FloatArray, pressure: FloatArray, name: str = "pressure_pa") -> bytes:
    rows = [f"{n},{a},{b}" for n, (a, b) in enumerate(zip(pressure, position, strict=True))]
    return "\n".join([f"time_s,{name},position_m", *rows]).encode()


UP_AND_DOWN = np.concatenate([np.linspace(0, 1, 20), np.linspace(1, 0, 20)])


@pytest.mark.parametrize(
    ("position_factor", "pressure_factor", "says"),
    [
        (98.0, 8.0e4, "looks like millimetres or percent of travel"),
        (4.0, 8.0e4, "looks like inches"),
        (98000.0, 8.0e4, "looks like micrometres"),
        (0.098, 80.0, "looks like kPa"),
        (0.098, 0.8, "looks like bar"),
        (0.098, 11.6, r"looks like (kPa or )?(bar or )?psi"),
        (0.098, 8.0e6, "write it in Pa, or correct the nameplate"),
    ],
)
def test_values_in_other_units_are_refused_where_the_nameplate_shows_it(
    position_factor: float, pressure_factor: float, says: str
) -> None:
    data = csv_of(position_factor * UP_AND_DOWN, pressure_factor * UP_AND_DOWN)
    with pytest.raises(RecordingError, match=says):
        recording_from_bytes(data, "a.csv", NAMEPLATE)


def test_position_and_pressure_in_each_others_column_are_called_swapped() -> None:
    with pytest.raises(RecordingError, match=r"a\.csv: position_m reaches 8e\+04, .* the two channels are swapped"):
        recording_from_bytes(csv_of(8.0e4 * UP_AND_DOWN, 0.098 * UP_AND_DOWN), "a.csv", NAMEPLATE)


@pytest.mark.parametrize(("unit", "pascal"), [("psi", 6894.757), ("bar", 1.0e5), ("kPa", 1.0e3)])
def test_the_command_tells_a_pressures_unit_where_the_nameplate_has_no_range(unit: str, pascal: float) -> None:
    bare = replace(NAMEPLATE, actuator=Actuator(travel_m=0.1016, diaphragm_area_m2=0.06452), signal=None)
    command_pa = 8.0e4 * UP_AND_DOWN
    rows = [
        f"{n},{command},{command / pascal},{position}"
        for n, (command, position) in enumerate(zip(command_pa, 0.098 * UP_AND_DOWN, strict=True))
    ]
    data = "\n".join(["time_s,command_pa,pressure_pa,position_m", *rows]).encode()
    with pytest.raises(RecordingError, match=f"the stem moves: it looks like {unit}: write it in Pa"):
        recording_from_bytes(data, "a.csv", bare)


@pytest.mark.parametrize(("factor", "says"), [(100.0, "percent or a pressure"), (0.02, "looks like amperes")])
def test_a_command_that_is_no_current_in_milliamperes_is_refused(factor: float, says: str) -> None:
    data = csv_of(0.098 * UP_AND_DOWN, factor * UP_AND_DOWN, "command_ma")
    with pytest.raises(RecordingError, match=says):
        recording_from_bytes(data, "a.csv", NAMEPLATE)


def test_a_low_pressure_is_refused_without_a_known_range_only_if_the_stem_moves() -> None:
    bare = replace(NAMEPLATE, actuator=Actuator(travel_m=0.1016, diaphragm_area_m2=0.06452), signal=None)
    with pytest.raises(RecordingError, match="kPa or bar or psi"):
        recording_from_bytes(csv_of(0.098 * UP_AND_DOWN, 11.6 * UP_AND_DOWN), "a.csv", bare)
    recording_from_bytes(csv_of(0.0 * UP_AND_DOWN, 11.6 * UP_AND_DOWN), "a.csv", bare)


def test_what_a_real_valve_shows_is_not_taken_for_a_wrong_unit() -> None:
    for position_m, pressure_pa in (
        (0.11 * UP_AND_DOWN - 0.002, 1.4e5 * UP_AND_DOWN),  # a little over the travel, supply above the signal
        (1.0e-5 * UP_AND_DOWN, 8.0e4 * UP_AND_DOWN),  # stuck
        (0.0 * UP_AND_DOWN, 0.0 * UP_AND_DOWN),  # vented
        (1.0e-5 * UP_AND_DOWN, 50.0 * UP_AND_DOWN),  # vented, noise
    ):
        recording_from_bytes(csv_of(position_m, pressure_pa), "a.csv", NAMEPLATE)


def _columns(rows: int) -> dict[str, pa.Array]:
    return {
        "time_s": pa.array(np.arange(float(rows))),
        "position_m": pa.array(np.zeros(rows)),
        "pressure_pa": pa.array(np.arange(float(rows))),
    }


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_file_of_too_many_rows_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    path = tmp_path / f"long.{kind}"
    table = pa.table(_columns(10_000))
    if kind == "csv":
        pa.csv.write_csv(table, path)
    else:
        pq.write_table(table, path, compression="zstd")
    assert read_recording(path, most_rows=10_000).samples == 10_000
    monkeypatch.setattr(pq, "read_table", None)
    monkeypatch.setattr(pa.csv, "read_csv", None)
    with pytest.raises(RecordingError, match=rf"long\.{kind}: it has 10000 rows, the most is 9999: give fewer"):
        read_recording(path, most_rows=9_999)


def test_a_few_rows_of_long_texts_are_refused_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = pa.array([f"{number:03d}" + "x" * 1_000_000 for number in range(10)])
    pq.write_table(pa.table(_columns(10) | {"position_m": texts}), tmp_path / "texts.parquet", compression="zstd")
    assert (tmp_path / "texts.parquet").stat().st_size < 100_000
    monkeypatch.setattr(pq, "read_table", None)
    with pytest.raises(RecordingError, match=r"unpacks to 1000\d* bytes, the most is 48000: write numbers alone"):
        read_recording(tmp_path / "texts.parquet", most_rows=1000)
