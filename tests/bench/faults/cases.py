"""Which faults at which transactions: every one, or a part that still meets each kind on each carrier."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator
from typing import Final

from tests.bench.faults.bench import Case
from tests.bench.faults.station import Carrier, Mode
from tests.bench.faults.surroundings import why_not
from tests.bench.faults.wire_faults import Fault, FaultAt, PlantFault, ServiceFault, WireFault

WAYS: Final[tuple[tuple[Carrier, Mode], ...]] = (
    ("tcp", "polled"),
    ("tcp", "captured"),
    ("rtu", "polled"),
    ("rtu", "captured"),
)
#: Transactions of the short test, from the first look at the device to the release; measured, and a few more.
TRANSACTIONS: Final = 100
_TURNS: Final = (0, 2, 1, 3)  # two rounds meet each kind on both carriers, four on every way
FAULTS: Final[tuple[Fault, ...]] = (*ServiceFault, *WireFault, *PlantFault)
#: A gauge of its own is polled: what a device captures, it measures itself.
_POLLED_ONLY: Final = frozenset({PlantFault.DEAD_GAUGE})


def every_case(rounds: int = 1) -> Iterator[Case]:
    """Every fault at every transaction on every way, ``rounds`` times with other bits and cuts.

    The ways take turns: the first quarter meets each fault at each transaction once.
    """
    for seed in range(rounds):
        for turn in range(len(WAYS)):
            for index in range(TRANSACTIONS):
                for number, fault in enumerate(FAULTS):
                    carrier, mode = _way(fault, number + index + turn)
                    yield Case(carrier, mode, FaultAt(fault, index, seed=1000 * seed + index))


def some_cases(count: int, seed: int) -> list[Case]:
    """A part: the kinds and the ways in turn, at transactions by chance."""
    chance = random.Random(seed)
    cases = []
    for number in range(count):
        round_number, kind = divmod(number, len(FAULTS))
        fault = FAULTS[kind]
        carrier, mode = _way(fault, kind + _TURNS[round_number % len(WAYS)])
        index = int(chance.random() * 85)  # the last ones of a test may fall away with its pace
        cases.append(Case(carrier, mode, FaultAt(fault, index, seed=seed + number)))
    return cases


def _way(fault: Fault, turn: int) -> tuple[Carrier, Mode]:
    carrier, mode = WAYS[turn % len(WAYS)]
    return carrier, "polled" if fault in _POLLED_ONLY else mode


def possible(cases: Iterable[Case]) -> tuple[list[Case], dict[str, str]]:
    """Return the cases that this machine can have, and why it cannot have the others, by fault."""
    missing = {fault.value: reason for fault in PlantFault if (reason := why_not(fault))}
    return [case for case in cases if case.fault is None or case.fault.fault.value not in missing], missing
