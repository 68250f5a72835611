"""``breakaway analyze``: parameters of recordings that exist already, with no service and no device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from service.cli.analysis_tables import print_analysis
from service.cli.held_out import HeldOutCommand
from service.cli.output import STANDARD_OUTPUT, require_writable, write_json
from service.cli.report import require_report_name, write_report

COMMAND_CLASS = HeldOutCommand


def analyze(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING", help="CSV or Parquet files, SI units.", show_default=False)
    ],
    nameplate: Annotated[
        Path, typer.Option("--nameplate", metavar="FILE", help="The valve's nameplate, TOML.", show_default=False)
    ],
    held_out: Annotated[
        list[Path] | None,
        typer.Option(
            "--held-out", metavar="RECORDING...", help="Recordings to try the estimates on; they are not fitted."
        ),
    ] = None,
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE", help="Write the analysis object there; - prints it.")
    ] = None,
    report_file: Annotated[
        str | None, typer.Option("--report", metavar="FILE", help="Write the report there: x.pdf or x.html.")
    ] = None,
) -> None:
    """Estimate a valve's parameters from recordings by three methods, with intervals, and say what is wrong with it."""
    require_writable(json_file)
    require_report_name(report_file)
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=30), TimeElapsedColumn())
    screen = Console(stderr=True)
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as progress:
        task = progress.add_task("reading", total=1.0)
        analysis = _analysis(recordings, nameplate, held_out or [], progress, task)
    print_analysis(console, analysis)
    if json_file is not None:
        write_json(json_file, analysis)
    if report_file is not None:
        write_report(report_file, recordings, nameplate, analysis)


def _analysis(
    recordings: list[Path], nameplate: Path, held_out: list[Path], progress: Progress, task: TaskID
) -> dict[str, Any]:
    # heavy imports stand here: --help and wrong usage do without
    from service.nameplates import read_nameplate
    from valve.recording_files import read_recording

    # all input is read, and refused where it is wrong, before the estimators are loaded
    plate = read_nameplate(nameplate)
    read = [read_recording(path, plate) for path in recordings]
    tried = [(path.name, read_recording(path, plate)) for path in held_out]
    progress.update(task, description="loading the estimators")

    from service.analysis import analyze_recordings

    def tell(share: float, phase: str) -> None:
        progress.update(task, completed=share, description=phase)

    return analyze_recordings(read, plate, held_out=tried, progress=tell)
