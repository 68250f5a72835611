"""The kinds of blind cases: what is run, what is written down, what is hidden, and how many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from tests.bench.blind.oddities import ODDITIES
from tests.bench.blind.strengths import OTHER_LAWS, STRENGTHS, Acquired, Expected, expected


@dataclass(frozen=True, slots=True)
class Kind:
    """A group of cases: what is run, what is written down, and how many causes of which are hidden."""

    name: str
    waveforms: tuple[tuple[str, ...], ...]  # one of these is drawn; each is the recordings of one case
    acquired: tuple[Acquired, ...]
    causes: tuple[str, ...] = ()
    hidden: int = 1
    bench_set_known: bool = True
    other_laws: bool = False  # of another form than the usual one
    cases: int = 100  # without a number given
    meaning: str = ""


def _named(waveforms: tuple[str, ...], acquired: Acquired) -> tuple[str, ...]:
    """Causes that such a recording can show for what they are."""
    if acquired is Acquired.FORCE:
        return tuple(cause for cause, hidden in STRENGTHS.items() if hidden.springless)
    return tuple(cause for cause in STRENGTHS if expected(cause, waveforms, acquired) is Expected.NAMED)


_TRIANGLE, _DIAGNOSTIC = ("triangle",), ("diagnostic",)
_ALL: Final = (_TRIANGLE, _DIAGNOSTIC)
_FIELD: Final = (Acquired.CAPTURED, Acquired.GAUGED, Acquired.COMMAND, Acquired.POLLED)

KINDS: Final[dict[str, Kind]] = {
    kind.name: kind
    for kind in (
        Kind(
            "triangle", (_TRIANGLE,), (Acquired.CAPTURED,), _named(_TRIANGLE, Acquired.CAPTURED), cases=500,
            meaning="paper's triangle, 1 ms, measured pressure: causes that it can show",
        ),
        Kind(
            "other_law", (_TRIANGLE,), (Acquired.CAPTURED,), tuple(OTHER_LAWS), other_laws=True, cases=60,
            meaning="as triangle, causes that obey another law than the usual one",
        ),
        Kind(
            "hidden", (_TRIANGLE,), (Acquired.CAPTURED,),
            ("position_gain", "position_backlash", "dwell_dependent_breakaway"), cases=60,
            meaning="paper's triangle: causes that it can hardly show",
        ),
        Kind(
            "no_bench_set", (_TRIANGLE,), (Acquired.CAPTURED,), ("friction_asymmetry", "spring_preload"),
            bench_set_known=False, cases=40, meaning="paper's triangle, nameplate without bench set",
        ),
        Kind(
            "diagnostic", (_DIAGNOSTIC,), (Acquired.CAPTURED,), _named(_DIAGNOSTIC, Acquired.CAPTURED), cases=200,
            meaning="two rates, dwells and small loops, 1 ms, measured pressure",
        ),
        Kind(
            "together", (("triangle", "dwells", "small_loops"),), (Acquired.CAPTURED,),
            _named(_DIAGNOSTIC, Acquired.CAPTURED), cases=50, meaning="three recordings of one valve, read together",
        ),
        Kind(
            "pair", _ALL, (Acquired.CAPTURED,), _named(_TRIANGLE, Acquired.CAPTURED), hidden=2, cases=150,
            meaning="two causes at once, triangle or diagnostic sequence",
        ),
        Kind(
            "gauged", _ALL, (Acquired.GAUGED,), _named(_TRIANGLE, Acquired.GAUGED), cases=100,
            meaning="as triangle, with a noisy gauge",
        ),
        Kind(
            "command", _ALL, (Acquired.COMMAND,), _named(_TRIANGLE, Acquired.COMMAND), cases=150,
            meaning="1 ms, the command alone",
        ),
        Kind(
            "polled", _ALL, (Acquired.POLLED,), _named(_TRIANGLE, Acquired.POLLED), cases=150,
            meaning="every 20 ms with jitter and gaps",
        ),
        Kind(
            "force", (("two_rates",),), (Acquired.FORCE,), _named(("two_rates",), Acquired.FORCE), cases=40,
            meaning="measured force on a drive without a spring",
        ),
        Kind("healthy", _ALL, _FIELD, cases=300, hidden=0, meaning="nothing hidden, any sequence and channels"),
        Kind("odd", _ALL, (Acquired.CAPTURED,), ODDITIES, cases=100, meaning="what is in no catalogue"),
    )
}  # fmt: skip
