"""How the benchmarks take times: medians, or the least processor time, because the machine is shared."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def median_s(call: Callable[[], object], *, repeats: int = 31, at_most_s: float = 2.0) -> float:
    """Median duration of ``call``, s: of ``repeats`` runs after a first one, or of those within ``at_most_s``."""
    call()
    durations_s: list[float] = []
    while len(durations_s) < repeats and sum(durations_s) < at_most_s:
        started_s = time.perf_counter()
        call()
        durations_s.append(time.perf_counter() - started_s)
    return statistics.median(durations_s)


def least_cpu_s(call: Callable[[], object], *, repeats: int = 15) -> float:
    """Least processor time of ``call``, s, of ``repeats`` runs after a first one: what it takes undisturbed."""
    call()
    durations_s: list[float] = []
    for _ in range(repeats):
        started_s = time.process_time()
        call()
        durations_s.append(time.process_time() - started_s)
    return min(durations_s)


def shown(duration_s: float) -> str:
    """Return a duration with a unit that suits it."""
    if duration_s < 1.0e-3:
        return f"{1.0e6 * duration_s:.2g} us" if duration_s < 9.95e-5 else f"{1.0e6 * duration_s:.0f} us"
    return f"{1.0e3 * duration_s:.3g} ms" if duration_s < 1.0 else f"{duration_s:.3g} s"
