"""What each step of the engine gains: rough valves with all of them, and with one switched off at a time.

Grades, sequences, period and seeds as in the benchmark of rough valves (ROUGH_GRADES, ROUGH_SEQUENCES,
ROUGH_PERIOD_S, BENCH_FIRST_SEED); ABLATED names the steps to switch off (commas between), all of them otherwise.
"""

from __future__ import annotations

import os
from dataclasses import fields, replace
from functools import partial
from typing import Final

import numpy as np
from rich.table import Table

from estimators.base import Status
from estimators.engine.settings import USUAL, Settings
from tests.bench.benchmarks.rough_valves import FIRST_SEED, GRADES, PERIOD_S, RUN_SEQUENCES, Answer, answered
from tests.bench.parallel import each
from tests.support.rough_valves import VALVES

CASES: Final = 2
STEPS: Final = tuple(entry.name for entry in fields(Settings))
ABLATED: Final = tuple(filter(None, os.environ.get("ABLATED", "").split(","))) or STEPS
_FRICTION: Final = ("k", "F_c", "F_s", "F_0")
_DYNAMIC: Final = ("m", "F_v")


def run(count: int | None = None) -> Table:
    """Return the table: a line for the whole engine, and one for each step that it does without."""
    seeds = range(FIRST_SEED, FIRST_SEED + (CASES if count is None else count))
    rows = [(grade, sequence) for grade in GRADES for sequence in RUN_SEQUENCES]
    shown = Table(
        title=f"Ablation: {len(seeds)} cases of each of {len(VALVES)} valves, {', '.join(GRADES)}, rows every "
        f"{1e3 * PERIOD_S:g} ms",
        caption="Half widths: medians in % of the truth. Wrong: status ok, and beyond twice the half width.",
        title_justify="left",
    )
    shown.add_column("without")
    for heading in ("friction given", "held", "F_c half width", "m, F_v given", "held", "wrong", "median s", "worst s"):
        shown.add_column(heading, justify="right")
    for name in ("", *ABLATED):
        settings = replace(USUAL, **{name: False}) if name else USUAL
        found = [
            one
            for row in rows
            for many in each(partial(answered, row, settings=settings), seeds, name or "all steps")
            for one in many
        ]
        shown.add_row(name or "(all steps)", *_cells(found), end_section=not name)
    return shown


def _cells(found: list[Answer]) -> list[str]:
    cells = []
    for symbols in (_FRICTION, _DYNAMIC):
        given = [value for one in found for symbol in symbols if (value := one.given[symbol]) is not None]
        cells.append(f"{len(given)} of {len(symbols) * len(found)}")
        cells.append(f"{100.0 * np.mean([value[2] for value in given]):.0f} %" if given else "-")
        if symbols == _FRICTION:
            widths = [value[1] for one in found if (value := one.given["F_c"]) is not None]
            cells.append(f"{np.median(widths):.2g}" if widths else "-")
    wrong = sum(
        one.status == Status.OK and value is not None and abs(value[0]) > 2.0 * value[1]
        for one in found
        for value in one.given.values()
    )
    took_s = [one.took_s for one in found]
    return [*cells, str(wrong), f"{np.median(took_s):.1f}", f"{np.max(took_s):.1f}"]
