"""Run all benchmarks, or those that are named, and print their tables."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Final

from rich.console import Console
from rich.table import Table

from tests.benchmarks import classic_methods, motion, simulator

BENCHMARKS: Final[dict[str, Callable[[], Table | list[Table]]]] = {
    "classic_methods": classic_methods.run,
    "motion": motion.run,
    "simulator": simulator.run,
}


def main(names: list[str]) -> int:
    """Print the tables of the benchmarks of these names, of all if there is none; 2 for an unknown name."""
    console = Console(width=None if sys.stdout.isatty() else 150)
    for name in names:
        if name not in BENCHMARKS:
            console.print(f"benchmark {name!r} is unknown: choose from {', '.join(BENCHMARKS)}")
            return 2
    for name in names or BENCHMARKS:
        tables = BENCHMARKS[name]()
        for table in tables if isinstance(tables, list) else [tables]:
            console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
