"""``breakaway analyze``: parameters of recordings that exist already, with no service and no device."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from service.cli.analysis_summary import print_summary, print_understood
from service.cli.analysis_tables import print_analysis
from service.cli.held_out import HeldOutCommand
from service.cli.output import STANDARD_OUTPUT, require_writable, write_json
from service.cli.report import require_report_name, write_report
from valve.errors import RequestError
from valve.messages import say, with_table
from valve.nameplate import Nameplate

if TYPE_CHECKING:
    from service.own_files.understood import Reading

COMMAND_CLASS = HeldOutCommand


def analyze(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING",
            help="CSV, xlsx or Parquet files, also gz. Other names than the contract's are found by the headers.",
            show_default=False,
        ),
    ],
    *,
    nameplate: Annotated[
        Path | None,
        typer.Option("--nameplate", metavar="FILE", help="The valve's nameplate, TOML.", show_default=False),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="The plant file that has the valve, instead of a nameplate."),
    ] = None,
    valve: Annotated[str | None, typer.Option("--valve", metavar="TAG", help="The valve in --config.")] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--held-out", metavar="RECORDING...", help="Recordings to try the estimates on; they are not fitted."
        ),
    ] = None,
    mapping: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar='"NAME=HEADER [UNIT],..."',
            help='Which column is what, where headers leave it open: "position_m=Hub [%]". Nothing after = leaves out.',
        ),
    ] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE", help="Write the analysis object there; - prints it.")
    ] = None,
    report_file: Annotated[
        str | None, typer.Option("--report", metavar="FILE", help="Write the report there: x.pdf or x.html.")
    ] = None,
    details: Annotated[
        bool, typer.Option("--details", help="Print every method's values, the signature and the diagnosis too.")
    ] = False,
) -> None:
    """Say what is wrong with a valve from recordings of it, and estimate its parameters by three methods."""
    if (nameplate is None) == (config is None) or (config is None) != (valve is None):
        raise typer.BadParameter("give either --nameplate FILE, or --config plant.toml with --valve TAG")
    require_writable(json_file)
    require_report_name(report_file)
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=30), TimeElapsedColumn())
    screen = Console(stderr=True)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as progress:
        task = progress.add_task("reading", total=1.0)
        plate = chosen_nameplate(nameplate, config, valve)
        own, tried = _read(recordings, held_out or [], plate, ",".join(mapping or []))
        for one in (*own, *(reading for _, reading in tried)):
            if one.understood is not None:
                print_understood(console, one.understood.to_json())
        analysis = _analysis(own, tried, plate, progress, task)
    print_summary(console, analysis)
    if details:
        print_analysis(console, analysis)
    if json_file is not None:
        write_json(json_file, analysis)
    if report_file is not None:
        write_report(report_file, recordings, plate, (nameplate or config or Path()).name, analysis)


def chosen_nameplate(file: Path | None, config: Path | None, tag: str | None) -> Nameplate:
    """Return the nameplate of a file, or of a valve of a plant file. Raises RequestError."""
    # heavy imports stand here: --help and wrong usage do without
    if file is not None:
        from service.config.nameplates import read_nameplate

        return read_nameplate(file)
    from service.config.settings import load_plant

    assert config is not None
    assert tag is not None
    valves = load_plant(config).valves
    if tag not in valves:
        raise RequestError(
            say(
                "no_valve_in_file",
                "{config}: there is no valve {tag}, there are {known:, }: choose one",
                config=str(config),
                tag=tag,
                known=tuple(valves),
            )
        )
    return valves[tag].nameplate


def _read(
    recordings: list[Path], held_out: list[Path], plate: Nameplate, mapping: str
) -> tuple[list[Reading], list[tuple[str, Reading]]]:
    """Read all input, and refuse it where it is wrong, before the estimators are loaded."""
    from service.own_files.mapping import parse_mapping
    from service.own_files.reader import read_own

    settled = parse_mapping(mapping)
    own = [read_own(path, plate, settled) for path in recordings]
    return own, [(path.name, read_own(path, plate, settled)) for path in held_out]


def _analysis(
    own: list[Reading], tried: list[tuple[str, Reading]], plate: Nameplate, progress: Progress, task: TaskID
) -> dict[str, Any]:
    progress.update(task, description="loading the estimators")

    from service.analysis.analysis import analyze_recordings
    from service.own_files.understood import with_understood

    def tell(share: float, phase: str) -> None:
        progress.update(task, completed=share, description=phase)

    analysis = analyze_recordings(
        [one.recording for one in own],
        plate,
        held_out=[(name, one.recording) for name, one in tried],
        progress=tell,
    )
    return with_table(with_understood(analysis, [*own, *(one for _, one in tried)]))
