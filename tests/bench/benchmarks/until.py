"""Tests that end once they know enough: the time that saves, and whether the intervals of what was recorded hold.

Replayed from recordings of whole sequences: at each turning point of the command the quick estimate of the rows so far
is judged, as the service does it. Nothing that comes after the end is seen.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from rich.table import Table

from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from service.model.until import half_width_percent, is_met, until_words
from service.runs.live_estimates import turns_s
from service.runs.so_far import estimate_so_far
from tests.bench.parallel import each
from tests.support.rough_valves import DIAGNOSTIC, VALVES, RoughCase, case
from valve.recording import Recording

UNTIL: Final = {"F_s": 5.0, "F_c": 2.0}
SEQUENCES: Final = ("multi_rate", DIAGNOSTIC)
SEEDS: Final = 6
FIRST_SEED: Final = 100  # the seeds below it are for development
PERIOD_S: Final = 20.0e-3
VERDICT_S: Final = 0.2  # from the turn to the end of the motion: an estimate takes 0.02 to 0.1 s
BY_LIKELIHOOD: Final = 3  # seeds of each valve


@dataclass(frozen=True, slots=True)
class Ended:
    """One replayed test: share of its time that was saved, 0 where it was played to its end, and intervals that hold.

    ``holds`` and ``whole`` are by symbol, of the quick estimate of the rows up to the end and of the whole sequence;
    ``likelihood`` of maximum likelihood on the former, ``narrow`` whether that is as narrow as was asked.
    """

    is_met: bool
    saved: float
    holds: dict[str, bool]
    whole: dict[str, bool]
    likelihood: dict[str, bool]
    narrow: dict[str, bool]


def cut(recording: Recording, until_s: float) -> Recording:
    """Return the rows up to this time."""
    rows = int(np.searchsorted(recording.time_s, until_s, side="right"))
    names = ("time_s", "position_m", "pressure_pa", "command_pa")
    given: dict[str, Any] = {name: None if (one := getattr(recording, name)) is None else one[:rows] for name in names}
    return replace(recording, **given)


def _holds(entries: dict[str, tuple[float, float] | None], one: RoughCase) -> dict[str, bool]:
    truth = one.truth.parameters.by_symbol()
    return {name: found[0] <= truth[name] <= found[1] for name, found in entries.items() if found is not None}


def _quick(found: dict[str, object], one: RoughCase) -> dict[str, bool]:
    parameters = found["parameters"]
    assert isinstance(parameters, dict)
    return _holds({name: None if parameters[name] is None else tuple(parameters[name]["ci95"]) for name in UNTIL}, one)


def replayed(asked: tuple[str, str, int, bool]) -> Ended:
    """Return how one test ends."""
    valve, sequence, seed, by_likelihood = asked
    one = case(valve, sequence, "usual", PERIOD_S, seed)
    whole_s = one.waveform.duration_s
    rows, found = one.recording, estimate_so_far(one.recording, one.nameplate)
    whole, met, end_s = _quick(found, one), False, whole_s
    for turn_s in turns_s(one.waveform):
        so_far = cut(one.recording, turn_s)
        found = estimate_so_far(so_far, one.nameplate)
        if is_met(UNTIL, found):
            met, end_s = True, min(turn_s + VERDICT_S, whole_s)
            rows = cut(one.recording, end_s)
            found = estimate_so_far(rows, one.nameplate)
            break
    likelihood: dict[str, bool] = {}
    narrow: dict[str, bool] = {}
    if met and by_likelihood:
        estimate = MaximumLikelihoodEstimator().estimate(rows, one.nameplate)
        likelihood = _holds({name: estimate.parameters[name].ci95 for name in UNTIL}, one)
        shown = {name: {"value": entry.value, "ci95": entry.ci95} for name, entry in estimate.parameters.items()}
        narrow = {name: half_width_percent(shown[name]) <= most for name, most in UNTIL.items()}
    quick = _quick(found, one)
    return Ended(met, 1.0 - end_s / whole_s, quick if met else {}, whole if met else {}, likelihood, narrow)


def run(count: int | None) -> Table:
    """Return the table: ``count`` seeds of each valve."""
    seeds = range(FIRST_SEED, FIRST_SEED + (count or SEEDS))
    cases = [
        (valve, sequence, seed, seed - FIRST_SEED < BY_LIKELIHOOD)
        for sequence in SEQUENCES
        for valve in VALVES
        for seed in seeds
    ]
    found: dict[tuple[str, str], list[Ended]] = defaultdict(list)
    for (valve, sequence, _, _), one in zip(cases, each(replayed, cases, "until"), strict=True):
        found[sequence, valve].append(one)
        found[sequence, "all"].append(one)
    table = Table(
        title=f"Tests until {until_words(UNTIL)}: rows of {1e3 * PERIOD_S:g} ms, {len(seeds)} seeds each",
        caption="Intervals that hold of F_s and F_c: of the tests that ended early; whole: of the same, played on. "
        "Narrow: of likelihood, those as narrow as asked.",
        title_justify="left",
    )
    for heading in (
        "sequence",
        "valve",
        "met",
        "saved, all",
        "saved, met",
        "quick",
        "quick, whole",
        "likelihood",
        "narrow",
    ):
        table.add_column(heading, justify="left" if heading in {"sequence", "valve"} else "right")
    for (sequence, valve), own in sorted(found.items(), key=lambda item: (item[0][0], item[0][1] == "all")):
        met = [one for one in own if one.is_met]
        table.add_row(
            sequence,
            valve,
            f"{len(met)} of {len(own)}",
            f"{100.0 * np.mean([one.saved for one in own]):.0f} %",
            f"{100.0 * np.mean([one.saved for one in met]):.0f} %" if met else "-",
            *(_held([getattr(one, name) for one in met]) for name in ("holds", "whole", "likelihood", "narrow")),
            end_section=valve == "all",
        )
    return table


def _held(answers: list[dict[str, bool]]) -> str:
    """How many intervals hold of how many are given, F_s and F_c."""
    cells = []
    for symbol in UNTIL:
        given = [one[symbol] for one in answers if symbol in one]
        cells.append(f"{sum(given)}/{len(given)}")
    return ", ".join(cells)
