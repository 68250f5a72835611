"""How far each sequence would tell causes apart that one recording does not: the expected evidence in nats."""

from __future__ import annotations

from typing import Final

from rich.table import Table

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis
from discrepancy.rough.separating import ENOUGH, expected_nats
from estimators.engine.engine import RoughFrictionEstimator
from service.analysis.separating import find_separating_test, planned, room_of_recordings
from service.model.sequences import Room
from tests.support.rough_valves import RoughCase, case
from valve.effects import Effect, effect_from_values

SEED: Final = 1
VALVE: Final = "large"  # 60 mm, 1120 N, 207 N/mm
# What three triangles of 20 s do not tell from another cause.
EFFECTS: Final[tuple[Effect, ...]] = (
    effect_from_values("spring_hardening", {"hardening_n_per_m2": 3.4e5}),
    effect_from_values("friction_gradient", {"gradient_n_per_m": 8.0e3, "reference_m": 0.03}),
)


def run() -> list[Table]:
    """Diagnose each recording and weigh every sequence that its range of pressure allows."""
    return [_weighed(effect, case(VALVE, "triangle", "usual", seed=SEED, effects=[effect])) for effect in EFFECTS]


def _weighed(effect: Effect, made: RoughCase) -> Table:
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)
    found = diagnose(made.recording, made.nameplate, estimate)
    table = Table(title=f"{VALVE}, hidden {effect.cause}: {_told(found)}")
    for heading in ("sequence", "lasts s", "nats", ""):
        table.add_column(heading, justify="left" if heading in {"sequence", ""} else "right")
    room = room_of_recordings([made.recording])
    if found.undecided is None or room is None:
        return table
    chosen = find_separating_test(found.undecided, room)
    for one in planned(Room(**room)):
        nats = expected_nats(found.undecided, one.waveform)
        is_chosen = chosen is not None and (chosen.sequence, dict(chosen.overrides)) == (one.name, dict(one.overrides))
        said = "proposed" if is_chosen else "" if nats is not None and nats > ENOUGH else "too little to be proposed"
        table.add_row(one.name, f"{one.waveform.duration_s:.0f}", "-" if nats is None else f"{nats:.3g}", said)
    return table


def _told(found: RoughDiagnosis) -> str:
    names = [found.causes[0].cause, *found.not_told_apart_from] if found.causes else []
    return f"{found.verdict}, {' or '.join(names)}"
