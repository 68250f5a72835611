"""How far each sequence would tell causes apart that one recording does not: the expected discrimination."""

from __future__ import annotations

import math
from typing import Final

from rich.table import Table

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Diagnosis, Verdict
from discrepancy.separating import ENOUGH, expected_discrimination
from service.runs.sequences import Room
from service.separating import find_separating_test, planned, room_of_recordings
from tests.discrepancy.hidden import Hidden, hidden
from valve.effects import Effect, effect_from_values

SEED: Final = 1
# What two equal triangles of 12 s with 20 um of noise do not tell from another cause.
CASES: Final[tuple[tuple[str, Effect], ...]] = (
    ("vendor", effect_from_values("spring_hardening", {"hardening_n_per_m2": 4000.0})),
    ("vendor", effect_from_values("friction_gradient", {"gradient_n_per_m": 8.76, "reference_m": 0.0508})),
    ("vendor", effect_from_values("diaphragm_area_change", {"slope_per_m": -0.0394, "reference_m": 0.0508})),
)


def run() -> list[Table]:
    """Diagnose each recording and weigh every sequence that its range of pressure allows."""
    return [_weighed(name, effect, hidden(name, effect, seed=SEED)) for name, effect in CASES]


def _weighed(name: str, effect: Effect, case: Hidden) -> Table:
    found = diagnose([case.recording], case.nameplate)
    table = Table(title=f"{name}, hidden {effect.cause}: {_told(found)}")
    for heading in ("sequence", "lasts s", "discrimination", "standard deviations", ""):
        table.add_column(heading, justify="left" if heading in {"sequence", ""} else "right")
    room = room_of_recordings([case.recording])
    if found.verdict is not Verdict.AMBIGUOUS or found.extended is None or room is None:
        return table
    chosen = find_separating_test(found, room)
    for one in planned(Room(**room)):
        discrimination = expected_discrimination(found.extended, found.rival_fits, one.waveform)
        is_chosen = chosen is not None and (chosen.sequence, dict(chosen.overrides)) == (one.name, dict(one.overrides))
        table.add_row(
            one.name,
            f"{one.waveform.duration_s:.0f}",
            f"{discrimination:.3g}",
            f"{math.sqrt(discrimination):.1f}",
            "proposed" if is_chosen else "too little to be proposed" if discrimination < ENOUGH else "",
        )
    return table


def _told(found: Diagnosis) -> str:
    names = [found.causes[0].cause, *found.not_told_apart_from] if found.causes else []
    return f"{found.verdict}, {' or '.join(names)}"
