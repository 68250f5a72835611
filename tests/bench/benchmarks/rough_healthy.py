"""Healthy valves of all packings, at 1 and 20 ms: what the diagnosis says of them; right is that nothing is wrong.

The number after the name is that of the cases of each valve, packing, sequence and period. ``BENCH_FIRST_SEED`` draws
others.
"""

from __future__ import annotations

import os
from collections import Counter
from itertools import product
from typing import Final

from rich.table import Table

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import Verdict
from estimators.data_faults.found import without_data_faults
from estimators.engine.engine import RoughFrictionEstimator
from tests.bench.parallel import each
from tests.support.rough_valves import GRADES, SEQUENCES, VALVES, case

CASES: Final = 4
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "53000"))
PERIODS_S: Final = (1.0e-3, 2.0e-2)
_Drawn = tuple[str, float, str, str, int]


def told(one: _Drawn) -> tuple[str, float, Verdict]:
    """Return packing, period and what was said of this healthy valve."""
    grade, period_s, sequence, valve, seed = one
    made = case(valve, sequence, grade, period_s, seed)
    (recording,), _ = without_data_faults([made.recording], made.nameplate)
    said = diagnose(recording, made.nameplate, RoughFrictionEstimator().estimate(recording, made.nameplate))
    if said.verdict is not Verdict.NONE:
        print(f"{said.verdict:>14}  {grade} {valve} {sequence}, {1e3 * period_s:g} ms, {seed}: {said.message[:90]}")
    return grade, period_s, said.verdict


def run(count: int | None = None) -> Table:
    """Return the table: a line a packing and period."""
    seeds = range(FIRST_SEED, FIRST_SEED + (count or CASES))
    grades = [grade for grade in GRADES if grade != "ideal"]
    drawn: list[_Drawn] = list(product(grades, PERIODS_S, SEQUENCES, VALVES, seeds))
    counts = Counter(each(told, drawn, "healthy valves"))
    table = Table("packing", "rows", *(str(one) for one in Verdict), title="Healthy valves")
    for grade, period_s in product(grades, PERIODS_S):
        said = [counts[grade, period_s, verdict] for verdict in Verdict]
        table.add_row(grade, f"{1e3 * period_s:g} ms", *map(str, said))
    return table
