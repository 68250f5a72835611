"""The truth about a simulated record: a line that ``breakaway simulate`` says, and a line of JSON for programs."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from valve.parameters import PARAMETER_SYMBOLS

if TYPE_CHECKING:
    from simulator.samples import EndedRecord


@dataclass(frozen=True, slots=True)
class RecordTruth:
    """A record of a valve, simulated s, with every parameter by its symbol, and the scatter of F_s and F_c, SI."""

    tag: str
    from_s: float
    until_s: float
    parameters: dict[str, float]
    scatter: dict[str, float]

    @property
    def duration_s(self) -> float:
        """How long the record lasts, s."""
        return self.until_s - self.from_s

    def in_words(self) -> str:
        """Return it as one line."""
        values = ", ".join(
            f"{symbol} {value:.8g} {PARAMETER_SYMBOLS[symbol].unit}" for symbol, value in self.parameters.items()
        )
        scatter = ", ".join(f"{symbol} {value:.4g} N" for symbol, value in self.scatter.items())
        return (
            f"{self.tag}: truth of the record from {self.from_s:.1f} to {self.until_s:.1f} s: {values}; "
            f"scatter {scatter}"
        )


def record_truth(tag: str, ended: EndedRecord) -> RecordTruth:
    """Return what the valve of a record that has ended truly was."""
    truth = ended.truth
    scatter = {"F_s": truth.static_scatter_n, "F_c": truth.coulomb_spread_n}
    return RecordTruth(tag, ended.from_s, ended.until_s, truth.parameters.by_symbol(), scatter)


def write_truth(file: TextIO, truth: RecordTruth) -> None:
    """Add a truth to a file, as a line of JSON."""
    file.write(json.dumps(asdict(truth)) + "\n")
    file.flush()


def read_truths(path: Path) -> list[RecordTruth]:
    """Return the truths in a file that may still grow; none where there is no file yet."""
    try:
        whole, _, _ = path.read_text(encoding="utf-8").rpartition("\n")  # behind it a line is being written
    except FileNotFoundError:
        return []
    return [RecordTruth(**json.loads(line)) for line in whole.splitlines()]
