"""Effects hidden in valves with usual packing and in ideal ones, and asked for: right, in a set, none, wrong.

The strength of an effect is the misfit of the best valve without it, over the same figure of the healthy valve.
"""

from __future__ import annotations

import time
import zlib
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from rich.table import Table

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.evidence import problem_of, solved
from discrepancy.rough.observations import observations
from discrepancy.rough.result import RoughDiagnosis, Verdict
from discrepancy.rough.setting import setting_of
from estimators.base import Outcome
from estimators.data_faults.found import without_data_faults
from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.lateness import lag_after_corners
from estimators.engine.reading import read
from tests.bench.blind.strengths import STRENGTHS, Swept
from tests.bench.parallel import each
from tests.support.rough_valves import DIAGNOSTIC, SEQUENCES, VALVES, RoughCase, case
from valve.effects import ValveScale
from valve.effects.base import Effect

NONE: Final = "nothing"
# Those that a test with a measured pressure can show; what is missing moves nothing there, or only at other sequences.
HIDDEN: Final = (
    "friction_asymmetry",
    "friction_gradient",
    "friction_drift",
    "local_friction",
    "pressure_dependent_friction",
    "stribeck_friction",
    "spring_preload",
    "spring_hardening",
    "dual_rate_spring",
    "diaphragm_area_change",
    "flow_force",
    "position_nonlinearity",
    "travel_stop_low",
    "travel_stop_high",
    "position_backlash",
    "position_lag",
    "dwell_dependent_breakaway",
)
RESTING: Final = ("position_backlash", "dwell_dependent_breakaway")  # which only a test with rests shows
_STRENGTHS: Final = (3.0, 40.0)
_TRIES: Final = 5
_TAKEN_UP: Final = (
    "spring_preload",
    "friction_asymmetry",
    "travel_stop_low",
    "travel_stop_high",
    "position_backlash",
    "position_lag",
    "dwell_dependent_breakaway",
)
_MOVED: Final = 0.02  # of the way that it goes
_CLASSES: Final = ((0.0, 3.0), (3.0, 10.0), (10.0, 1.0e9))


@dataclass(frozen=True, slots=True)
class Told:
    """One case: what was hidden and how strong, what was said, and how long it took."""

    hidden: str
    grade: str
    valve: str
    sequence: str
    strength: float
    said: RoughDiagnosis
    duration_s: float
    estimate_s: float

    @property
    def kind(self) -> str:
        """Right, set, none or wrong; of a healthy valve: none, unexplained or named."""
        names = [one.cause for one in self.said.causes]
        if self.said.verdict is Verdict.NOT_ASSESSED:
            return "cannot tell"
        if self.hidden == NONE:
            return "wrong" if names else str(self.said.verdict)
        if not names:
            return str(self.said.verdict)
        whole = [*names, *self.said.not_told_apart_from]
        if self.hidden not in whole:
            return "wrong"
        if self.said.verdict is Verdict.AMBIGUOUS:
            return "set" if len(whole) <= 3 else "large set"
        return "right" if len(names) == 1 else "right and more"


_LARGE: Final = {"position_lag": (5.0, 20.0), "spring_preload": (3.0, 15.0), "friction_asymmetry": (3.0, 10.0)}


def _swept(valve: str) -> Swept:
    parameters, nameplate = VALVES[valve]
    assert nameplate.signal is not None
    assert nameplate.actuator.diaphragm_area_m2 is not None
    travel_m = nameplate.actuator.travel_m
    full_n = nameplate.signal.range_pa[1] * nameplate.actuator.diaphragm_area_m2
    scale = ValveScale.of(parameters, travel_m, full_n)
    spring, friction_n = parameters.spring_rate_n_per_m, parameters.coulomb_friction_n
    assert nameplate.actuator.bench_set_pa is not None
    low_n = nameplate.actuator.bench_set_pa[0] * nameplate.actuator.diaphragm_area_m2
    # friction keeps the stem from both ends
    low_m = max((low_n - parameters.preload_n + friction_n) / spring, 0.0)
    high_m = min((full_n - parameters.preload_n - friction_n) / spring, travel_m)
    return Swept(low_m, high_m, high_m / 10.0, 60.0, scale)


def misfit_n(one: RoughCase) -> float | None:
    """Root mean square of what the best valve without any cause leaves, N; None where it cannot be read."""
    reading = read(one.recording, one.nameplate)
    if isinstance(reading, Outcome) or len(reading.segmentation.directions) < 2:
        return None
    lag = lag_after_corners(reading)
    rows = observations(reading, lag)
    if int(rows.is_slide.sum()) < 12:
        return None
    problem = problem_of(rows, setting_of(rows, reading, one.nameplate), lag)
    # white residuals: so small fields that the mean law is fitted alone
    plain = problem.medians - np.array([6.0, 6.0, 0.0, 6.0, 0.0, -2.0, 0.0])
    left_n = solved(problem, problem.no_columns, plain).left_n
    weight = np.where(rows.is_slide, rows.duration_s, float(np.median(rows.duration_s[rows.is_slide])))
    return float(np.sqrt(weight @ left_n**2 / weight.sum()))


def _natural(effect: Effect, scale: ValveScale) -> bool:
    """Whether all numbers of an effect are natural for this valve."""
    values = effect.values()
    ranges = {entry.name: entry.range(scale) for entry in effect.parameters}
    return all(ranges[name][0] <= value <= ranges[name][1] for name, value in values.items())


def moved_n(one: RoughCase, plain: RoughCase) -> float:
    """How far an effect moves the reading once the stem has moved, as a force, N, root mean square.

    Where it stood before tells nothing: it may have been put on a stop that it never meets again.
    """
    off_m = one.recording.position_m - plain.recording.position_m
    moved = np.ones(off_m.size, np.bool_)
    for position_m in (one.recording.position_m, plain.recording.position_m):
        away_m = np.abs(position_m - position_m[0])
        moved &= np.maximum.accumulate(away_m) > _MOVED * float(np.ptp(position_m))
    return float(np.sqrt(np.mean(off_m[moved] ** 2))) * one.settings.parameters.spring_rate_n_per_m


def hidden_case(hidden: tuple[str, str, str, str], seed: int, wanted: float) -> tuple[RoughCase, float] | None:
    """A case with a cause in a valve, sequence and grade, about as strong as wanted; None if that is not natural.

    The strength comes with it. What the plain valve takes up (a preload, a lag) is measured by how far it moves the
    reading.
    """
    cause, valve, sequence, grade = hidden
    plain = case(valve, sequence, grade, seed=seed)
    if cause == NONE:
        return plain, 0.0
    usual_n = misfit_n(case(valve, sequence, "usual", seed=seed) if grade == "ideal" else plain)
    if usual_n is None:
        return None
    kind, swept = STRENGTHS[cause], _swept(valve)
    # these are asked for above their limits, whatever they move
    fixed = cause in _LARGE
    factor, best = float(np.random.default_rng(seed).uniform(*_LARGE.get(cause, (3.0, 3.0)))), None
    for _ in range(1 if fixed else _TRIES):
        rng = np.random.default_rng([seed, zlib.crc32(cause.encode())])
        effect = kind.effect(kind.smallest * factor, swept, rng)
        if not _natural(effect, swept.scale):
            factor *= 0.6
            continue
        made = case(valve, sequence, grade, seed=seed, effects=[effect])
        found_n = moved_n(made, plain) if cause in _TAKEN_UP else misfit_n(made)
        if found_n is None:
            break
        strength = found_n / usual_n
        best = made, strength
        if 0.7 < strength / wanted < 1.4:
            break
        excess = max(strength**2 - 1.0, 0.02)
        factor *= float(np.clip(np.sqrt(max(wanted**2 - 1.0, 0.1) / excess), 0.2, 6.0))
    return best if best is not None and best[1] > 1.5 else None


def told(cause: str, grade: str, number: int, diagnosed: Callable[..., RoughDiagnosis] = diagnose) -> Told | None:
    """Hide a cause in the valve of this number and ask for it."""
    rng = np.random.default_rng([number, zlib.crc32(f"{cause} {grade}".encode())])
    valve = str(rng.choice(list(VALVES)))
    sequence = DIAGNOSTIC if cause in RESTING else str(rng.choice(SEQUENCES))
    wanted = float(np.exp(rng.uniform(*np.log(_STRENGTHS))))
    found = hidden_case((cause, valve, sequence, grade), number, wanted)
    if found is None:
        return None
    made, strength = found
    begin_s = time.perf_counter()
    (recording,), _ = without_data_faults([made.recording], made.nameplate)
    estimate = RoughFrictionEstimator().estimate(recording, made.nameplate)
    middle_s = time.perf_counter()
    said = diagnosed(recording, made.nameplate, estimate)
    end_s = time.perf_counter()
    return Told(cause, grade, valve, sequence, strength, said, end_s - middle_s, middle_s - begin_s)


def _drawn(one: tuple[str, str, int]) -> Told | None:
    found = told(*one)
    if found is not None:
        names = ", ".join(cause.cause for cause in found.said.causes) or "-"
        print(
            f"{found.kind:>14}  {found.grade} {found.valve} {found.sequence}, {found.hidden} x {found.strength:.1f}: "
            f"{found.said.verdict} {names}",
            flush=True,
        )
    return found


def run(count: int | None = None) -> list[Table]:
    """Hide each cause so many times in usual valves (one in four ideal), and as many healthy ones as causes."""
    first = int(time.time()) % 1_000_000 * 100
    drawn = [
        (cause, "ideal" if number % 4 == 3 else "usual", first + 100 * number + place)
        for number in range(count or 4)
        for place, cause in enumerate((*HIDDEN, *[NONE] * (len(HIDDEN) // 2)))
    ]
    results = [one for one in each(_drawn, drawn, "rough diagnosis") if one is not None]
    return [_by_strength(results), _by_cause(results)]


def _counts(results: list[Told]) -> dict[str, int]:
    counts: dict[str, int] = defaultdict(int)
    for one in results:
        counts[one.kind] += 1
    return counts


_KINDS: Final = ("right", "right and more", "set", "large set", "none", "unexplained", "cannot tell", "wrong")


def _row(table: Table, title: str, results: list[Told]) -> None:
    counts = _counts(results)
    times: Any = [one.duration_s + one.estimate_s for one in results] or [0.0]
    table.add_row(
        title, str(len(results)), *[str(counts[kind]) for kind in _KINDS],
        f"{np.median(times):.1f} / {np.max(times):.1f}",
    )  # fmt: skip


def _by_strength(results: list[Told]) -> Table:
    table = Table("", "cases", *_KINDS, "s: median / worst", title="Hidden effects, by strength")
    for grade in ("usual", "ideal"):
        here = [one for one in results if one.grade == grade]
        _row(table, f"{grade}, healthy", [one for one in here if one.hidden == NONE])
        for low, high in _CLASSES:
            chosen = [one for one in here if one.hidden != NONE and low <= one.strength < high]
            _row(table, f"{grade}, strength {low:g} to {high:g}", chosen)
    return table


def _by_cause(results: list[Told]) -> Table:
    table = Table("", "cases", *_KINDS, "s: median / worst", title="Hidden effects of strength above 3, by cause")
    for cause in HIDDEN:
        _row(table, cause, [one for one in results if one.hidden == cause and one.strength >= _CLASSES[1][0]])
    return table
