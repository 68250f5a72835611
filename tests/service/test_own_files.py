"""Files as people have them: each kind is read right, or refused with what to do; nothing is guessed in silence."""

from __future__ import annotations

import contextlib
import datetime
import gzip
import io
import random
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from estimators.data_faults.vacuum import FROM_VACUUM
from service.own_files.mapping import parse_mapping
from service.own_files.reader import own_from_bytes, read_own
from valve.errors import RecordingError, RequestError
from valve.nameplate import Actuator, Nameplate, Signal
from valve.units import METRE_PER_INCH, PASCAL_PER_PSI

PLATE = Nameplate(
    "FV-101",
    Actuator(travel_m=0.1016, diaphragm_area_m2=0.06452, bench_set_pa=(0.0, 82737.0)),
    Signal((4.0, 20.0), (0.0, 82737.0)),
)
ROWS = 80
TIME_S = np.round(0.05 * np.arange(ROWS), 9)
SHARE = 1.0 - np.abs(TIME_S / TIME_S[-1] * 2.0 - 1.0)
POSITION_M = np.round(0.0983 * SHARE + 0.00012, 8)
PRESSURE_PA = np.round(80321.0 * SHARE + 157.0, 2)
PERCENT = POSITION_M / 0.1016 * 100.0
PSI = PRESSURE_PA / PASCAL_PER_PSI
BAR = PRESSURE_PA / 1.0e5

Cells = Sequence[float] | Sequence[str] | Sequence[datetime.datetime] | np.typing.NDArray[np.float64]


def text(header: str, *columns: Cells, sep: str = ",", mark: str = ".", end: str = "\n") -> str:
    rows = [
        sep.join(cell if isinstance(cell, str) else f"{cell:.10g}".replace(".", mark) for cell in row)
        for row in zip(*columns, strict=True)
    ]
    return end.join([header, *rows]) + end


def clock(form: str, start: datetime.datetime) -> list[str]:
    """Stamps of the rows in ``form``, where %f is three digits."""
    moments = [start + datetime.timedelta(seconds=float(second)) for second in TIME_S]
    return [one.strftime(form.replace("%f", f"{one.microsecond // 1000:03d}")) for one in moments]


def workbook(*rows: Sequence[object], sheets: int = 1) -> bytes:
    book = openpyxl.Workbook()
    for number in range(sheets):
        sheet = book.active if number == 0 else book.create_sheet(f"Second {number}")
        assert sheet is not None
        for row in rows:
            sheet.append(list(row))
    sink = io.BytesIO()
    book.save(sink)
    return sink.getvalue()


def numbers(*columns: Cells) -> list[list[object]]:
    return [[cell if isinstance(cell, str | datetime.datetime) else float(cell) for cell in row]
            for row in zip(*columns, strict=True)]  # fmt: skip


def shown_in_percent() -> bytes:
    """Return a workbook whose travel is a fraction that the sheet shows in percent."""
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append(["Time [s]", "Pressure [bar]", "Travel"])
    for row in numbers(TIME_S, BAR, PERCENT / 100.0):
        sheet.append(row)
    for (cell,) in sheet.iter_rows(min_row=2, min_col=3, max_col=3):
        cell.number_format = "0.00%"
    sink = io.BytesIO()
    book.save(sink)
    return sink.getvalue()


def zipped(*names: str, data: bytes = b"") -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(name), data)
    return sink.getvalue()


def parquet() -> bytes:
    sink = io.BytesIO()
    pq.write_table(pa.table({"Time [s]": TIME_S, "Pressure [bar]": BAR, "Travel [%]": PERCENT}), sink)
    return sink.getvalue()


NOON = datetime.datetime.fromisoformat("2026-11-25T11:59:58")
GERMAN = text("Zeit [ms];Stelldruck [bar];Hub [%]", 1e3 * TIME_S, BAR, PERCENT, sep=";", mark=",", end="\r\n")
PLAIN = text("time_s,pressure_pa,position_m", TIME_S, PRESSURE_PA, POSITION_M)
PSI_PERCENT = text("Time (s),Pressure (psi),Travel [%]", TIME_S, PSI, PERCENT)
KPA_INCH = text("Time/s\tPressure/kPa\tPosition/in", TIME_S, PRESSURE_PA / 1e3, POSITION_M / METRE_PER_INCH, sep="\t")
UNITS_BELOW = text("Zeit;Druck;Weg\ns;bar;mm", TIME_S, BAR, 1e3 * POSITION_M, sep=";", mark=",")
ISO_STAMPS = clock("%Y-%m-%dT%H:%M:%S.%f+01:00", NOON)
MIDNIGHT = datetime.datetime.fromisoformat("2026-03-04T23:59:58")

GOOD: dict[str, bytes] = {
    "utf-8 with a byte order mark": GERMAN.encode("utf-8-sig"),
    "utf-16": GERMAN.replace("Hub", "Hub der Spindel, Rückmeldung").encode("utf-16"),
    "utf-16 without a mark": GERMAN.encode("utf-16-le"),
    "latin-1": GERMAN.replace("Hub", "Rückmeldung").encode("latin-1"),
    "latin-1 with µ and °": text(
        "Zeit [µs];Weg [µm];Druck [bar];Temp [°C]", 1e6 * TIME_S, 1e6 * POSITION_M, BAR, TIME_S, sep=";", mark=","
    ).encode("latin-1"),
    "semicolons and decimal comma": GERMAN.encode(),
    "tabs, kPa and inch": KPA_INCH.encode(),
    "bars": PSI_PERCENT.replace(",", "|").encode(),
    "spaces": text("time_s pressure_pa position_m", TIME_S, PRESSURE_PA, POSITION_M, sep="   ").encode(),
    "old line ends": GERMAN.replace("\r\n", "\r").encode(),
    "lines before the header": ("Prüfstand 3\nStart;25.11.2026 11:59\nKanäle;3;5;7\n\n" + GERMAN).encode(),
    "a row of units": UNITS_BELOW.encode(),
    "a row of units in brackets and a comment": UNITS_BELOW.replace(
        "s;bar;mm\n", "[s];[bar];[mm]\nlog;at actuator;stem\n"
    ).encode(),
    "psi and percent in the header": PSI_PERCENT.encode(),
    "units behind an underscore": text(
        "time_ms,Pressure_kPa,PositionMM", 1e3 * TIME_S, PRESSURE_PA / 1e3, 1e3 * POSITION_M
    ).encode(),
    "dates with a zone": text("Timestamp,Pressure [psig],Travel [%]", ISO_STAMPS, PSI, PERCENT).encode(),
    "US dates apart from times": text(
        "Date,Time,Pressure [psi],Position [in]",
        ["11/25/2026"] * ROWS,
        clock("%I:%M:%S.%f %p", NOON),
        PSI,
        POSITION_M / METRE_PER_INCH,
    ).encode(),
    "German dates over midnight": text(
        "Zeitstempel;Druck [mbar];Hub [mm]", clock("%d.%m.%Y %H:%M:%S,%f", MIDNIGHT), BAR * 1e3, 1e3 * POSITION_M,
        sep=";", mark=",",
    ).encode(),
    "dates with / over midnight": text(
        "Time,Pressure [bar],Lift [cm]", clock("%m/%d/%Y %H:%M:%S.%f", MIDNIGHT), BAR, 1e2 * POSITION_M
    ).encode(),
    "times of day over midnight": text("Time,Pressure [bar],Lift [mm]", clock("%H:%M:%S.%f", MIDNIGHT), BAR,
                                       1e3 * POSITION_M).encode(),
    "a zone that changes": text(
        "Time;Pressure [bar];Travel [%]",
        [*clock("%Y-%m-%d %H:%M:%S.%f CEST", datetime.datetime.fromisoformat("2026-10-25T02:59:58"))[:40],
         *clock("%Y-%m-%d %H:%M:%S.%f CET", datetime.datetime.fromisoformat("2026-10-25T01:59:58"))[40:]],
        BAR, PERCENT, sep=";",
    ).encode(),
    "capitals": PLAIN.replace("time_s,pressure_pa,position_m", "TIME_S,Pressure_Pa,POSITION_M").encode(),
    "extra columns": text(
        "Nr;Zeit [s];Zuluftdruck [bar];Stelldruck [bar];Hub [mm];Temp [°C];Quality",
        np.arange(1.0, ROWS + 1), TIME_S, np.full(ROWS, 4.0), BAR, 1e3 * POSITION_M, TIME_S, ["Good"] * ROWS, sep=";",
    ).encode(),
    "a separator at the end of each row": GERMAN.replace("\r\n", ";\r\n").encode(),
    "a comment sign before the header": ("# " + PSI_PERCENT).encode(),
    "quoted cells with decimal commas": text(
        '"Zeit [s]","Druck [bar]","Hub [mm]"', *([f'"{cell:.8g}"'.replace(".", ",") for cell in column]
                                                  for column in (TIME_S, BAR, 1e3 * POSITION_M))
    ).encode(),
    "thousands and a decimal comma": text(
        "Zeit [s];Druck [Pa];Hub [mm]", TIME_S, [f"{cell:,.2f}".translate(str.maketrans(",.", ".,"))
                                                 for cell in PRESSURE_PA], 1e3 * POSITION_M, sep=";", mark=",",
    ).encode(),
    "lines after the table": (PSI_PERCENT + "\nEnd of file\n").encode(),
    "gz": gzip.compress(GERMAN.encode(), mtime=0),
    "xlsx": workbook(["Test of FV-101"], [], ["Time", "Pressure", "Travel"], ["ms", "psi", "%"],
                     *numbers(1e3 * TIME_S, PSI, PERCENT)),
    "xlsx with dates": workbook(["Time", "Pressure [psi]", "Travel [%]"], *numbers(
        [NOON + datetime.timedelta(seconds=float(second)) for second in TIME_S], PSI, PERCENT)),
    "Parquet of others": parquet(),
    "zip": zipped("export/test.csv", data=GERMAN.encode()),
    "zip of a workbook beside what a desktop leaves": zipped(
        "test.xlsx", "__MACOSX/._test.xlsx", data=workbook(["Time [s]", "Pressure [bar]", "Travel [%]"],
                                                           *numbers(TIME_S, BAR, PERCENT))),
    "xlsx that shows percent": shown_in_percent(),
    "a percent sign in each cell": text("Time [s],Pressure [psi],Travel", TIME_S, PSI,
                                        [f"{cell:.9g}%" for cell in PERCENT]).encode(),
    "a percent sign in header and cells": text("Time [s],Pressure [psi],Travel [%]", TIME_S, PSI,
                                               [f"{cell:.9g} %" for cell in PERCENT]).encode(),
    "units in all cells": text("Time,Pressure,Travel", [f"{one:g} s" for one in TIME_S],
                               [f"{cell:.9g} psi" for cell in PSI], [f"{cell:.9g} %" for cell in PERCENT]).encode(),
    "stamps without marks": text("Timestamp,Pressure [psig],Travel [%]", clock("%Y%m%dT%H%M%S.%fZ", NOON), PSI,
                                 PERCENT).encode(),
    "a region behind the offset": text("Timestamp,Pressure [psig],Travel [%]",
                                       [f"{one}[Europe/Berlin]" for one in ISO_STAMPS], PSI, PERCENT).encode(),
    "a region alone": text("Timestamp,Pressure [psig],Travel [%]", clock("%Y-%m-%d %H:%M:%S.%f Europe/Berlin", NOON),
                           PSI, PERCENT).encode(),
    "minutes and seconds over the hour": text("Time,Pressure [bar],Lift [mm]", clock("%M:%S.%f", NOON), BAR,
                                              1e3 * POSITION_M).encode(),
    "the same time beside each channel": text("Time [s],Pressure [bar],Time [s],Lift [mm]", TIME_S, BAR, TIME_S,
                                              1e3 * POSITION_M).encode(),
    "lbf/in² and thousandths of an inch": text("Time [s],Pressure [lbf/in²],Travel [mil]", TIME_S, PSI,
                                               1e3 * POSITION_M / METRE_PER_INCH).encode(),
    "Torr": text("Time [s],Pressure [Torr],Travel [%]", TIME_S, PRESSURE_PA / 133.322368421, PERCENT).encode(),
    "room that a logger kept": GERMAN.encode() + bytes(5000),
}  # fmt: skip


@pytest.mark.parametrize("kind", GOOD)
def test_a_file_of_this_kind_gives_the_right_recording(kind: str) -> None:
    reading = own_from_bytes(GOOD[kind], "a.csv", PLATE)
    recording, understood = reading.recording, reading.understood
    assert understood is not None, "it is said what was understood"
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.position_m, POSITION_M, rtol=1e-6, atol=1e-9)
    assert recording.pressure_pa is not None
    np.testing.assert_allclose(recording.pressure_pa, PRESSURE_PA, rtol=1e-6)
    assert recording.command_pa is None, "what is of another place is no channel"
    assert {one.column for one in understood.columns} == {"time_s", "pressure_pa", "position_m"}
    assert recording.gaps == 0


def test_a_file_of_the_contract_is_read_as_it_stands() -> None:
    assert own_from_bytes(PLAIN.encode(), "a.csv", PLATE).understood is None


def test_texts_of_historians_are_gaps_and_counted() -> None:
    pressure = [f"{cell:.9g}" for cell in PRESSURE_PA]
    position = [f"{cell:.9g}" for cell in POSITION_M]
    pressure[3] = pressure[4] = "Bad"
    pressure[9], position[4], position[30] = "I/O Timeout", "Intf Shut", "#N/A"
    pressure[11], position[12] = "[-11059] No Good Data For Calculation", "<null>"
    for header in ("time_s,pressure_pa,position_m", "Time [s],Pressure [Pa],Position [m]"):
        reading = own_from_bytes(text(header, TIME_S, pressure, position).encode(), "a.csv", PLATE)
        assert reading.recording.pressure_pa is not None
        assert np.flatnonzero(np.isnan(reading.recording.pressure_pa)).tolist() == [3, 4, 9, 11]
        assert np.flatnonzero(np.isnan(reading.recording.position_m)).tolist() == [4, 12, 30]
        assert reading.understood is not None
        assert "gaps: 2 Bad, 1 I/O Timeout" in reading.understood.columns[1].how


def test_a_command_in_percent_or_milliamperes_becomes_a_pressure_by_the_nameplate() -> None:
    for header, cells in (("OP [%]", 100.0 * SHARE), ("Stellsignal [mA]", 4.0 + 16.0 * SHARE)):
        data = text(f"t [s];{header};Hub [mm]", TIME_S, cells, 1e3 * POSITION_M, sep=";").encode()
        command_pa = own_from_bytes(data, "a.csv", PLATE).recording.command_pa
        assert command_pa is not None
        np.testing.assert_allclose(command_pa, 82737.0 * SHARE, atol=1e-3)
        with pytest.raises(RecordingError, match=r"nameplate of FV-101 has no \[signal\]: give signal.range_ma"):
            own_from_bytes(data, "a.csv", replace(PLATE, signal=None))


def test_a_pressure_that_is_absolute_by_its_unit_says_so() -> None:
    data = text("Time [s],Pressure [bara],Travel [%]", TIME_S, BAR + 1.01325, PERCENT).encode()
    assert own_from_bytes(data, "a.csv", PLATE).recording.provenance.notes == FROM_VACUUM


# ---------------------------------------------------------------- what is asked for, and how it is settled


@pytest.mark.parametrize(
    ("data", "asked", "mapping"),
    [
        (
            text("Time,Pressure [bar],Position [mm]", 1e3 * TIME_S, BAR, 1e3 * POSITION_M),
            r"time_s: column 'Time' has no unit, it fits s or ms: .* --map \"time_s=Time \[ms\]\"",
            "time_s=Time [ms]",
        ),
        (
            text("Time [s],Pressure,Position", TIME_S, BAR, 1e3 * POSITION_M),
            r"'Position' has no unit, it fits % or mm; .*it fits bar.*\"position_m=Position \[%\],pressure_pa=Pr",
            "position_m=Position [mm],pressure_pa=Pressure [bar]",
        ),
        (
            text("Time [s];Pressure [bar];Hub [%];Weg [mm]", TIME_S, BAR, PERCENT + 1.0, 1e3 * POSITION_M, sep=";"),
            r"position_m fits 2 columns, 'Hub \[%\]', 'Weg \[mm\]': .* --map \"position_m=Hub \[%\]\"",
            "position_m=Weg [mm]",
        ),
        (
            text("Ch1;Ch2, left;Ch3", TIME_S, BAR, 1e3 * POSITION_M, sep=";"),
            r"no column is surely time_s .*there are 'Ch1', 'Ch2, left', 'Ch3'",
            "time_s=Ch1 [s],pressure_pa=Ch2, left [bar],position_m=Ch3 [mm]",
        ),
        (
            text("Time [s],Output pressure [bar],Travel [%]", TIME_S, BAR, PERCENT),
            r"command_pa is not the only reading|pressure_pa is not the only reading",
            "pressure_pa=Output pressure [bar]",
        ),
        (
            text("Time [s],Supply pressure [bar],Travel [%]", TIME_S, BAR, PERCENT),
            r"no column is surely pressure_pa, force_n or command_pa, there are 'Supply pressure \[bar\]'",
            "pressure_pa=Supply pressure [bar]",
        ),
        (
            text("Time [s],Pressure [bar],Travel [%],Load", TIME_S, BAR, PERCENT, TIME_S),
            r"force_n: column 'Load' has no unit, .*or leave it out with \"force_n=\"",
            "force_n=",
        ),
    ],
)
def test_what_fits_two_readings_is_asked_for_and_the_mapping_settles_it(data: str, asked: str, mapping: str) -> None:
    with pytest.raises(RecordingError, match=asked) as caught:
        own_from_bytes(data.encode(), "a.csv", PLATE)
    assert "\n" not in str(caught.value)
    recording = own_from_bytes(data.encode(), "a.csv", PLATE, parse_mapping(mapping)).recording
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.position_m, POSITION_M, rtol=1e-6)
    assert recording.pressure_pa is not None
    np.testing.assert_allclose(recording.pressure_pa, PRESSURE_PA, rtol=1e-6)


def test_a_mapping_has_the_contracts_name_on_the_left_and_a_header_of_the_file_on_the_right() -> None:
    assert parse_mapping("position_m=Hub, links [%], time_s = Zeit [ms]") == {
        "position_m": "Hub, links [%]",
        "time_s": "Zeit [ms]",
    }
    assert parse_mapping(" ") == {}
    for wrong in ("hub=position_m", "position_m", "x,position_m=Hub"):
        with pytest.raises(RequestError, match="on the left one of time_s"):
            parse_mapping(wrong)
    with pytest.raises(RequestError, match="given twice"):
        parse_mapping("position_m=a,position_m=b")
    for mapping, says in (
        ({"position_m": "Hubb"}, r"--map gives position_m the header 'Hubb', the file has 'Zeit \[ms\]', "),
        ({"position_m": "Stelldruck [bar]"}, r"'Stelldruck \[bar\]' is a pressure \(bar\) and no position_m"),
    ):
        with pytest.raises(RecordingError, match=says):
            own_from_bytes(GERMAN.encode(), "a.csv", PLATE, mapping)
    bare = text("Zeit [s];Druck [bar];X", TIME_S, BAR, POSITION_M, sep=";").encode()
    with pytest.raises(RecordingError, match=r'has no unit that is known.* --map "position_m=X \[%\]"'):
        own_from_bytes(bare, "a.csv", PLATE, {"position_m": "X"})


# ---------------------------------------------------------------- what stays refused


NEWEST_FIRST = text("Time [s],Pressure [bar],Travel [%]", TIME_S[::-1], BAR, PERCENT)
WITH_STAND_IN = [*PRESSURE_PA[:7], -9999.0, *PRESSURE_PA[8:]]
POINTS = [f"{cell:.3f}" for cell in 1.0 + 8.0 * SHARE]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (text("time,pressure_pa,position_m", 1e3 * TIME_S, PRESSURE_PA, POSITION_M).encode(), "it fits s or ms"),
        (text("time_s,pressure_pa,position_m", TIME_S, PSI, POSITION_M).encode(), "looks like .*psi: write it in Pa"),
        (text("Zeit [s];pressure_pa;Hub [%]", TIME_S, PSI, PERCENT, sep=";").encode(), "psi: write it in Pa"),
        (NEWEST_FIRST.encode(), "the newest row stands first, .* sort the rows by time"),
        (text("time_s,pressure_pa,position_m", TIME_S[::-1], PRESSURE_PA, POSITION_M).encode(), "newest row stands"),
        ((PSI_PERCENT + "\n" + PSI_PERCENT).encode(), "line 83 of the file begins a second table: save each"),
        ((PLAIN + PLAIN).encode(), "line 82 of the file begins a second table"),
        ((text("time_s,pressure_pa,position_m", TIME_S[:30], BAR[:30], BAR[:30]) + PLAIN).encode(), "a second table"),
        (
            (PSI_PERCENT + "\n" + text("Time [s],Travel [%]", TIME_S, PERCENT)).encode(),
            "line 83 of the file begins a second table",
        ),
        (workbook(["Time [s]", "Pressure [bar]", "Hub [%]"], *numbers(TIME_S, BAR, PERCENT), sheets=2), "a table each"),
        (
            text("Time [s],Pressure [Pa],Travel [%]", TIME_S, WITH_STAND_IN, PERCENT).encode(),
            r"row 8, column 'Pressure \[Pa\]': it is -9999, which loggers write for no value",
        ),
        (
            text("time_s,pressure_pa,position_m", TIME_S, WITH_STAND_IN, POSITION_M).encode(),
            "row 8, column pressure_pa: it is -9999, which loggers write for no value",
        ),
        (text("Time [s],Pressure [V],Travel [%]", TIME_S, BAR, PERCENT).encode(), r"a voltage \(V\) and no pressure"),
        (text("Time [s],Pressure [%],Travel [%]", TIME_S, BAR, PERCENT).encode(), "percent of which range"),
        (text("Time [s],Pressure [bar],Position [deg]", TIME_S, BAR, PERCENT).encode(), "times the lever"),
        (
            text("Zeit [s];Druck [kPa];Hub [mm]", np.arange(float(ROWS)), [p.replace(".", ",") for p in POINTS], POINTS,
                 sep=";").encode(),
            "fits two readings",
        ),
        (text("Zeit [s];Druck [kPa];Hub [mm]", TIME_S, POINTS, BAR, sep=";").replace("1.000", "1,000").encode(),
         "write one mark only|fits two readings"),
        (PSI_PERCENT.replace("2,", "2;x,", 1).replace("0.05,", "0.05,abc,").encode(), "4 cells and the header has 3"),
        (PSI_PERCENT.replace(",2.", ",abc2.", 1).encode(), r"column .*: 'abc2\.\d+' is not a number"),
        (b"\xd0\xcf\x11\xe0" + bytes(100), "old kind"),
        (zipped("a.csv", "b/c.csv", data=GERMAN.encode()),
         r"a zip of 2 files \('a.csv', 'b/c.csv'\): give one of them"),
        (zipped("a.csv", data=GERMAN.encode())[:-40] + bytes(40), "cannot be read as an xlsx|zip"),
        (text("Time,Pressure [bar],Hub [mm]", clock("%Y-%m-%d %H:%M:%S", NOON), BAR, 1e3 * POSITION_M).encode(),
         "up to 20 rows share a stamp, it is too coarse for them: export it with fractions of a second"),
        (text("Tag,Timestamp,Value", ["FV101.ZT", "FV101.PT"] * (ROWS // 2), ISO_STAMPS, PERCENT).encode(),
         "one value a row, of the tag in column 'Tag': export it with a column for each tag"),
        (text("Time [s],Pressure [bar],Travel [mm]", TIME_S, BAR, [f"{cell:.9g} %" for cell in PERCENT]).encode(),
         r"column 'Travel \[mm\]': .*%' is not a number"),
        (bytes(range(256)) * 20, "it is no text"),
        (b"PK\x03\x04" + bytes(100), "cannot be read as an xlsx workbook"),
        (gzip.compress(GERMAN.encode(), mtime=0)[:60], "gz cannot be unpacked"),
        (text("1,2,3", TIME_S, BAR, PERCENT).encode(), "holds numbers, it must be a header"),
        (b"tag = 'FV-101'\n[actuator]\ntravel_m = 0.1\n", "unknown column"),
        (b"", "the file is empty"),
    ],
    ids=lambda one: "file" if isinstance(one, bytes) else None,  # bytes of an archive have the time in them
)  # fmt: skip
def test_a_file_that_cannot_be_right_is_refused_in_one_sentence(data: bytes, says: str) -> None:
    with pytest.raises(RecordingError, match=says) as caught:
        own_from_bytes(data, "a.csv", PLATE)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("a.csv: ")


def test_a_second_table_far_down_the_file_is_found_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.own_files.table._HEAD_ROWS", 20)
    for second, says in (
        (PSI_PERCENT, "line 83 of the file begins a second table: save each"),
        (text("Time [s],Travel [%]", TIME_S, PERCENT), "line 84 begins a second table with 2 columns"),
    ):
        with pytest.raises(RecordingError, match=says):
            own_from_bytes((PSI_PERCENT + "\n" + second).encode(), "a.csv", PLATE)


def test_too_few_rows_for_an_analysis_are_refused(tmp_path: Path) -> None:
    (tmp_path / "four.csv").write_text("\n".join(PLAIN.splitlines()[:5]))
    with pytest.raises(RecordingError, match=r"it has 4 rows, an analysis needs at least 20"):
        read_own(tmp_path / "four.csv", PLATE)


def test_a_packed_file_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.own_files.content._MOST_BYTES", 1000)
    with pytest.raises(RecordingError, match="unpacked it has more than 1000 bytes"):
        own_from_bytes(gzip.compress(GERMAN.encode(), mtime=0), "a.csv", PLATE)
    with pytest.raises(RecordingError, match="unpacked it has more than 1000 bytes"):
        own_from_bytes(GOOD["xlsx"], "a.csv", PLATE)


@pytest.mark.parametrize("kind", ["semicolons and decimal comma", "gz", "xlsx", "Parquet of others"])
def test_a_file_of_more_rows_than_are_taken_is_refused(kind: str) -> None:
    assert own_from_bytes(GOOD[kind], "a.csv", PLATE, most_rows=100).recording.samples == ROWS
    with pytest.raises(RecordingError, match=r"it has \d+ rows, the most is 20|unpacked it has more than \d+ bytes"):
        own_from_bytes(GOOD[kind], "a.csv", PLATE, most_rows=20)
    with pytest.raises(RecordingError, match=r"the most is 20"):
        own_from_bytes(PLAIN.encode(), "a.csv", PLATE, most_rows=20)


def test_a_damaged_file_is_read_or_refused_and_never_a_fault_of_ours() -> None:
    draw = random.Random(5)
    files = list(GOOD.values())
    read = 0
    for _ in range(400):
        data = bytearray(draw.choice(files))
        for _ in range(draw.randint(1, 6)):
            at = draw.randrange(len(data))
            if draw.random() < 0.5:
                data[at] = draw.randrange(256)
            else:
                del data[at : at + draw.randint(1, 40)]
        with contextlib.suppress(RecordingError):
            read += own_from_bytes(bytes(data), "a.csv", PLATE).recording.samples > 0
    assert read > 0
