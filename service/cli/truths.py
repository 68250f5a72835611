"""The truth about a simulated record in a line of text, and back: what ``breakaway simulate`` says after each test."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from valve.parameters import PARAMETER_SYMBOLS

if TYPE_CHECKING:
    from simulator.samples import EndedRecord

_LINE: Final = re.compile(
    r"^(?P<tag>\S.*): truth of the record from (?P<begin>\S+) to (?P<end>\S+) s: "
    r"(?P<values>.*); scatter (?P<scatter>.*)$"
)
_VALUE: Final = re.compile(r"(\w+) ([-+0-9.e]+)")


@dataclass(frozen=True, slots=True)
class ToldTruth:
    """What a line says: every parameter by its symbol, and the scatter of F_s and F_c, SI."""

    tag: str
    duration_s: float
    parameters: dict[str, float]
    scatter: dict[str, float]


def truth_line(tag: str, ended: EndedRecord) -> str:
    """Return the truth of one record as one line."""
    truth = ended.truth
    values = ", ".join(
        f"{symbol} {value:.8g} {PARAMETER_SYMBOLS[symbol].unit}"
        for symbol, value in truth.parameters.by_symbol().items()
    )
    scatter = f"F_s {truth.static_scatter_n:.4g} N, F_c {truth.coulomb_spread_n:.4g} N"
    return f"{tag}: truth of the record from {ended.from_s:.1f} to {ended.until_s:.1f} s: {values}; scatter {scatter}"


def told_truth(line: str) -> ToldTruth | None:
    """Return what such a line says; None for any other line."""
    found = _LINE.match(line)
    if found is None:
        return None
    values, scatter = (
        {symbol: float(value) for symbol, value in _VALUE.findall(found[name])} for name in ("values", "scatter")
    )
    return ToldTruth(found["tag"], float(found["end"]) - float(found["begin"]), values, scatter)
