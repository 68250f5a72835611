"""Run all benchmarks, or those that are named, and print their tables.

A number after a name makes a benchmark of many tests as long or as short as it says: ``coverage 100``.
``--markdown`` prints tables that can go into a document.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Final

from rich import box
from rich.console import Console
from rich.table import Table

from tests.bench.benchmarks import (
    ablation,
    classic_methods,
    classic_rough,
    coverage,
    demo,
    efficiency,
    extended_motion,
    in_service,
    live_view,
    load,
    loops,
    method_table,
    motion,
    night,
    random_valves,
    rough_diagnosis,
    rough_healthy,
    rough_motion,
    rough_pairs,
    rough_valves,
    separating,
    sequences,
    signature,
    simulator,
    stop_latency,
    stop_service,
    store,
    trends,
    until,
    watch,
)

BENCHMARKS: Final[dict[str, Callable[[], Table | list[Table]]]] = {
    "classic_methods": classic_methods.run,
    "demo": demo.run,
    "extended_motion": extended_motion.run,
    "motion": motion.run,
    "rough_motion": rough_motion.run,
    "separating": separating.run,
    "sequences": sequences.run,
    "simulator": simulator.run,
}

# These take the number of tests; without one they run as many as their figures are asked for.
COUNTED: Final[dict[str, Callable[[int | None], Table | list[Table]]]] = {
    "ablation": ablation.run,
    "classic_rough": classic_rough.run,
    "coverage": coverage.run,
    "efficiency": efficiency.run,
    "in_service": in_service.run,
    "live_view": live_view.run,
    "load": load.run,
    "loops": loops.run,
    "load_ordinary": partial(load.run, ordinary=True),
    "method_table": method_table.run,
    "night": night.run,
    "random_valves": random_valves.run,
    "rough_diagnosis": rough_diagnosis.run,
    "rough_healthy": rough_healthy.run,
    "rough_pairs": rough_pairs.run,
    "rough_valves": rough_valves.run,
    "signature": signature.run,
    "stop": stop_latency.run,
    "stop_service": stop_service.run,
    "store": store.run,
    "trends": trends.run,
    "until": until.run,
    "watch": watch.run,
}


def main(arguments: list[str]) -> int:
    """Print the tables of the benchmarks of these names, of all if there is none; 2 for an unknown name."""
    markdown = "--markdown" in arguments
    # a document's tables are as wide as they are
    console = Console(width=1000 if markdown else None if sys.stdout.isatty() else 150)
    asked: list[tuple[str, int | None]] = []
    for argument in arguments:
        if argument == "--markdown":
            continue
        if argument.isdigit() and asked and asked[-1][0] in COUNTED:
            asked[-1] = (asked[-1][0], int(argument))
        elif argument in BENCHMARKS or argument in COUNTED:
            asked.append((argument, None))
        else:
            names = f"{', '.join(BENCHMARKS)}, and with a number of tests {', '.join(COUNTED)}"
            console.print(f"benchmark {argument!r} is unknown: choose from {names}")
            return 2
    for name, count in asked or [(name, None) for name in (*BENCHMARKS, *COUNTED)]:
        tables = BENCHMARKS[name]() if name in BENCHMARKS else COUNTED[name](count)
        for table in tables if isinstance(tables, list) else [tables]:
            _print(console, table, markdown=markdown)
    return 0


def _print(console: Console, table: Table, *, markdown: bool) -> None:
    if not markdown:
        console.print(table)
        return
    title, caption, table.title, table.caption, table.box = table.title, table.caption, None, None, box.MARKDOWN
    for row in table.rows:
        row.end_section = False  # a line between sections would end the table
    console.print(f"**{title}**", soft_wrap=True)
    console.print(table)
    console.print(f"{caption or ''}\n", soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
