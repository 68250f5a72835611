"""An analysis in one screen of a terminal: the verdict, five lines, what was found of the data and of a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.shown.analysis_summary import summary_lines, verdict_lines
from service.words.plain_numbers import as_read
from valve.messages import say


def print_summary(console: Console, analysis: Mapping[str, Any]) -> None:
    """Print the verdict, friction, breakaway, spring, dead band and recording, and each note."""
    for sentence in verdict_lines(analysis):
        console.print(Text(as_read(sentence), style="bold"))
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column()
    for name, words in summary_lines(analysis):
        table.add_row(name, Text(as_read(words)))
    console.print(table)
    for note in analysis.get("notes", []):
        console.print(Text(as_read(say("note", "Note: {note}", note=note))))
    console.print(Text("--details shows every method, the signature and the diagnosis.", style="dim"))


def print_understood(console: Console, understood: Mapping[str, Any]) -> None:
    """Print what was understood of a file: each column with its unit and what was done to it."""
    table = Table(title=f"{understood['file']}: {understood['kind']}; {understood['rows']} rows", title_justify="left")
    for heading in ("read as", "column of the file", "unit", "how"):
        table.add_column(heading)
    for one in understood["columns"]:
        gaps = f"; {one['gaps']} gaps" if one["gaps"] and "gaps" not in one["how"] else ""
        table.add_row(one["column"], Text(one["header"]), Text(one["unit"]), Text(one["how"] + gaps))
    console.print(table)
    if understood["not_used"]:
        console.print(Text(say("columns_not_used", "Not used: {columns:, }", columns=tuple(understood["not_used"]))))
    for remark in understood["remarks"]:
        console.print(Text(remark))
