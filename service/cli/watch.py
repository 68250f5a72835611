"""``breakaway watch``: a valve from normal operation, with no test; without a stem, whether its loop says: test it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.cli.analysis_summary import print_understood
from service.cli.output import STANDARD_OUTPUT, require_writable, write_json

if TYPE_CHECKING:
    from estimators.in_service.result import Watched
    from service.own_files.understood import Reading
    from service.watching.loop_reading import LoopReading


def watch(
    record: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Time, position, and pressure or command of a historian or logger: CSV, xlsx or Parquet, also gz. "
            "Or controller output and process value of its loop, or a day's .watch file of the store.",
            show_default=False,
        ),
    ],
    *,
    nameplate: Annotated[
        Path | None,
        typer.Option("--nameplate", metavar="FILE", help="The valve's nameplate, TOML: forces need its area."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="The plant file that has the valve, instead of a nameplate."),
    ] = None,
    valve: Annotated[str | None, typer.Option("--valve", metavar="TAG", help="The valve in --config.")] = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar='"NAME=HEADER [UNIT],..."',
            help='Which column is what, where headers leave it open: "position_m=Hub [%]", and without a stem '
            '"controller_output=HEADER,process_value=HEADER". Nothing after = leaves out.',
        ),
    ] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE", help="Write the result there as JSON; - prints it.")
    ] = None,
) -> None:
    """Say what normal operation tells of a valve: friction, breakaway, dead band, spring, lag and travel.

    Without a stem position: whether its loop oscillates, and whether to test the valve.
    """
    if nameplate is not None and config is not None:
        raise typer.BadParameter("give --nameplate FILE or --config plant.toml with --valve TAG, not both")
    if (config is None) != (valve is None):
        raise typer.BadParameter("--config plant.toml and --valve TAG go together")
    require_writable(json_file)
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    read = _read(record, nameplate, config, valve, ",".join(mapping or []))
    if not isinstance(read, tuple):
        _judge_loop(console, read, str(record), json_file)
        return
    found, reading = read
    if reading.understood is not None:
        print_understood(console, reading.understood.to_json())
    _print(console, found)
    if json_file is not None:
        write_json(json_file, _document(found, reading))


def _read(
    record: Path, nameplate: Path | None, config: Path | None, tag: str | None, mapping: str
) -> LoopReading | tuple[Watched, Reading]:
    """Return the loop of a file where it is asked for or the file has no stem, else what the stem did."""
    from service.own_files.mapping import parse_mapping
    from service.watching.loop_reading import LOOP_COLUMNS, find_loop, read_loop
    from valve.errors import RecordingError
    from valve.recording_csv import COLUMNS

    names = parse_mapping(mapping, (*COLUMNS, *LOOP_COLUMNS))
    if any(name in names for name in LOOP_COLUMNS):
        return read_loop(record, names)
    try:
        return _watched(record, nameplate, config, tag, names)
    except RecordingError:
        if (loop := find_loop(record, names)) is None:
            raise
        return loop


def _judge_loop(console: Console, loop: LoopReading, subject: str, json_file: str | None) -> None:
    from estimators.loop_stiction.verdict import judged_loop, to_json
    from service.watching.loop_summary import loop_lines, loop_sentence

    found = judged_loop(loop.time_s, loop.output, loop.value, loop.setpoint, subject=subject)
    print_understood(console, loop.understood.to_json())
    console.print(Text(loop_sentence(found, subject), style="bold"))
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for name, words in loop_lines(found, loop.output_unit, loop.value_unit):
        table.add_row(name, Text(words))
    console.print(table)
    for note in found.notes:
        console.print(Text(f"Note: {note}"))
    if json_file is not None:
        document = to_json(found)
        units = {"output_unit": loop.output_unit, "value_unit": loop.value_unit}
        document["recording"] |= {**units, "understood": [loop.understood.to_json()]}
        write_json(json_file, document)


def _watched(
    record: Path, nameplate: Path | None, config: Path | None, tag: str | None, names: Mapping[str, str]
) -> tuple[Watched, Reading]:
    # heavy imports stand here: --help and wrong usage do without
    from estimators.in_service.watch import watched
    from service.cli.analyze import chosen_nameplate
    from service.watching.reading import read_in_service

    plate = None if nameplate is None and config is None else chosen_nameplate(nameplate, config, tag)
    reading, scale = read_in_service(record, plate, names)
    return watched(reading.recording, plate, scale, subject=str(record)), reading


def _print(console: Console, found: Watched) -> None:
    from service.watching.summary import figure_lines, histogram_lines, travel_lines, unknown_lines, verdict

    console.print(Text(verdict(found), style="bold"))
    if lines := figure_lines(found):
        table = Table(box=None, pad_edge=False)
        for heading in ("", "value, 95 % interval", "of span", "from move to move"):
            table.add_column(heading, no_wrap=True, justify="right" if heading.startswith(("of", "from")) else "left")
        for line in lines:
            table.add_row(*(Text(part) for part in line))
        console.print(table)
    for words in unknown_lines(found):
        console.print(Text(words))
    ways = Table(box=None, show_header=False, pad_edge=False)
    ways.add_column(no_wrap=True)
    ways.add_column()
    for name, words in travel_lines(found):
        ways.add_row(name, Text(words))
    console.print(ways)
    bars = Table(title="Where the stem stood", title_justify="left", box=None, show_header=False, pad_edge=False)
    bars.add_column(justify="right", no_wrap=True)
    bars.add_column(no_wrap=True)
    for place, bar in histogram_lines(found):
        bars.add_row(place, bar)
    console.print(bars)
    for note in found.notes:
        console.print(Text(f"Note: {note}"))


def _document(found: Watched, reading: Reading) -> dict[str, Any]:
    from estimators.in_service.result import to_json

    document = to_json(found)
    if reading.understood is not None:
        document["recording"]["understood"] = [reading.understood.to_json()]
    return document
