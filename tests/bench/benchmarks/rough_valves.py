"""Rough valves: what the engine gives of valves whose friction scatters, whether it holds, and how long it takes.

Six valves a row, of the grades and sequences that ROUGH_GRADES and ROUGH_SEQUENCES name (commas between; all of them
otherwise), rows every ROUGH_PERIOD_S. The number after the name is that of the cases a valve. ``BENCH_FIRST_SEED``
draws others. Times are of the processor.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from rich.table import Table

from estimators.base import Status
from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.settings import USUAL, Settings
from tests.bench.parallel import each
from tests.support.rough_valves import SEQUENCES, VALVES, case

CASES: Final = 20
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "1000"))
GRADES: Final = tuple(os.environ.get("ROUGH_GRADES", "ideal,mild,usual,hard").split(","))
RUN_SEQUENCES: Final = tuple(os.environ.get("ROUGH_SEQUENCES", ",".join(SEQUENCES)).split(","))
PERIOD_S: Final = float(os.environ.get("ROUGH_PERIOD_S", "1e-3"))
SYMBOLS: Final = ("k", "F_c", "F_s", "F_0", "m", "F_v")
PERFECT_NOISE_M: Final = 20.0e-6  # of the ideal valves, as the perfect ones of the other benchmarks have


@dataclass(frozen=True, slots=True)
class Answer:
    """One case: for each symbol error, half width (% of the truth, F_0 of F_s) and whether it held, or None."""

    given: dict[str, tuple[float, float, bool] | None]
    status: str
    took_s: float


def answered(row: tuple[str, str], seed: int, settings: Settings = USUAL) -> list[Answer]:
    """Return the answers to all valves' cases of this grade, sequence and seed."""
    grade, sequence = row
    answers = []
    for valve in VALVES:
        changes: dict[str, Any] = {"position": {"noise_rms": PERFECT_NOISE_M}} if grade == "ideal" else {}
        made = case(valve, sequence, grade, PERIOD_S, seed, **changes)
        truth = made.truth.parameters.by_symbol()
        began_s = time.process_time()
        estimate = RoughFrictionEstimator(settings).estimate(made.recording, made.nameplate)
        took_s = time.process_time() - began_s
        given: dict[str, tuple[float, float, bool] | None] = {}
        for symbol in SYMBOLS:
            one = estimate.parameters[symbol]
            if one.value is None or one.ci95 is None:
                given[symbol] = None
                continue
            low, high = one.ci95
            scale = truth["F_s" if symbol == "F_0" else symbol]
            error = 100.0 * (one.value - truth[symbol]) / scale
            given[symbol] = (error, 50.0 * (high - low) / scale, low <= truth[symbol] <= high)
        answers.append(Answer(given, str(estimate.status), took_s))
    return answers


def run(count: int | None = None) -> Table:
    """Return the table: a line a grade, sequence and parameter."""
    seeds = range(FIRST_SEED, FIRST_SEED + (CASES if count is None else count))
    shown = Table(
        title=f"Rough valves: {len(seeds)} cases of each of {len(VALVES)} valves, rows every {1e3 * PERIOD_S:g} ms",
        caption="Errors and half widths: medians, in % of the truth, of F_0 in % of F_s. Wrong: status ok, and beyond "
        "twice the half width of its interval.",
        title_justify="left",
    )
    for heading in (
        "grade",
        "sequence",
        "parameter",
        "given",
        "held",
        "error",
        "half width",
        "ok and wrong",
        "median s",
        "worst s",
    ):
        shown.add_column(heading, justify="left" if heading in ("grade", "sequence", "parameter") else "right")
    for grade in GRADES:
        for sequence in RUN_SEQUENCES:
            # a partial can go to another process
            found = [one for many in each(partial(answered, (grade, sequence)), seeds, "rough valves") for one in many]
            for number, symbol in enumerate(SYMBOLS):
                shown.add_row(
                    *((grade, sequence) if number == 0 else ("", "")),
                    symbol,
                    *_line(found, symbol),
                    *_times(found, number == 0),
                    end_section=number == len(SYMBOLS) - 1,
                )
    return shown


def _line(found: list[Answer], symbol: str) -> list[str]:
    values = [one.given[symbol] for one in found]
    given = [value for value in values if value is not None]
    share = f"{100.0 * len(given) / max(1, len(found)):.0f} %"
    if not given:
        return [share, "-", "-", "-", "-"]
    wrong = 0
    for one in found:
        value = one.given[symbol]
        wrong += value is not None and one.status == Status.OK and abs(value[0]) > 2.0 * value[1]
    return [
        share,
        f"{100.0 * np.mean([value[2] for value in given]):.0f} %",
        f"{np.median([abs(value[0]) for value in given]):.2g}",
        f"{np.median([value[1] for value in given]):.2g}",
        f"{100.0 * wrong / len(found):.1f} %",
    ]


def _times(found: list[Answer], shown: bool) -> list[str]:
    if not shown:
        return ["", ""]
    times_s = [one.took_s for one in found]
    return [f"{np.median(times_s):.1f}", f"{np.max(times_s):.1f}"]
