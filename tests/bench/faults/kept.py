"""What a long run has found so far, in a file: one that was ended goes on where it was."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from tests.bench.faults.bench import Case
from tests.bench.faults.judge import Verdict


def name_of(case: Case) -> str:
    """Return what tells a case from every other one."""
    fault = case.fault
    return f"{case.carrier} {case.mode} " + ("none" if fault is None else f"{fault.fault} {fault.index} {fault.seed}")


class KeptVerdicts:
    """Verdicts by case, each a line of JSON that is on disk as soon as it is known; without a file nothing is kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._known: dict[str, Verdict] = {}
        if path is None or not path.exists():
            return
        text = path.read_text(encoding="utf-8")
        for line in text.splitlines():
            if line.endswith("}"):  # the last one may be half written
                kept = json.loads(line)
                name = kept.pop("case")
                self._known[name] = Verdict(**kept)
        if text and not text.endswith("\n"):
            path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")

    def of(self, case: Case) -> Verdict | None:
        """Return a case's verdict, None where it has none yet."""
        return self._known.get(name_of(case))

    def add(self, case: Case, verdict: Verdict) -> None:
        """Keep a verdict."""
        self._known[name_of(case)] = verdict
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"case": name_of(case), **asdict(verdict)}) + "\n")
