"""Cells of a table: numbers with either decimal mark, gaps as historians write them, and dates with times."""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from valve.errors import RecordingError
from valve.recording import FloatArray

# What PI, PHD, IP.21, DeltaV, WinCC, Excel and loggers write where there was no value; small letters.
_GAPS: Final = frozenset(
    """
    nan|null|none|n/a|na|#n/a|#nv|#wert!|#value!|#div/0!|#ref!|#num!|-|--|---|----|?|???|****|*****|bad|bad input
    bad value|bad data|bad quality|bad_input|badvalue|i/o timeout|io timeout|i/o-timeout|timeout|time out|no data
    nodata|no_data|no value|no good data|no good data for calculation|no result|comm fail|comm failure|comm error
    communication failure|configure|intf shut|intf_shut|under range|underrange|over range|overrange|over_range
    under_range|out of range|pt created|ptcreated|scan off|scan timeout|scan_off|shutdown|error|err|fault|failed
    fail|invalid|invalid float|invalid data|questionable|not connect|not connected|notconnected|not available
    not_available|unavailable|offline|off-line|arc off-line|arc offline|calc failed|calc off|calc overflow
    digital state|dcs failed|out of serv|out of service|out_of_service|uncertain|stale|snapshot too old|access denied
    no sample|no_sample|sample bad|doubtful|disconnected|open circuit|sensor fault|overflow|ovr|ovf|ungueltig|ungültig
    schlecht|störung|fehler|kein wert|keine daten|mauvais|invalide|malo|inválido
    """.replace("\n", "|")
    .replace("    ", "")
    .strip("|")
    .split("|")
)
_NUMBER: Final = re.compile(
    r"[+-]?(?=[.,]?\d)(?:\d{1,3}(?:[.' \u00a0\u202f]\d{3})+(?=,|$|[eE])|\d{1,3}(?:[,' \u00a0\u202f]\d{3})+(?=\.|$|[eE])"
    r"|\d*)(?:[.,]\d*)?(?:[eE][+-]?\d+)?"
)
_CLOCK: Final = re.compile(
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<fraction>\d{1,9}))?)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_DATE: Final = re.compile(
    r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{2,4}|\d{1,2}[-/ .]+[A-Za-z]{3,9}\.?[-/ .,]+\d{2,4}"
    r"|[A-Za-z]{3,9}\.? +\d{1,2},? +\d{4}"
)
_MINUTES: Final = re.compile(r"(\d{1,3}):([0-5]\d)[.,](\d{1,9})")  # 59:58.0, as spreadsheets show a time of day
_COMPACT: Final = re.compile(r"\b(\d{4})(\d\d)(\d\d)[Tt](\d\d)(\d\d)(\d\d)")  # 20261125T115958.250Z
_REGION: Final = re.compile(r"\[?[A-Za-z]+(?:/[A-Za-z_+-]+)+\]?")  # Europe/Berlin: alone it gives no offset
_CODE: Final = re.compile(r"\[-?\d+\].*|<[^<>]*>")  # [-11059] No Good Data For Calculation, <null>
_SHARED: Final = 0.1  # of the rows that have the stamp of the row before: the stamps are too coarse
_HOUR_S: Final = 3600.0
_ONE_OF_THOUSAND: Final = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}")  # 1,234: a number near 1, or above 1000
_GROUPS: Final = "['\u00a0\u202f ]"
_DAY_S: Final = 86400.0
_SHOWN: Final = 40  # characters of a bad cell that a message repeats
_ZONES: Final = {  # hours from UTC, of the names that historians write
    "UTC": 0.0, "GMT": 0.0, "Z": 0.0, "WET": 0.0, "BST": 1.0, "WEST": 1.0, "CET": 1.0, "MEZ": 1.0, "CEST": 2.0,
    "MESZ": 2.0, "EET": 2.0, "EEST": 3.0, "MSK": 3.0, "EST": -5.0, "EDT": -4.0, "CST": -6.0, "CDT": -5.0,
    "MST": -7.0, "MDT": -6.0, "PST": -8.0, "PDT": -7.0, "JST": 9.0,
}  # fmt: skip


def is_number(cell: str) -> bool:
    """Whether the cell is a number, with either decimal mark; a gap is none."""
    return bool(cell) and bool(_NUMBER.fullmatch(cell)) and any(letter.isdigit() for letter in cell)


def is_stamp(cell: str) -> bool:
    """Whether the cell is a date, a time of day or both."""
    return bool(cell) and len(cell) < 64 and bool(_CLOCK.search(cell) or _DATE.match(cell) or _COMPACT.match(cell))


def is_gap_text(cell: str) -> bool:
    """Whether the cell is a text that historians write for no value."""
    return cell.casefold() in _GAPS or bool(_CODE.fullmatch(cell))


@dataclass(frozen=True, slots=True)
class Numbers:
    """Values of a column, NaN for a gap, and how often each text of a gap stands in it ("" for an empty cell)."""

    values: FloatArray
    gaps: Counter[str]
    decimal_comma: bool = False


class BadCellError(Exception):
    """A cell that is no number and no gap: its row, counted from 0, its text and what to do."""

    def __init__(self, row: int, text: str, hint: str = "") -> None:
        super().__init__(text)
        self.row, self.text, self.hint = row, text[:_SHOWN], hint


def numbers(cells: pa.Array, *, comma_elsewhere: bool | None = None) -> Numbers:
    """Return a column's numbers. ``comma_elsewhere``: the file's other columns have decimal commas; None: unknown.

    Raises BadCellError at the first cell that is neither a number nor a gap, or that fits two readings.
    """
    texts = pc.utf8_trim_whitespace(cells)
    small = pc.utf8_lower(texts)
    empty = pc.equal(texts, "")
    coded = pc.match_substring_regex(texts, f"^(?:{_CODE.pattern})$")
    gap = pc.or_(pc.or_(empty, coded), pc.is_in(small, value_set=pa.array(sorted(_GAPS))))
    counts: Counter[str] = Counter()
    if pc.any(gap).as_py():
        for entry in pc.value_counts(texts.filter(gap)).to_pylist():
            counts[entry["values"]] += int(entry["counts"])
        texts = pc.if_else(gap, pa.scalar(None, pa.string()), texts)
    with_comma = bool(pc.any(pc.match_substring(texts, ",")).as_py())
    comma = False
    try:
        if not with_comma:
            if comma_elsewhere:
                _refuse_thousands(texts, ".")
            values = pc.cast(texts, pa.float64())
        else:
            texts, comma = _with_points(texts, comma_elsewhere)
            values = pc.cast(texts, pa.float64())
    except pa.ArrowInvalid:
        grouped = pc.replace_substring_regex(texts, rf"(\d){_GROUPS}(\d)", r"\1\2")
        try:
            values = pc.cast(grouped, pa.float64())
        except pa.ArrowInvalid:
            raise _first_bad(cells) from None
    found = np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64)
    return Numbers(found, counts, comma)


def _with_points(texts: pa.Array, comma_elsewhere: bool | None) -> tuple[pa.Array, bool]:
    """Return cells with commas as cells with decimal points, and whether the comma was the decimal mark."""
    commas = texts.filter(pc.fill_null(pc.match_substring(texts, ","), fill_value=False))
    both = commas.filter(pc.match_substring(commas, "."))
    points = bool(pc.any(pc.match_substring(texts, ".")).as_py())
    if len(both):
        first = str(both[0].as_py())
        comma = first.rfind(",") > first.rfind(".")
    elif points:  # 0.5 in one row and 0,5 in another
        row = pc.index(pc.fill_null(pc.match_substring(texts, ","), fill_value=False), True).as_py()
        raise BadCellError(row, str(texts[row].as_py()), "other rows have a decimal point: write one mark only")
    else:
        told = pc.any(pc.invert(pc.match_substring_regex(commas, r"^[+-]?[1-9]\d{0,2}(,\d{3})+$"))).as_py()
        if not told and comma_elsewhere is None:
            row = pc.index(pc.fill_null(pc.match_substring(texts, ","), fill_value=False), True).as_py()
            raise BadCellError(row, str(texts[row].as_py()), "it fits two readings: write it with a decimal point")
        comma = bool(told) or bool(comma_elsewhere)
    if comma:
        texts = pc.replace_substring(pc.replace_substring(texts, ".", ""), ",", ".")
    else:
        texts = pc.replace_substring(texts, ",", "")
    return texts, comma


def _refuse_thousands(texts: pa.Array, mark: str) -> None:
    pointed = texts.filter(pc.fill_null(pc.match_substring(texts, mark), fill_value=False))
    if len(pointed) == 0:
        return
    if pc.all(pc.match_substring_regex(pointed, r"^[+-]?[1-9]\d{0,2}(\.\d{3})+$")).as_py():
        row = pc.index(pc.fill_null(pc.match_substring(texts, mark), fill_value=False), True).as_py()
        raise BadCellError(
            row, str(texts[row].as_py()), "other columns have a decimal comma and it fits two readings: write one mark"
        )


def _first_bad(cells: pa.Array) -> BadCellError:
    for row, cell in enumerate(cells.to_pylist()):
        text = str(cell).strip()
        if text and not is_gap_text(text) and not is_number(text):
            return BadCellError(row, text)
    return BadCellError(0, str(cells[0].as_py()))


def has_decimal_comma(cells: pa.Array) -> bool | None:
    """Whether a column's numbers have a decimal comma; None where it does not show."""
    for cell in cells.slice(0, 500).to_pylist():
        text = str(cell).strip()
        if not is_number(text) or ("," not in text and "." not in text):
            continue
        if _ONE_OF_THOUSAND.fullmatch(text):
            continue
        return text.rfind(",") > text.rfind(".")
    return None


# ---------------------------------------------------------------- dates and times


@dataclass(frozen=True, slots=True)
class Stamps:
    """Seconds from the first row on, and when that was, where the zone is known."""

    time_s: FloatArray
    started_at: str
    words: str


@dataclass(frozen=True, slots=True)
class _Part:
    """What stands around the time of day: a date, a zone; few rows differ in it."""

    date: str
    zone: str


def stamps(cells: pa.Array, source: str, name: str) -> Stamps:
    """Return the seconds of a column of dates and times, NaN where a cell is empty.

    Raises BadCellError at a cell that is none, and RecordingError where the dates fit two readings.
    """
    texts = [_COMPACT.sub(r"\1-\2-\3 \4:\5:\6", str(cell).strip()) for cell in cells.to_pylist()]
    filled = [text for text in texts if text and not is_gap_text(text)]
    if filled and all(_MINUTES.fullmatch(text) for text in filled):
        past_hour_s = np.array([_past_hour_s(text) for text in texts])
        return Stamps(_begun_again(past_hour_s, _HOUR_S), "", "minutes and seconds of the hour")
    clock_s = np.full(len(texts), np.nan)
    parts: list[_Part | None] = [None] * len(texts)
    known: dict[tuple[str, str], _Part] = {}
    for row, text in enumerate(texts):
        if not text or is_gap_text(text):
            continue
        found = _CLOCK.search(text)
        if found is None:
            raise BadCellError(row, text, "give a date and a time of day")
        clock_s[row] = _seconds(found, row, text)
        around = (text[: found.start()].rstrip("T ,;"), _REGION.sub("", text[found.end() :]).strip())
        parts[row] = known.setdefault(around, _Part(*around))
    if not known:
        raise BadCellError(0, texts[0], "give a date and a time of day")
    if not any(part.date for part in known.values()):
        time_s = _begun_again(clock_s, _DAY_S)
        _refuse_coarse(time_s, source, name)
        return Stamps(time_s, "", "time of day")
    orders = [_dated(list(known.values()), day_first=day_first) for day_first in (True, False)]
    possible = [origins for origins in orders if origins is not None]
    if not possible:
        shown = texts[0][:_SHOWN]
        raise RecordingError(f"{source}: column {name!r}: {shown!r} is no date that is known: write ISO 8601")
    origins = min(possible, key=lambda one: _duration_s(one, clock_s, parts))
    zones = sorted({part.zone for part in known.values() if part.zone})
    words = f"date and time{', zone ' + ' and '.join(zones) if zones else ''}"
    first = next(part for part in parts if part is not None)
    zero = origins[first]
    days_s = np.array([np.nan if part is None else (origins[part] - zero).total_seconds() for part in parts])
    since_s = days_s + clock_s
    begin_s = float(clock_s[np.flatnonzero(np.isfinite(clock_s))[0]])
    # whole nanoseconds: what the stamps' decimals mean, not what float64 makes of their difference
    time_s = np.round(since_s - begin_s, 9)
    _refuse_coarse(time_s, source, name)
    started = zero + timedelta(seconds=begin_s)
    return Stamps(time_s, started.isoformat() if started.tzinfo is not None else "", words)


def _seconds(found: re.Match[str], row: int, text: str) -> float:
    hour, minute, second = (int(found[name] or 0) for name in ("hour", "minute", "second"))
    if found["half"]:
        hour = hour % 12 + (12 if found["half"] in "pP" else 0)
    if hour > 24 or minute > 59 or second > 60:
        raise BadCellError(row, text, "it is no time of day")
    fraction = found["fraction"]
    return 3600.0 * hour + 60.0 * minute + second + (int(fraction) / 10 ** len(fraction) if fraction else 0.0)


def _past_hour_s(text: str) -> float:
    found = _MINUTES.fullmatch(text)
    return math.nan if found is None else 60.0 * int(found[1]) + float(f"{found[2]}.{found[3]}")


def _begun_again(clock_s: FloatArray, round_s: float) -> FloatArray:
    """Seconds from the first row on, a round (a day, an hour) added where the clock begins again."""
    rows = np.flatnonzero(np.isfinite(clock_s))
    steps_s = np.diff(clock_s[rows])
    rounds = np.concatenate([[0.0], np.cumsum(steps_s < -0.5 * round_s)])
    time_s = np.array(clock_s)
    time_s[rows] = np.round(clock_s[rows] + round_s * rounds - clock_s[rows[0]], 9)
    return time_s


def _refuse_coarse(time_s: FloatArray, source: str, name: str) -> None:
    """Refuse whole seconds that many rows share: when in the second each was is not in the file."""
    known_s = time_s[np.isfinite(time_s)]
    steps_s = np.diff(known_s)
    if steps_s.size == 0 or np.any(steps_s < 0.0) or np.mean(steps_s == 0.0) < _SHARED:
        return
    most = int(np.unique(known_s, return_counts=True)[1].max())
    raise RecordingError(
        f"{source}: column {name!r}: up to {most} rows share a stamp, it is too coarse for them: "
        "export it with fractions of a second, or the time as a number"
    )


def _duration_s(origins: dict[_Part, datetime], clock_s: FloatArray, parts: list[_Part | None]) -> float:
    """Return how long the rows span: of 03/04/2026 that order of day and month is meant which keeps them together."""
    zero = next(iter(origins.values()))
    since_s = [
        (origins[part] - zero).total_seconds() + clock_s[row] for row, part in enumerate(parts) if part is not None
    ]
    return float(np.ptp(since_s))


def _dated(known: list[_Part], *, day_first: bool) -> dict[_Part, datetime] | None:
    from dateutil import parser  # noqa: PLC0415  - few files need it

    zones: dict[str, Any] = {zone: timezone(timedelta(hours=hours)) for zone, hours in _ZONES.items()}
    origins: dict[_Part, datetime] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for part in known:
            text = f"{part.date} 00:00:00 {part.zone}".strip()
            year_first = bool(re.match(r"\d{4}", part.date))
            try:
                origins[part] = parser.parse(
                    text, dayfirst=day_first and not year_first, yearfirst=year_first, tzinfos=zones,
                    default=datetime(1970, 1, 1),  # noqa: DTZ001  - a stamp without a zone stays without
                )  # fmt: skip
            except (ValueError, OverflowError, Warning):
                return None
    aware = {origin.tzinfo is not None for origin in origins.values()}
    if len(aware) > 1:
        return None
    return {part: origin.astimezone(UTC) if origin.tzinfo is not None else origin for part, origin in origins.items()}
