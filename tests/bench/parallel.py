"""Many cases on all cores, with a bar: the results come in the order of the cases."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

# Fewer than the cores: BENCH_PROCESSES=1 make bench ARGS=coverage
PROCESSES: Final = int(os.environ.get("BENCH_PROCESSES", "0")) or os.cpu_count() or 1

Case = TypeVar("Case")
Result = TypeVar("Result")


def each(function: Callable[[Case], Result], cases: Iterable[Case], label: str) -> list[Result]:
    """Return ``function`` of every case; it is a module's own function, so that another process finds it."""
    waiting = list(cases)
    # one thread of linear algebra a process: more only get in each other's way
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        if PROCESSES == 1:
            return [function(case) for case in bar.track(waiting)]
        with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
            return list(bar.track(pool.map(function, waiting, chunksize=4), total=len(waiting)))
