"""Loops without a stem position: which are told to have a sticking valve, by four methods on the same records.

Flow, level and temperature loops of ``tests.support.control_loops``, with a sticking valve and with what looks like
one. Each method is asked where the same detector saw an oscillation and the output keeps off its ends: the
cross-correlation of Horch (1999), Control Eng. Practice 7, 1221-1231; the curve fit of He, Wang, Pottmann & Qin (2007),
Ind. Eng. Chem. Res. 46, 4549-4560, as published, which is told what the process is; the relay fit of Rossi & Scali
(2005), J. Process Control 15, 505-513; and what the product does, ``estimators.loop_stiction``. The number after the
name is that of the loops of each kind and process.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from rich.table import Table
from scipy import signal

from estimators.loop_stiction.oscillation import HalfCycle
from estimators.loop_stiction.verdict import Answer, LoopVerdict, judged_loop
from tests.bench.parallel import each
from tests.support.control_loops import PROCESSES, ControlLoop, Kind, control_loop
from valve.errors import ValveError
from valve.recording import FloatArray

COUNT: Final = 10
FIRST_SEED: Final = int(os.environ.get("BENCH_FIRST_SEED", "3000"))
_HORCH: Final = (1.0 / 3.0, 2.0 / 3.0)  # below: even, not the valve; above: odd, the valve
_HE: Final = (0.4, 0.6)
_ROSSI: Final = (-0.21, 0.21)
_LAGS: Final = np.geomspace(0.02, 3.0, 25)  # time constants of the relay fit, half cycles
_MOST_HALVES: Final = 200

Case = tuple[str, Kind, int]


def by_horch(made: ControlLoop, found: LoopVerdict) -> Answer:
    """Odd cross-correlation of output and value: the valve; even: not. Not for integrating processes."""
    if made.process == "level" or found.oscillation is None:
        return Answer.CANNOT_TELL
    rows, period_s = found.rows, found.oscillation.period_s
    sections = signal.butter(2, 0.3 / period_s, "highpass", fs=1.0 / rows.period_s, output="sos")
    output, value = (signal.sosfiltfilt(sections, one) for one in (rows.output, rows.value))
    correlation = signal.correlate(value, output, method="fft")
    middle = output.size - 1
    changes = np.flatnonzero(np.signbit(correlation[1:]) != np.signbit(correlation[:-1]))
    before, after = changes[changes < middle], changes[changes >= middle]
    if before.size == 0 or after.size == 0:
        return Answer.CANNOT_TELL
    left, right = middle - before[-1], after[0] + 1 - middle
    about = correlation[before[-1] : after[0] + 2]
    best, here = about[np.abs(about).argmax()], correlation[middle]
    both = abs(left - right) / (left + right), abs(here - best) / max(abs(here + best), 1.0e-300)
    if min(both) > _HORCH[1]:
        return Answer.TEST_VALVE
    return Answer.NOT_THE_VALVE if max(both) < _HORCH[0] else Answer.CANNOT_TELL


def by_he(made: ControlLoop, found: LoopVerdict) -> Answer:
    """Triangle against sine, of the value where the process integrates, else of the output."""
    halves = _halves(found, "value" if made.process == "level" else "output")
    peaks = np.linspace(0.1, 0.9, 33)
    sine = sum(_least([np.sin(np.pi * one.place)], one) for one in halves)
    triangle = sum(
        _least([np.where(one.place < at, one.place / at, (1.0 - one.place) / (1.0 - at)) for at in peaks], one)
        for one in halves
    )
    return _by_index(sine / max(sine + triangle, 1.0e-300), _HE)


def by_rossi_scali(_made: ControlLoop, found: LoopVerdict) -> Answer:
    """Answer of a lag to a relay, or a triangle, against a sine, of the value."""
    halves = _halves(found, "value")
    sine = sum(_least([np.sin(np.pi * one.place)], one) for one in halves)
    relay = sum(
        _least([*(_relay(lag, one.place) for lag in _LAGS), 0.5 - np.abs(one.place - 0.5)], one) for one in halves
    )
    return _by_index((sine - relay) / max(sine + relay, 1.0e-300), _ROSSI)


def by_product(_made: ControlLoop, found: LoopVerdict) -> Answer:
    """What the product answers."""
    return found.answer


METHODS: Final[dict[str, Callable[[ControlLoop, LoopVerdict], Answer]]] = {
    "Horch": by_horch,
    "He, as published": by_he,
    "Rossi, Scali": by_rossi_scali,
    "product": by_product,
}


def _halves(found: LoopVerdict, which: str) -> Sequence[HalfCycle]:
    assert found.oscillation is not None
    halves = found.oscillation.value_halves if which == "value" else found.oscillation.output_halves
    return halves[:: max(1, -(-len(halves) // _MOST_HALVES))]


def _least(curves: Sequence[FloatArray], one: HalfCycle) -> float:
    """Mean square that the best multiple of the best curve leaves."""
    stack = np.stack(curves)
    along = (stack @ one.departure) ** 2 / (stack**2).sum(axis=1)
    return float((one.departure @ one.departure - along.max()) / one.departure.size)


def _relay(lag: float, place: FloatArray) -> FloatArray:
    """Half cycle of a first-order lag behind a relay: up from 0, switched where it comes back to 0 at 1."""
    switched = lag * np.log((1.0 + np.exp(1.0 / lag)) / 2.0)
    top = 1.0 - np.exp(-switched / lag)
    down = (top + 1.0) * np.exp(-np.maximum(place - switched, 0.0) / lag) - 1.0
    return np.where(place < switched, 1.0 - np.exp(-place / lag), down)


def _by_index(index: float, limits: tuple[float, float]) -> Answer:
    if index > limits[1]:
        return Answer.TEST_VALVE
    return Answer.NOT_THE_VALVE if index < limits[0] else Answer.CANNOT_TELL


def judge(case: Case) -> dict[str, Answer]:
    """Simulate a loop and return each method's answer."""
    made = control_loop(*case)
    try:
        found = judged_loop(made.time_s, made.output, made.value, made.setpoint, subject="the loop")
    except ValveError:
        return dict.fromkeys(METHODS, Answer.CANNOT_TELL)
    if found.oscillation is None:
        return dict.fromkeys(METHODS, found.answer)
    return {name: method(made, found) for name, method in METHODS.items()}


def run(count: int | None = None) -> list[Table]:
    """Return the table by kind of loop, and that by process."""
    seeds = range(FIRST_SEED, FIRST_SEED + (COUNT if count is None else count))
    cases = [(process, kind, seed) for kind in Kind for process in PROCESSES for seed in seeds]
    judged = dict(zip(cases, each(judge, cases, "loops"), strict=True))

    def line(table: Table, name: str, wanted: Callable[[Case], bool]) -> None:
        own = [found for case, found in judged.items() if wanted(case)]
        table.add_row(name, str(len(own)), *(_cell([one[method] for one in own]) for method in METHODS))

    usual = [kind for kind in Kind if not kind.sticks and kind is not Kind.TRIANGLE]
    by_kind, by_process = _table("by kind"), _table("by process")
    for kind in (kind for kind in Kind if kind.sticks):
        line(by_kind, kind, lambda case, kind=kind: case[1] is kind)  # type: ignore[misc]
    line(by_kind, "valve sticks, all", lambda case: case[1].sticks)
    by_kind.add_section()
    for kind in usual:
        line(by_kind, kind, lambda case, kind=kind: case[1] is kind)  # type: ignore[misc]
    line(by_kind, "valve in order, all", lambda case: case[1] in usual)
    by_kind.add_section()
    line(by_kind, Kind.TRIANGLE, lambda case: case[1] is Kind.TRIANGLE)
    for process in PROCESSES:
        line(by_process, f"{process}, sticks", lambda case, at=process: case[0] == at and case[1].sticks)  # type: ignore[misc]
        line(by_process, f"{process}, in order", lambda case, at=process: case[0] == at and case[1] in usual)  # type: ignore[misc]
    return [by_kind, by_process]


def _table(words: str) -> Table:
    table = Table(
        title=f'Loops without a stem position, {words}: "test this valve" / "not the valve" or "no oscillation" / '
        '"cannot tell"',
        title_justify="left",
    )
    table.add_column("loop")
    for heading in ("loops", *METHODS):
        table.add_column(heading, justify="right")
    return table


def _cell(answers: Sequence[Answer]) -> str:
    valve, unsure = answers.count(Answer.TEST_VALVE), answers.count(Answer.CANNOT_TELL)
    return f"{valve}/{len(answers) - valve - unsure}/{unsure}"
