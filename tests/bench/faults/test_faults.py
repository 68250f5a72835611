"""A part of the fault bench: each kind of fault at a transaction of a short test; `make long`: on both carriers."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Final

import pytest

from tests.bench.faults.bench import Case, run_case
from tests.bench.faults.cases import FAULTS, WAYS, possible, some_cases
from tests.bench.faults.judge import Verdict
from tests.bench.faults.wire_faults import FaultAt, ServiceFault, WireFault

_AT_ONCE: Final = 8  # a case mostly waits: for its waveform, for a watchdog


async def _verdicts(cases: list[Case], folder: Path) -> list[tuple[Case, Verdict]]:
    found: list[tuple[Case, Verdict]] = []
    waiting = iter(enumerate(cases))

    async def work() -> None:
        for number, case in waiting:
            place = folder / str(number)
            place.mkdir()
            found.append((case, (await run_case(case, place))[0]))

    await asyncio.gather(*(work() for _ in range(_AT_ONCE)))
    return found


async def test_without_a_fault_every_way_completes(quick_path: Path) -> None:
    verdicts = await _verdicts([Case(carrier, mode, None) for carrier, mode in WAYS], quick_path)
    assert [verdict.outcome for _, verdict in verdicts] == ["completed"] * len(WAYS), verdicts
    assert all(verdict.good for _, verdict in verdicts), verdicts


@pytest.mark.parametrize("rounds", [1, pytest.param(2, marks=pytest.mark.long)])
async def test_faults_spread_over_a_test_leave_no_valve_unsafe_and_no_sample_lost_or_wrong(
    quick_path: Path, rounds: int
) -> None:
    cases, missing = possible(some_cases(rounds * len(FAULTS), seed=7))
    verdicts = await _verdicts(cases, quick_path)
    bad = [(case, verdict) for case, verdict in verdicts if not verdict.good]
    assert bad == []
    met = {(case.fault.fault, case.carrier) for case, _ in verdicts if case.fault is not None}
    wanted = {fault for fault in FAULTS if fault not in missing}
    assert {fault for fault, _ in met} == wanted
    assert {carrier for _, carrier in met} == {carrier for carrier, _ in WAYS}
    assert rounds == 1 or len(met) == 2 * len(wanted)


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_a_service_that_is_killed_while_the_valve_moves_leaves_an_interrupted_test(
    quick_path: Path, mode: str
) -> None:
    case = Case("tcp", "polled" if mode == "polled" else "captured", FaultAt(ServiceFault.KILL_BOTH, 48))
    verdict, _ = await run_case(case, quick_path)
    assert verdict.good, verdict
    assert verdict.outcome == "interrupted"


async def test_a_service_that_was_frozen_beyond_the_watchdog_moves_nothing_when_it_wakes(quick_path: Path) -> None:
    verdict, _ = await run_case(Case("tcp", "polled", FaultAt(ServiceFault.STOP_AND_CONT, 48)), quick_path)
    assert verdict.good, verdict
    assert verdict.outcome == "failed"


async def test_a_black_hole_in_mid_motion_ends_the_test_and_the_watchdog_makes_the_valve_safe(
    quick_path: Path,
) -> None:
    verdict, _ = await run_case(Case("rtu", "polled", FaultAt(WireFault.BLACK_HOLE, 48)), quick_path)
    assert verdict.good, verdict
    assert verdict.outcome == "failed"
