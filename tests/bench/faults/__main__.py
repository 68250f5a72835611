"""``make faults``: the long version, with progress and a table.

ARGS="500" runs so many by chance, ARGS="all" every fault at every transaction, ARGS="kill_both term" these alone,
ARGS="wire" those of the wire, ARGS="plant" those around it.

ARGS="10000 keep=faults.jsonl for=600" writes every verdict down, begins no case after
600 s and goes on from there when it is asked again. So it does after Ctrl-C or SIGTERM: the cases that run end first.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Final

from drivers.motion.bus_lock import FOLDER_VARIABLE
from tests.bench.faults.bench import Case, run_case, struck
from tests.bench.faults.cases import FAULTS, every_case, possible, some_cases
from tests.bench.faults.judge import Verdict
from tests.bench.faults.kept import KeptVerdicts, name_of
from tests.bench.faults.surroundings import drop_template
from tests.bench.faults.wire_faults import Fault, PlantFault, WireFault

_COUNTS: Final = tuple(field.name for field in fields(Verdict) if field.type == "int")
_OUTCOMES: Final = ("completed", "failed", "stopped", "interrupted", "refused", "silent")
_TOLD_EVERY: Final = 20


@dataclass(frozen=True, slots=True)
class _Asked:
    """What the arguments ask for; ``at_once``: a case mostly waits, for its waveform or for a watchdog."""

    cases: Sequence[Case]
    missing: Mapping[str, str]
    keep: Path | None = None
    for_s: float = float("inf")
    at_once: int = 6


def asked_for(words: Sequence[str]) -> _Asked:
    """Return what words ask for. Raises ValueError for one that is no fault, no number and no setting."""
    settings = dict(word.split("=", 1) for word in words if "=" in word)
    unknown = settings.keys() - {"keep", "for", "at_once"}
    if unknown:
        raise ValueError(f"{sorted(unknown)[0]!r} is no setting: choose from keep, for, at_once")
    return _Asked(
        *possible(_cases([word for word in words if "=" not in word])),
        Path(settings["keep"]) if "keep" in settings else None,
        float(settings.get("for", "inf")),
        int(settings.get("at_once", 6)),
    )


def _cases(words: list[str]) -> list[Case]:
    names: dict[str, list[Fault]] = {str(fault): [fault] for fault in FAULTS}
    names["wire"], names["plant"], names["all"] = list(WireFault), list(PlantFault), list(FAULTS)
    if all(word.isdigit() for word in words):
        count, seed = (*map(int, words), 1)[:2] if words else (200, 1)
        return list(islice(every_case(1 + count // 6000), count)) if count > 4000 else some_cases(count, seed)
    for word in words:
        if word not in names:
            raise ValueError(f"{word!r} is no fault: choose from {', '.join(names)}, or give a number")
    wanted = {fault for word in words for fault in names[word]}
    return [case for case in every_case() if case.fault is not None and case.fault.fault in wanted]


async def _run(asked: _Asked) -> int:
    kept = KeptVerdicts(asked.keep)
    waiting = iter([case for case in asked.cases if kept.of(case) is None])
    known = sum(kept.of(case) is not None for case in asked.cases)
    done, untried, began_s = 0, 0, time.monotonic()
    ending = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, ending.set)

    async def work() -> None:
        nonlocal done, untried
        for case in waiting:
            if ending.is_set() or time.monotonic() - began_s > asked.for_s:
                return
            with tempfile.TemporaryDirectory(prefix="breakaway-fault-") as folder:
                verdict, transactions = await run_case(case, Path(folder))
            done += 1
            if verdict.outcome == "refused" and verdict.good and not struck(case, transactions):
                untried += 1
            else:
                kept.add(case, verdict)
            if not verdict.good:
                print(f"BAD {name_of(case)}: {verdict} ({transactions} transactions)", flush=True)
            left = len(asked.cases) - known - done
            if done % _TOLD_EVERY == 0 or not left:
                bad = sum(not verdict.good for verdict in _verdicts(asked, kept))
                left_s = (time.monotonic() - began_s) / done * left
                print(f"{known + done} of {len(asked.cases)} faults, {bad} bad, {left_s:.0f} s left", flush=True)

    await asyncio.gather(*(work() for _ in range(asked.at_once)))
    _print(asked.cases, kept)
    for fault, reason in asked.missing.items():
        print(f"{fault} cannot be had here: {reason}")
    if untried:
        print(
            f"{untried} were refused before their fault came: this machine is too busy; ask for them again with keep="
        )
    return sum(not verdict.good for verdict in _verdicts(asked, kept))


def _verdicts(asked: _Asked, kept: KeptVerdicts) -> list[Verdict]:
    return [verdict for case in asked.cases if (verdict := kept.of(case)) is not None]


def _print(cases: Sequence[Case], kept: KeptVerdicts) -> None:
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        verdict = kept.of(case)
        if verdict is not None:
            row = table[str(case.fault.fault) if case.fault else "none"]
            row.update({"cases": 1, verdict.outcome: 1} | {name: getattr(verdict, name) for name in _COUNTS})
    columns = ("cases", *_OUTCOMES, *_COUNTS)
    total: Counter[str] = Counter()
    for row in table.values():
        total.update(row)
    print(f"{'fault':18s}" + "".join(f"{name:>15s}" for name in columns))
    for fault, row in [*sorted(table.items()), ("all", total)]:
        print(f"{fault:18s}" + "".join(f"{row[name]:15d}" for name in columns))


def main() -> int:
    """Run what the arguments ask for; 1 where a verdict is bad, 2 for a word that means nothing."""
    try:
        asked = asked_for(sys.argv[1:])
    except ValueError as error:
        print(error)
        return 2
    return 1 if asyncio.run(_run(asked)) else 0


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="breakaway-locks-") as locks:
        os.environ[FOLDER_VARIABLE] = locks
        found = main()
        drop_template()
    sys.exit(found)
