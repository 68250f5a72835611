"""Ask for what is hidden in many recordings, and print how the answers do: ``make blind ARGS="..."``.

A name runs one kind of case, a number after it as many of them; a number alone as many of all kinds together, in the
usual proportions. ``--first SEED`` begins at another seed, ``--results FILE`` keeps and goes on with the results in
this file (else one for these very sources), ``--fresh`` begins it anew, ``--shown`` runs nothing and prints what is
kept, ``--ask NAME`` asks another than the product, ``--markdown`` prints tables that can go into a document.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from tests.bench.blind.diagnosers import DIAGNOSERS
from tests.bench.blind.kinds import KINDS
from tests.bench.blind.runs import Result, Run, kept_results, results_file, results_of
from tests.bench.blind.tables import tables


def planned(words: Sequence[str], first: int, diagnoser: str) -> list[Run]:
    """The runs that words ask for, kind after kind in turn so that a part of them is a sample of all.

    Raises ValueError for a word that is neither a kind nor a number.
    """
    counts: dict[str, int] = {}
    last = ""
    for word in words:
        if word in KINDS:
            last, counts[word] = word, KINDS[word].cases
        elif word.isdigit() and last:
            counts[last], last = int(word), ""
        elif word.isdigit() and not counts:
            whole = sum(kind.cases for kind in KINDS.values())
            counts = {name: max(1, round(int(word) * kind.cases / whole)) for name, kind in KINDS.items()}
        else:
            raise ValueError(f"{word!r} is no kind of case: choose from {', '.join(KINDS)}, or give a number")
    if not counts:
        counts = {name: kind.cases for name, kind in KINDS.items()}
    shares = [
        ((number + 0.5) / count, Run(kind, first + number, diagnoser))
        for kind, count in counts.items()
        for number in range(count)
    ]
    return [run for _, run in sorted(shares, key=lambda pair: pair[0])]


def main(arguments: list[str]) -> int:
    """Run what is asked for and print the tables; 2 for a word that means nothing."""
    parser = argparse.ArgumentParser(prog="make blind", description="\n".join(__doc__.splitlines()[:1]))
    parser.add_argument("words", nargs="*", metavar="KIND [NUMBER]", help=", ".join(KINDS))
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--results", type=Path, metavar="FILE")
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("--shown", action="store_true")
    parser.add_argument("--ask", choices=DIAGNOSERS, default="product")
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args(arguments)
    # a document's tables are as wide as they are
    console = Console(width=1000 if options.markdown else None if sys.stdout.isatty() else 220)
    try:
        runs = planned(options.words, options.first, options.ask)
    except ValueError as error:
        console.print(str(error))
        return 2
    file: Path = options.results or results_file(options.ask)
    if options.fresh:
        file.unlink(missing_ok=True)
    results = _results(runs, file, shown=options.shown)
    for table in tables(results):
        _print(console, table, markdown=options.markdown)
    console.print(f"{len(results)} results in {file}", soft_wrap=True)
    return 0


def _results(runs: list[Run], file: Path, *, shown: bool) -> list[Result]:
    if not shown:
        return results_of(runs, file)
    return sorted(kept_results(file).values(), key=lambda one: (list(KINDS).index(one.kind), one.seed))


def _print(console: Console, table: Table, *, markdown: bool) -> None:
    if not markdown:
        console.print(table)
        return
    title, caption, table.title, table.caption, table.box = table.title, table.caption, None, None, box.MARKDOWN
    console.print(f"**{title}**", soft_wrap=True)
    console.print(table)
    console.print(f"{caption or ''}\n", soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
