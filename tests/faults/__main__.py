"""``make faults``: the long version, with progress and a table.

ARGS="500" runs so many by chance, ARGS="all" every fault at every transaction, ARGS="kill term" these at every one.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
import time
from collections import Counter, defaultdict
from itertools import islice
from pathlib import Path
from typing import Final

from service.bus_lock import FOLDER_VARIABLE
from tests.faults.bench import Case, run_case
from tests.faults.cases import FAULTS, every_case, some_cases
from tests.faults.judge import Verdict

_AT_ONCE: Final = 6  # a case mostly waits: for its waveform, for a watchdog
_COUNTS: Final = ("unsafe", "unreported", "lost_samples", "wrong_values", "late_writes", "doubled_writes")


async def _run(cases: list[Case]) -> int:
    table: dict[str, Counter[str]] = defaultdict(Counter)
    waiting = iter(cases)
    done, bad, began_s = 0, 0, time.monotonic()

    async def work() -> None:
        nonlocal done, bad
        for case in waiting:
            with tempfile.TemporaryDirectory(prefix="breakaway-fault-") as folder:
                verdict, transactions = await run_case(case, Path(folder))
            done += 1
            bad += not verdict.good
            _note(table, case, verdict)
            if not verdict.good:
                print(
                    f"BAD {case.carrier} {case.mode} {case.fault}: {verdict} ({transactions} transactions)", flush=True
                )
            if done % 20 == 0 or done == len(cases):
                each_s = (time.monotonic() - began_s) / done
                print(
                    f"{done} of {len(cases)} faults, {bad} bad, {each_s * (len(cases) - done):.0f} s left", flush=True
                )

    await asyncio.gather(*(work() for _ in range(_AT_ONCE)))
    _print(table)
    return bad


def _note(table: dict[str, Counter[str]], case: Case, verdict: Verdict) -> None:
    row = table[f"{case.fault.fault if case.fault else 'none'}"]
    row["cases"] += 1
    row[verdict.outcome] += 1
    for name in _COUNTS:
        row[name] += getattr(verdict, name)


def _print(table: dict[str, Counter[str]]) -> None:
    outcomes = ("completed", "failed", "stopped", "interrupted", "refused", "silent")
    columns = ("cases", *outcomes, *_COUNTS)
    print(f"{'fault':18s}" + "".join(f"{name:>15s}" for name in columns))
    total: Counter[str] = Counter()
    for fault, row in sorted(table.items()):
        print(f"{fault:18s}" + "".join(f"{row[name]:15d}" for name in columns))
        total += row
    print(f"{'all':18s}" + "".join(f"{total[name]:15d}" for name in columns))


def _wanted(words: list[str]) -> list[Case]:
    """Return the cases that words ask for. Raises ValueError for a word that is no fault and no number."""
    names = {str(fault): fault for fault in FAULTS}
    if words == ["all"]:
        return list(every_case())
    if all(word.isdigit() for word in words):
        count, seed = (*map(int, words), 1)[:2] if words else (200, 1)
        return list(islice(every_case(1 + count // 6000), count)) if count > 4000 else some_cases(count, seed)
    for word in words:
        if word not in names:
            raise ValueError(f"{word!r} is no fault: choose from {', '.join(names)}, all, or give a number")
    return [case for case in every_case() if case.fault is not None and str(case.fault.fault) in words]


def main() -> int:
    """Run what the arguments ask for; 1 where a verdict is bad, 2 for a word that means nothing."""
    try:
        cases = _wanted(sys.argv[1:])
    except ValueError as error:
        print(error)
        return 2
    return 1 if asyncio.run(_run(cases)) else 0


if __name__ == "__main__":
    import os

    os.environ[FOLDER_VARIABLE] = tempfile.mkdtemp(prefix="breakaway-locks-")
    sys.exit(main())
