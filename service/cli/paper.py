"""``breakaway paper``: the paper's tables and figures, ours beside the printed values."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from service.cli.output import STANDARD_OUTPUT, require_writable, write_json


def paper(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the figures.")] = Path("paper"),
    json_file: Annotated[
        str | None, typer.Option("--json", metavar="FILE", help="Write the tables there as JSON; - prints them.")
    ] = None,
) -> None:
    """Reproduce Tables 2, 3 and 4 and Figures 1 to 5 of Romano & Garcia (2007)."""
    require_writable(json_file)
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    with Console(stderr=True).status("Computing the paper's tables and figures"):
        from service.paper.paper import reproduce_paper  # heavy: --help and wrong usage do without

        reproduction = reproduce_paper(out)
    reproduction.render(console)
    if json_file is not None:
        write_json(json_file, reproduction.to_json())
