"""Two causes at once, hidden in one valve with usual packing: both named, one of them, or one that is not there.

The number after the name is that of the pairs that are drawn. Those do not count of which one is not strong, or hides
the other (a stem that another spring keeps from a stop). ``BENCH_FIRST_SEED`` draws others.
"""

from __future__ import annotations

import os
from collections import Counter
from typing import Final

import numpy as np
from rich.table import Table

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import Verdict
from estimators.data_faults.found import without_data_faults
from estimators.engine.engine import RoughFrictionEstimator
from tests.bench.benchmarks.rough_diagnosis import HIDDEN, RESTING, hidden_case, misfit_n, moved_n
from tests.bench.parallel import each
from tests.support.rough_valves import DIAGNOSTIC, SEQUENCES, VALVES, case

PAIRS: Final = 60
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "62000"))
KINDS: Final = ("both", "one", "none", "one, and a wrong one", "a wrong one")
_WANTED: Final = 15.0
_LEAST: Final = 8.0
_LEAST_BESIDE: Final = 4.0  # of each beside the other


def told(seed: int) -> str | None:
    """Return what was said of the pair of this number, one of KINDS; None where it does not count."""
    rng = np.random.default_rng(seed)
    valve = str(rng.choice(list(VALVES)))
    hidden = [str(one) for one in rng.choice(HIDDEN, 2, replace=False)]
    sequence = DIAGNOSTIC if set(hidden) & set(RESTING) else str(rng.choice(SEQUENCES))
    alone = [hidden_case((cause, valve, sequence, "usual"), seed, _WANTED) for cause in hidden]
    strong = [one for one in alone if one is not None and one[1] >= _LEAST]
    if len(strong) < len(hidden):
        return None
    effects = [effect for one, _ in strong for effect in one.settings.effects]
    made = case(valve, sequence, "usual", seed=seed, effects=effects)
    usual_n = misfit_n(case(valve, sequence, "usual", seed=seed))
    if usual_n is None or min(moved_n(made, one) for one, _ in strong) < _LEAST_BESIDE * usual_n:
        return None
    (recording,), _ = without_data_faults([made.recording], made.nameplate)
    said = diagnose(recording, made.nameplate, RoughFrictionEstimator().estimate(recording, made.nameplate))
    names = {one.cause for one in said.causes}
    right = set(hidden) & (names | set(said.not_told_apart_from))
    # of a set one is right, of a name each
    wrong = not right if said.verdict is Verdict.AMBIGUOUS else bool(names - set(hidden))
    kind = "both" if len(right) == len(hidden) and not wrong else "one" if right else "none"
    if wrong and names:
        kind = "one, and a wrong one" if right else "a wrong one"
    print(f"{kind:>20}  {valve} {sequence}, {' + '.join(hidden)}: {said.verdict} {', '.join(sorted(names)) or '-'}")
    return kind


def run(count: int | None = None) -> Table:
    """Return the table: how many pairs count, and what was said of them."""
    found = [one for one in each(told, range(FIRST_SEED, FIRST_SEED + (count or PAIRS)), "pairs") if one is not None]
    counts = Counter(found)
    table = Table("pairs", *KINDS, title="Two causes at once in usual valves, each of strength above 8")
    table.add_row(str(len(found)), *(str(counts[kind]) for kind in KINDS))
    return table
