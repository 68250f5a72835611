"""A recording of a file as its owner has it, and what was understood of it; what is open is asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.data_faults.vacuum import FROM_VACUUM
from service.own_files.cells import BadCellError, has_decimal_comma, is_gap_text, is_number, is_stamp, numbers
from service.own_files.cells import stamps as read_stamps
from service.own_files.names import (
    DIMENSIONS,
    USUAL,
    Quantity,
    Unit,
    is_of_another_place,
    quantities,
    unit_of,
    without_unit,
)
from service.own_files.table import SECOND_TABLE, Table, find_table, row_texts
from service.own_files.understood import Reading, Understood, UnderstoodColumn
from valve.errors import RecordingError
from valve.messages import say
from valve.nameplate import Nameplate
from valve.plausibility import require_no_stand_ins, require_plausible_current
from valve.recording import INTERVAL_CHANNELS, FloatArray, Provenance
from valve.recording_csv import COLUMNS, too_many_rows
from valve.recording_files import file_content, recording_from_bytes, recording_from_columns

LEAST_ROWS: Final = 20  # one ramp that is seen at all

_CHANNELS: Final[dict[Quantity, str]] = {
    Quantity.TIME: "time_s",
    Quantity.POSITION: "position_m",
    Quantity.PRESSURE: "pressure_pa",
    Quantity.FORCE: "force_n",
    Quantity.COMMAND: "command_pa",
}
_QUANTITY_OF: Final = {
    **{name: quantity for quantity, name in _CHANNELS.items()},
    "command_ma": Quantity.COMMAND,
    **dict.fromkeys(INTERVAL_CHANNELS, Quantity.TIME),
}
_ORDER: Final = ("time_s", "command_pa", "command_ma", "pressure_pa", "force_n", "position_m", *INTERVAL_CHANNELS)
_SHORTEST_PERIOD_MS: Final = 0.1  # no valve's recording has rows faster than 10 kHz: such a number is no millisecond
_MOST_SHOWN: Final = 12
_SI: Final = {"s": "s", "pa": "Pa", "ma": "mA", "n": "N", "m": "m"}  # by the last part of a contract's name


@dataclass(frozen=True, slots=True)
class _Choice:
    """A column that is used: which, as what, in which unit; ``unit`` None where its cells are dates."""

    at: int
    column: str
    unit: Unit | None
    mapped: bool


def read_own(
    path: Path | str,
    nameplate: Nameplate,
    mapping: Mapping[str, str] | None = None,
    *,
    most_rows: int | None = None,
    in_service: bool = False,
) -> Reading:
    """Return the recording of a file, whatever its form, in SI units, and what was understood.

    A file as the contract has it (``valve.recording_files``) is read as it stands. In any other the table, its
    columns and their units are found; ``mapping`` says what the headers leave open, by the contract's names. With
    ``most_rows`` a file that has more is refused before it is unpacked. ``in_service``: a historian's slow rows pass.
    Raises RecordingError with file, row, column, value and remedy where the file cannot be right, and with the
    mapping to give where a column fits two readings.
    """
    reading = own_from_bytes(
        file_content(Path(path)),
        str(path),
        nameplate,
        mapping,
        suffix=Path(path).suffix,
        most_rows=most_rows,
        in_service=in_service,
    )
    if reading.recording.samples < LEAST_ROWS:
        raise RecordingError(
            f"{path}: it has {reading.recording.samples} rows, an analysis needs at least {LEAST_ROWS}: "
            "give the whole recording"
        )
    return reading


def own_from_bytes(
    data: bytes,
    source: str,
    nameplate: Nameplate,
    mapping: Mapping[str, str] | None = None,
    *,
    suffix: str = "",
    most_rows: int | None = None,
    in_service: bool = False,
) -> Reading:
    """Return the recording of a file's content; ``source`` names it in messages. Raises as ``read_own``."""
    strict: RecordingError | None = None
    if not mapping:
        try:
            says_parquet = suffix in (".parquet", ".pq")
            return Reading(
                recording_from_bytes(
                    data, source, nameplate, says_parquet=says_parquet, most_rows=most_rows, in_service=in_service
                )
            )
        except RecordingError as error:
            strict = error
        if "does not start as a Parquet file" in str(strict):
            raise strict
    table = find_table(data, source, most_rows) if data.strip() else None
    if table is not None and most_rows is not None and table.rows > most_rows:
        raise RecordingError(too_many_rows(source, table.rows, most_rows))
    if table is None or table.rows == 0:
        raise strict or RecordingError(f"{source}: there is no table of numbers below a header line: give one")
    try:
        return _read(table, nameplate, mapping or {}, in_service=in_service)
    except RecordingError as error:
        # of a file that means to be as the contract has it, that reader's words
        if strict is not None and set(table.headers) <= set(COLUMNS) and SECOND_TABLE not in str(error):
            raise strict from None
        raise


def _read(table: Table, nameplate: Nameplate, mapping: Mapping[str, str], *, in_service: bool) -> Reading:
    choices, dates = _chosen(table, nameplate, mapping)
    comma = _decimal_comma(table, choices)
    columns: dict[str, FloatArray] = {}
    said: list[UnderstoodColumn] = []
    remarks: list[str] = []
    provenance = Provenance()
    for choice in choices:
        header = table.headers[choice.at]
        how: str
        try:
            if choice.unit is None:
                cells = table.columns[choice.at] if dates is None else _together(table, dates)
                header = header if dates is None else " + ".join(table.headers[at] for at in dates)
                found = read_stamps(cells, table.source, header)
                columns[choice.column], unit, how = (
                    found.time_s,
                    found.words,
                    say("seconds_from_first_row", "seconds from the first row"),
                )
                provenance = replace(provenance, started_at=found.started_at)
                gaps: Counter[str] = Counter()
            else:
                read = numbers(table.columns[choice.at], comma_elsewhere=comma)
                require_no_stand_ins(f"{header!r}", read.values, table.source)
                columns[choice.column], how = _converted(read.values, choice, nameplate, table.source, header)
                unit, gaps = choice.unit.text, read.gaps
                how = say("with_decimal_comma", "{how}, decimal comma", how=how) if read.decimal_comma else how
                if choice.unit.absolute and choice.column == "pressure_pa":
                    provenance = replace(provenance, notes=FROM_VACUUM)
        except BadCellError as bad:
            raise _bad_cell(table, bad, header, [one.at for one in choices]) from None
        texts = {text: count for text, count in gaps.items() if text}
        if texts:
            counted = tuple(
                say("count_of_text", "{count} {text}", count=count, text=text) for text, count in sorted(texts.items())
            )
            how = say("with_gaps", "{how}; gaps: {gaps:, }", how=how, gaps=counted)
        said.append(UnderstoodColumn(header, choice.column, unit, how, int(np.isnan(columns[choice.column]).sum())))
    empty = np.isnan(np.array(list(columns.values()))).all(axis=0)
    if empty.any():
        columns = {name: column[~empty] for name, column in columns.items()}
        remarks.append(
            say("empty_rows_left_out", "{count} rows without any value are left out.", count=int(empty.sum()))
        )
    if table.left_out_lines:
        remarks.append(say("lines_left_out", "{count} lines after the table are left out.", count=table.left_out_lines))
    used = {choice.at for choice in choices} | set(dates or ())
    understood = Understood(
        Path(table.source).name,
        table.kind,
        table.rows,
        tuple(sorted(said, key=lambda one: _ORDER.index(one.column))),
        tuple(header for at, header in enumerate(table.headers) if at not in used and header),
        tuple(remarks),
    )
    recording = recording_from_columns(columns, provenance, table.source, nameplate, in_service=in_service)
    return Reading(recording, understood)


# ---------------------------------------------------------------- which column is what


def _chosen(
    table: Table, nameplate: Nameplate, mapping: Mapping[str, str]
) -> tuple[list[_Choice], tuple[int, ...] | None]:
    """Return the columns that are used, and those that together are date and time.

    Raises RecordingError where a header fits two readings, with the mapping that settles all that is open.
    """
    chosen: dict[Quantity | str, _Choice] = {}
    left_out = set()
    for name, wanted in mapping.items():
        if not wanted:
            left_out.add(_key(name))
            continue
        at, unit_text = _mapped(table, name, wanted)
        chosen[_key(name)] = _Choice(at, name, _own_unit(table, at, name, unit_text), mapped=True)
    taken = {choice.at for choice in chosen.values()}
    for at, header in enumerate(table.headers):
        name = header.strip().casefold()
        if at in taken or name not in COLUMNS or _key(name) in chosen or _key(name) in left_out:
            continue
        if sum(header.strip().casefold() == name for header in table.headers) > 1:
            raise RecordingError(f"{table.source}: column {header!r} stands in it twice, remove one")
        unit = unit_of(_SI[name.rpartition("_")[2]])
        chosen[_key(name)] = _Choice(at, name, unit, mapped=False)
    open_points: list[str] = []
    example: dict[str, str] = {}
    odd: list[str] = []  # why a column of the right name is none
    dates: tuple[int, ...] | None = None
    for quantity in Quantity:
        if quantity in chosen or quantity in left_out:
            continue
        fits = [
            at
            for at, header in enumerate(table.headers)
            if at not in {choice.at for choice in chosen.values()} and quantity in quantities(header)
        ]
        own = [at for at in fits if not is_of_another_place(table.headers[at])]
        odd += [_wrong_dimension(table, at, _CHANNELS[quantity]) for at in own if not _may_be(table, at, quantity)]
        own = [at for at in own if _may_be(table, at, quantity)]
        if quantity is Quantity.TIME and (pair := _date_and_time(table, own)) is not None:
            dates, own = pair, [pair[1]]
        if quantity is Quantity.TIME:
            own = _each_once(table, own)
        several = [at for at in own if len(quantities(table.headers[at])) > 1]
        name = _CHANNELS[quantity]
        if len(own) > 1 or several:
            wanted = f"fits {len(own)} columns, {_listed(table, own)}" if len(own) > 1 else ""
            both = f"is not the only reading of {_listed(table, several)}" if several else ""
            open_points.append(f"{name} {wanted or both}")
            example[name] = _with_unit(table, own[0], quantity)
        elif own:
            unit, asked = _found(table, own[0], quantity, nameplate)
            if asked:
                usual = asked[0] if quantity is not Quantity.TIME else asked[-1]
                open_points.append(
                    f"{name}: column {table.headers[own[0]]!r} has no unit, it fits {' or '.join(asked)}"
                )
                example[name] = f"{table.headers[own[0]]} [{usual}]"
            else:
                chosen[quantity] = _Choice(own[0], name, unit, mapped=False)
    missing = [_CHANNELS[one] for one in (Quantity.TIME, Quantity.POSITION) if one not in chosen]
    missing = [name for name in missing if name not in example]
    inputs = (Quantity.PRESSURE, Quantity.FORCE, Quantity.COMMAND)
    if not any(one in chosen or _CHANNELS[one] in example for one in inputs):
        missing.append("pressure_pa")
    if missing and odd:
        raise RecordingError(f"{table.source}: {odd[0]}")
    if missing:
        free = [at for at in range(len(table.headers)) if at not in {choice.at for choice in chosen.values()}]
        values = [at for at in free if _first_values(table, at).size]
        if (tags := _value_a_row(table, free, values)) is not None:
            raise RecordingError(
                f"{table.source}: it holds one value a row, of the tag in column {table.headers[tags]!r}: "
                "export it with a column for each tag and a row for each time"
            )
        free = values or free
        words = [name if name != "pressure_pa" else "pressure_pa, force_n or command_pa" for name in missing]
        open_points.append(
            say(
                "no_column_surely",
                "no column is surely {names: and none }, there are {columns}",
                names=tuple(words),
                columns=_listed(table, free),
            )
        )
        for number, name in enumerate(missing):
            example[name] = _with_unit(table, free[number % len(free)], _QUANTITY_OF[name]) if free else "header [unit]"
    if open_points:
        given = ",".join([f"{name}={wanted}" for name, wanted in mapping.items()])
        typed = ",".join([*([given] if given else []), *(f"{name}={header}" for name, header in example.items())])
        spare = next((name for name in ("force_n", "command_pa") if name in example and name not in missing), "")
        which = say(
            "say_which_column",
            '{source}: {points:; }: say which column is what, for example --map "{mapping}"',
            source=table.source,
            points=tuple(open_points),
            mapping=typed,
        )
        if spare:
            which = say("or_leave_out", '{which}, or leave it out with "{name}="', which=which, name=spare)
        raise RecordingError(which)
    return list(chosen.values()), dates


def _each_once(table: Table, columns: Sequence[int]) -> list[int]:
    """Return columns without those that repeat an earlier one: some loggers write the time beside each channel."""
    kept: list[int] = []
    for at in columns:
        if not any(table.columns[at].equals(table.columns[other]) for other in kept):
            kept.append(at)
    return kept


def _value_a_row(table: Table, free: Sequence[int], values: Sequence[int]) -> int | None:
    """Return the column of tags where each row holds the value of one tag, as historians export; else None."""
    if len(values) != 1:
        return None
    for at in free:
        cells = [str(cell).strip() for cell in table.columns[at].slice(0, 1000).to_pylist()]
        if at not in values and all(cells) and not _holds_stamps(table, at) and 2 * len(set(cells)) <= len(cells):
            return at
    return None


def _key(name: str) -> Quantity | str:
    return name if name in INTERVAL_CHANNELS else _QUANTITY_OF[name]


def _listed(table: Table, columns: Sequence[int]) -> str:
    shown = [repr(_title(table, at)) for at in columns[:_MOST_SHOWN] if table.headers[at]]
    more = f" and {len(columns) - _MOST_SHOWN} more" if len(columns) > _MOST_SHOWN else ""
    return ", ".join(shown) + more if shown else "none"


def _title(table: Table, at: int) -> str:
    """Header of a column, with the unit that stands below it."""
    return f"{table.headers[at]} [{table.units[at].strip('[](){} ')}]" if is_unit_row(table, at) else table.headers[at]


def is_unit_row(table: Table, at: int) -> bool:
    """Whether a unit stands below the header of a column."""
    return unit_of(table.units[at]) is not None


def _with_unit(table: Table, at: int, quantity: Quantity) -> str:
    title = _title(table, at)
    unit = unit_of(without_unit(title)[1])
    if (unit is not None and unit.dimension in DIMENSIONS[quantity]) or _holds_stamps(table, at):
        return title
    return f"{table.headers[at]} [{USUAL[quantity][-1 if quantity is Quantity.TIME else 0]}]"


def _mapped(table: Table, name: str, wanted: str) -> tuple[int, str]:
    """Return the column of a mapping's right side, and the unit that it names beside the header, "" for none."""
    bare, unit_text = without_unit(wanted)
    spelled = [header.strip().casefold() for header in table.headers]
    for text, unit in ((wanted, ""), (bare, unit_text)):
        at = [number for number, header in enumerate(spelled) if header == text.strip().casefold()]
        if not at:
            at = [
                number
                for number, header in enumerate(table.headers)
                if unit and without_unit(header)[0].casefold() == text.strip().casefold()
            ]
        if len(at) > 1:
            raise RecordingError(f"{table.source}: header {text!r} stands in it {len(at)} times: rename one")
        if at:
            return at[0], unit
    every = list(range(len(table.headers)))
    raise RecordingError(
        f"{table.source}: --map gives {name} the header {wanted[:60]!r}, the file has {_listed(table, every)}: give one"
    )


def _own_unit(table: Table, at: int, name: str, unit_text: str) -> Unit | None:
    """Return the unit of a column that a mapping names. Raises RecordingError where there is none, or it cannot be."""
    quantity = _QUANTITY_OF[name]
    if quantity is Quantity.TIME and _holds_stamps(table, at):
        return None
    text = unit_text or without_unit(table.headers[at])[1] or table.units[at]
    unit = unit_of(text) if text else None
    if unit is None and table.headers[at].strip().casefold() == name:
        unit = unit_of(_SI[name.rpartition("_")[2]])
    shown = f"{name}={table.headers[at]}"
    usual = ", ".join(USUAL[quantity])
    if unit is None:
        raise RecordingError(
            f"{table.source}: --map {shown!r} has no unit that is known, {quantity} is in {usual} and others: "
            f'give it, for example --map "{shown} [{USUAL[quantity][0]}]"'
        )
    if unit.dimension not in DIMENSIONS[quantity]:
        raise RecordingError(f"{table.source}: {_wrong_dimension(table, at, name, unit)}")
    return unit


def _wrong_dimension(table: Table, at: int, name: str, unit: Unit | None = None) -> str:
    unit = unit or _stated_unit(table, at)
    assert unit is not None
    hint = {
        "percent": "write it in Pa: percent of which range is not known",
        "angle": "write it as the way of the stem: the angle in rad times the lever in m",
        "voltage": "convert it by the range of its transmitter",
        "current": "convert it by the range of its transmitter",
    }.get(unit.dimension, f"{name} may be in {', '.join(USUAL[_QUANTITY_OF[name]])}")
    return f"column {table.headers[at]!r} is a {unit.dimension} ({unit.text}) and no {name}: {hint}"


def _found(table: Table, at: int, quantity: Quantity, nameplate: Nameplate) -> tuple[Unit | None, tuple[str, ...]]:
    """Return the unit of a column, None for dates; or the units that it may be in, which is to be asked."""
    if quantity is Quantity.TIME and _holds_stamps(table, at):
        return None, ()
    unit = _stated_unit(table, at)
    if unit is not None:
        return unit, ()
    if quantity is Quantity.TIME and _can_only_be_seconds(table, at):
        return unit_of("s"), ()
    return None, _fitting_units(table, at, quantity, nameplate) or USUAL[quantity]


def _stated_unit(table: Table, at: int) -> Unit | None:
    return unit_of(without_unit(table.headers[at])[1]) or unit_of(table.units[at])


def _may_be(table: Table, at: int, quantity: Quantity) -> bool:
    """Whether a column's unit, where it has one, is one of this quantity."""
    unit = _stated_unit(table, at)
    return unit is None or unit.dimension in DIMENSIONS[quantity] or _holds_stamps(table, at)


def _can_only_be_seconds(table: Table, at: int) -> bool:
    """Whether the rows would be too fast for a valve's recording if a time without a unit were in milliseconds."""
    values = _first_values(table, at)
    steps = np.diff(values)
    return steps.size > 0 and 0.0 < float(np.median(steps)) < _SHORTEST_PERIOD_MS


def _first_values(table: Table, at: int) -> FloatArray:
    try:
        values = numbers(table.columns[at].slice(0, 5000), comma_elsewhere=has_decimal_comma(table.columns[at])).values
    except BadCellError:
        return np.empty(0)
    return values[np.isfinite(values)]


def _fitting_units(table: Table, at: int, quantity: Quantity, nameplate: Nameplate) -> tuple[str, ...]:
    """Return the usual units in which the largest value is what the nameplate lets expect, 0.2 to 2.5 times."""
    values = np.abs(_first_values(table, at))
    if values.size == 0:
        return ()
    reached = float(values.max())
    fits = []
    for text in USUAL[quantity]:
        unit = unit_of(text)
        assert unit is not None
        expected: float | None = None
        if unit.dimension == "length":
            expected = nameplate.actuator.travel_m
        elif unit.dimension == "percent":
            expected = 100.0
        elif unit.dimension == "current":
            expected = 20.0
        elif unit.dimension == "pressure" and nameplate.signal is not None:
            expected = nameplate.signal.range_pa[1]
        if expected is None or 0.2 * expected <= reached * unit.factor <= 2.5 * expected:
            fits.append(text)
    return tuple(fits)


def _holds_stamps(table: Table, at: int) -> bool:
    cells = (str(cell).strip() for cell in table.columns[at].slice(0, 50).to_pylist())
    first = next((cell for cell in cells if cell and not is_gap_text(cell)), "")
    return is_stamp(first) and not is_number(first)


def _date_and_time(table: Table, columns: Sequence[int]) -> tuple[int, ...] | None:
    """Return a column of dates and one of times of day, where two are just that."""
    if len(columns) != 2:
        return None
    first = [str(table.columns[at][0].as_py()).strip() for at in columns]
    with_clock = [":" in cell for cell in first]
    if not all(is_stamp(cell) for cell in first) or sum(with_clock) != 1:
        return None
    return (columns[with_clock.index(False)], columns[with_clock.index(True)])


def _together(table: Table, columns: Sequence[int]) -> Any:
    import pyarrow.compute as pc  # noqa: PLC0415

    return pc.binary_join_element_wise(*(pc.utf8_trim_whitespace(table.columns[at]) for at in columns), " ")


# ---------------------------------------------------------------- what is in it


def _decimal_comma(table: Table, choices: Sequence[_Choice]) -> bool | None:
    told = [
        comma
        for choice in choices
        if choice.unit is not None and (comma := has_decimal_comma(table.columns[choice.at])) is not None
    ]
    return None if not told else any(told)


def _converted(
    values: FloatArray, choice: _Choice, nameplate: Nameplate, source: str, header: str
) -> tuple[FloatArray, str]:
    """Return the values in the contract's unit, and what was done, in words."""
    assert choice.unit is not None
    unit, name = choice.unit, choice.column
    if unit.dimension == "percent" and _QUANTITY_OF[name] is Quantity.POSITION:
        travel_m = nameplate.actuator.travel_m
        how = say("percent_of_travel_of", "percent of the nameplate's travel, {travel:g m}", travel=travel_m)
        return values * (travel_m / 100.0), how
    if _QUANTITY_OF[name] is Quantity.COMMAND:
        if unit.dimension in ("percent", "current") and nameplate.signal is None:
            raise RecordingError(
                say(
                    "column_needs_signal",
                    "{source}: column {header} is in {unit} and the nameplate of {tag} has no [signal]: give "
                    "signal.range_ma and signal.range_pa, or a command in a pressure's unit",
                    source=source,
                    header=repr(header),
                    unit=unit.text,
                    tag=nameplate.tag,
                )
            )
        if unit.dimension == "percent":
            assert nameplate.signal is not None
            low, high = nameplate.signal.range_pa
            how = say(
                "percent_of_signal_of",
                "percent of the nameplate's signal, {low:g in Pa} to {high:g Pa}",
                low=low,
                high=high,
            )
            return low + values * ((high - low) / 100.0), how
        if unit.dimension == "current":
            assert nameplate.signal is not None
            (low_ma, high_ma), (low, high) = nameplate.signal.range_ma, nameplate.signal.range_pa
            how = say(
                "current_is_pressure",
                "{low_current:g} to {high_current:g} mA are {low:g in Pa} to {high:g Pa}",
                low_current=low_ma,
                high_current=high_ma,
                low=low,
                high=high,
            )
            current_ma = values * unit.factor
            require_plausible_current(current_ma, source)
            return low + (current_ma - low_ma) * ((high - low) / (high_ma - low_ma)), how
    if unit.factor == 1.0:
        how = say("as_it_is", "as it is")
    elif unit.factor == 1.0e-3:
        return values / 1.0e3, say(
            "divided_by_1000", "divided by 1000"
        )  # the nearest number to the decimal that was written
    else:
        how = say("times_factor", "times {factor:.9g}", factor=unit.factor)
    return values if unit.factor == 1.0 else values * unit.factor, how


def _bad_cell(table: Table, bad: BadCellError, header: str, used: Sequence[int]) -> RecordingError:
    line = table.line_of(bad.row)
    cells = [cell for at, cell in enumerate(row_texts(table, bad.row)) if at in used]
    if bad.row > 0 and not any(is_number(cell) or is_stamp(cell) for cell in cells) and any(cells):
        return RecordingError(
            f"{table.source}: line {line} of the file {SECOND_TABLE}: save each table in a file of its own"
        )
    hint = bad.hint or "give a number, or nothing for a gap"
    return RecordingError(
        f"{table.source}: row {bad.row + 1} (line {line} of the file), column {header!r}: {bad.text!r} "
        f"{'' if bad.hint else 'is not a number'}".rstrip()
        + f": {hint}"
    )
