"""A valve in service: friction, breakaway, bands, spring, lag and travel from what its loop made it do."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Final

import numpy as np

from estimators.in_service.balance import DOWN, MOTION, SPRING, UP, Balance, balanced
from estimators.in_service.bands import bands_of
from estimators.in_service.events import Kind, Observations, observations_of, of_one_motion
from estimators.in_service.figure import COMMON_SHARE, LEAST_REPEATS, Figure, estimated, not_known
from estimators.in_service.lag import lag_of
from estimators.in_service.moves import DRIVEN_BANDS, Moves, moves_of, no_moves, without_false_rests
from estimators.in_service.rows import Rows, resolution, rows_of
from estimators.in_service.travel import Travel, travel_of
from valve.errors import MeasurementError
from valve.nameplate import Action, Nameplate
from valve.recording import FloatArray, Recording

_SPRING_TOLERANCE: Final = 0.1  # of a nameplate's spring rate, one standard deviation: bench sets are set by hand
_COMMAND_TOLERANCE: Final = 0.2  # the same of "a full signal is a full travel", where no nameplate says more
_SPRING_KNOWN: Final = 0.15  # standard error by value: an interval of 30 %
_SIGNAL_SHARE: Final = 0.5  # of the signal's rapid swing: the part of it that is air moves a stem, a gauge's does not
_FOLLOWED: Final = (
    "The stem followed its signal all the time, {:.2g} s later: its noise cannot be told from its motion, and travel "
    "and cycles count all of it."
)
_PERCENTS: Final = {
    "friction_percent": "friction_signal",
    "breakaway_percent": "breakaway_signal",
    "dead_band_percent": "dead_band",
    "stick_band_percent": "stick_band",
    "slip_jump_percent": "slip_jump",
}
_COUNTED_FROM_M: Final = 1.0  # position of a stand-in nameplate: 1 m is the whole travel


class Input(StrEnum):
    """Which channel says what drives the stem."""

    FORCE = "force"
    PRESSURE = "pressure"
    COMMAND = "command"


@dataclass(frozen=True, slots=True)
class Scale:
    """What is known of the units of a recording.

    ``travel_m`` and ``area_m2`` None where no nameplate says them. ``is_share``: positions are shares of the travel,
    1 m standing for all of it. ``command_percent_pa``: the command is in percent, of so many Pa each.
    """

    travel_m: float | None = None
    area_m2: float | None = None
    is_share: bool = False
    command_percent_pa: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """What a record in service says; ``figures`` by name, in SI units or those that ``Figure.unit`` names."""

    rows: int
    duration_s: float
    covered_s: float
    period_s: float
    is_even: bool
    gaps: int
    driven_by: Input
    position_unit: str
    position_noise: float
    is_reversed: bool
    moves: int
    breakaways: int
    figures: dict[str, Figure]
    travel: Travel
    notes: tuple[str, ...] = field(default_factory=tuple)


def watched(recording: Recording, nameplate: Nameplate | None, scale: Scale, *, subject: str) -> Watched:
    """Return what normal operation says of a valve.

    Without a nameplate the figures that need its area or travel are not known and say so. Raises RecordingError where
    the rows cannot be right (``rows_of``), and MeasurementError where the stem never moved beyond its noise.
    """
    kind, signal, unit = _signal(recording, scale)
    travel = scale.travel_m if not scale.is_share else _COUNTED_FROM_M
    rows = rows_of(recording.time_s, recording.position_m, signal, travel=travel, subject=subject)
    moves = moves_of(rows)
    if moves.count < 2:
        return _restless(recording, rows, kind, scale, _never_moved(rows, moves, scale, subject))
    seen = observations_of(rows, moves)
    is_reversed = _falls_with_signal(seen)
    if is_reversed:
        rows = replace(rows, signal=-rows.signal)
        seen = replace(seen, signal=-seen.signal)
    length = travel if travel is not None else float(np.ptp(rows.position))
    prior = _spring_prior(kind, nameplate, scale, unit)
    found, moves, seen = _settled(rows, moves, seen, length, prior)
    position_unit = "%" if scale.is_share else "m"
    spring = None if found is None else found.spring if found.spring > 0.0 else None
    bands = bands_of(rows, moves, seen, spring=spring, signal_unit=unit, position_unit=position_unit)
    figures = _frictions(found, rows, seen, unit)
    figures |= {
        "dead_band": bands.dead_band,
        "stick_band": bands.stick_band,
        "slip_jump": bands.slip_jump,
        "slip": bands.slip.times(100.0, "%") if scale.is_share else bands.slip,
    }
    figures |= _forces(figures, unit, scale)
    figures |= _percents(figures, kind, nameplate, unit)
    figures["spring_rate"] = _spring(found, unit, scale)
    figures["lag"] = _lag(recording)
    figures["stem_lag"] = not_known("s", "a stem that rests has none: see the dead band")
    return Watched(
        rows=rows.time_s.size,
        duration_s=float(np.ptp(rows.time_s)),
        covered_s=rows.covered_s,
        period_s=rows.period_s,
        is_even=rows.is_even,
        gaps=rows.gaps,
        driven_by=kind,
        position_unit=position_unit,
        position_noise=rows.noise * (100.0 if scale.is_share else 1.0),
        is_reversed=is_reversed,
        moves=moves.count,
        breakaways=int((seen.kind == Kind.BREAKAWAY).sum()),
        figures=figures,
        travel=travel_of(rows, moves, travel),
        notes=tuple(_notes(kind, nameplate, rows, is_reversed)),
    )


def _restless(recording: Recording, rows: Rows, kind: Input, scale: Scale, never_moved: str) -> Watched:
    """What can be said of a stem that follows its signal and never rests; raises MeasurementError where it does not."""
    travel = scale.travel_m if not scale.is_share else _COUNTED_FROM_M
    follows = [lag_of(rows.time_s, sign * rows.signal, rows.position, names=("signal", "stem")) for sign in (1.0, -1.0)]
    stem_lag = follows[0] if follows[0].value is not None else follows[1]
    if stem_lag.value is None:
        raise MeasurementError(never_moved)
    quiet = resolution(rows.position) / np.sqrt(12.0)
    rows = replace(rows, noise=float(quiet))
    nothing = no_moves(2.0 * resolution(rows.position))
    why = (
        f"the stem never came to rest for two rows of {rows.period_s:.2g} s: faster rows, or an hour in which the loop "
        "is quieter"
    )
    names = {
        **dict.fromkeys(("friction", "breakaway", "breakaway_up", "breakaway_down"), "N"),
        **dict.fromkeys(("friction_signal", "breakaway_signal", "dead_band", "stick_band", "slip_jump"), "Pa"),
        **dict.fromkeys(_PERCENTS, "percent"),
        "slip": "m",
        "spring_rate": "N/m",
    }
    figures = {name: not_known(unit, why) for name, unit in names.items()}
    figures |= {"lag": _lag(recording), "stem_lag": stem_lag}
    way = travel_of(rows, nothing, travel)
    return Watched(
        rows=rows.time_s.size,
        duration_s=float(np.ptp(rows.time_s)),
        covered_s=rows.covered_s,
        period_s=rows.period_s,
        is_even=rows.is_even,
        gaps=rows.gaps,
        driven_by=kind,
        position_unit="%" if scale.is_share else "m",
        position_noise=rows.noise * (100.0 if scale.is_share else 1.0),
        is_reversed=follows[0].value is None,
        moves=way.moves,
        breakaways=0,
        figures=figures,
        travel=way,
        notes=(_FOLLOWED.format(stem_lag.value),),
    )


def _signal(recording: Recording, scale: Scale) -> tuple[Input, FloatArray, str]:
    """Channel that drives the stem: the force, else the pressure, else the command, with its unit."""
    if recording.force_n is not None:
        return Input.FORCE, recording.force_n, "N"
    if recording.pressure_pa is not None:
        return Input.PRESSURE, recording.pressure_pa, "Pa"
    assert recording.command_pa is not None, "a recording has a command, a pressure or a force"
    if scale.command_percent_pa is not None:
        return Input.COMMAND, recording.command_pa / scale.command_percent_pa, "%"
    return Input.COMMAND, recording.command_pa, "Pa"


def _never_moved(rows: Rows, moves: Moves, scale: Scale, subject: str) -> str:
    factor, unit = (100.0, "%") if scale.is_share else (1.0e3, "mm")
    swings = float(np.ptp(rows.signal))
    return (
        f"{subject}: the stem made {moves.count} moves beyond {factor * moves.band:.2g} {unit}, five times its noise, "
        f"in {rows.covered_s / 3600.0:.3g} h while the signal went over {swings:.3g}; 2 are needed: record for longer, "
        "or while the set point changes"
    )


def _falls_with_signal(seen: Observations) -> bool:
    """Whether the position falls where the signal rises: moves up happen at lower signals, and places follow it."""
    signal = seen.signal - seen.signal.mean()
    spread = float(np.std(signal)) * seen.count
    if spread == 0.0:
        return False
    place = seen.position - seen.position.mean()
    by_place = float(signal @ place) / (spread * max(float(np.std(place)), 1.0e-300))
    by_direction = float(signal @ (seen.sign - seen.sign.mean())) / (spread * max(float(np.std(seen.sign)), 1.0e-300))
    return by_place + by_direction < 0.0


def _spring_prior(kind: Input, nameplate: Nameplate | None, scale: Scale, unit: str) -> tuple[float, float] | None:
    """Spring rate of the nameplate in signal by position, and its standard deviation."""
    if nameplate is not None and nameplate.actuator.action is Action.SPRING:
        length = _COUNTED_FROM_M if scale.is_share else nameplate.actuator.travel_m
        bench, signal = nameplate.actuator.bench_set_pa, nameplate.signal
        span_pa = bench[1] - bench[0] if bench is not None else None
        if span_pa is None and kind is Input.COMMAND and signal is not None:
            span_pa = signal.range_pa[1] - signal.range_pa[0]
        if span_pa is not None and unit == "Pa":
            return span_pa / length, _SPRING_TOLERANCE * span_pa / length
        rate = nameplate.nominal_spring_rate_n_per_m
        if rate is not None and unit == "N":
            return rate, _SPRING_TOLERANCE * rate
    if unit == "%" and scale.is_share:
        return 100.0 / _COUNTED_FROM_M, _COMMAND_TOLERANCE * 100.0 / _COUNTED_FROM_M
    return None


def _swept(moves: Moves) -> tuple[tuple[float, float], tuple[float, float]]:
    """From where to where the stem moved up, and down."""
    low, high = np.minimum(moves.from_level, moves.to_level), np.maximum(moves.from_level, moves.to_level)
    ranges = []
    for sign in (1, -1):
        own = (moves.began == sign) | (moves.ended == sign)
        ranges.append((float(low[own].min()), float(high[own].max())) if own.any() else (float(low.min()),) * 2)
    return ranges[0], ranges[1]


def _settled(
    rows: Rows, moves: Moves, seen: Observations, length: float, prior: tuple[float, float] | None
) -> tuple[Balance | None, Moves, Observations]:
    """Balance of the moves; a first one gives the spring by which rests are told from slow sliding."""
    first = balanced(seen, travel=length, swept=_swept(moves), spring=prior)
    spring = float("nan") if first is None else float(first.values[SPRING])
    if first is None or not spring > 0.0:
        return first, moves, seen
    joined = without_false_rests(moves, rows, spring)
    seen = observations_of(rows, joined, spring)
    driven = (seen.kind == Kind.MOTION) | (seen.driven >= DRIVEN_BANDS * spring * joined.band)
    seen = seen.chosen(driven)
    return balanced(of_one_motion(seen), travel=length, swept=_swept(joined), spring=prior), joined, seen


def _frictions(found: Balance | None, rows: Rows, seen: Observations, unit: str) -> dict[str, Figure]:
    """Friction in motion and at breakaway in the signal's unit."""
    names = ("friction", "breakaway", "breakaway_up", "breakaway_down")
    ways = {sign: int(((seen.kind == Kind.MOTION) & (seen.sign == sign)).sum()) for sign in (1, -1)}
    if found is None:
        few = f"{ways[1]} moves up and {ways[-1]} down, both directions and 4 moves are needed: record for longer"
        return {f"{name}_signal": not_known(unit, few) for name in names}
    spring = abs(float(found.values[SPRING]))
    open_rows = COMMON_SHARE * float(np.mean(seen.half_width))
    common = np.hypot(np.hypot(spring * rows.noise, _SIGNAL_SHARE * rows.signal_noise), open_rows)
    away = {sign: int(((seen.kind == Kind.BREAKAWAY) & (seen.sign == sign)).sum()) for sign in (1, -1)}
    asked = {
        "friction": (_weights({MOTION: 1.0}), min(ways.values()), ways[1] + ways[-1]),
        "breakaway": (_weights({UP: 0.5, DOWN: 0.5}), min(away.values()), away[1] + away[-1]),
        "breakaway_up": (_weights({UP: 1.0}), away[1], away[1]),
        "breakaway_down": (_weights({DOWN: 1.0}), away[-1], away[-1]),
    }
    figures = {}
    for name, (weights, least, count) in asked.items():
        if least < (2 if name == "friction" else LEAST_REPEATS):
            figures[f"{name}_signal"] = not_known(
                unit, f"{least} of these in a direction, {LEAST_REPEATS} are needed: record for longer", count
            )
            continue
        value, error = _combined(found, weights)
        scatter = found.scatter if name != "friction" else None
        figures[f"{name}_signal"] = estimated(
            value,
            float(np.hypot(error, common)),
            unit,
            found.freedom,
            count=count,
            scatter=scatter,
            too_wide=f"{count} moves leave it open by more than 30 %: more or wider moves, or the bench set",
        )
    return figures


def _weights(by_column: dict[int, float]) -> FloatArray:
    weights = np.zeros(5)
    for column, weight in by_column.items():
        weights[column] = weight
    return weights


def _combined(found: Balance, weights: FloatArray) -> tuple[float, float]:
    used = np.flatnonzero(weights)
    part = Balance(found.values[used], found.covariance[np.ix_(used, used)], found.freedom, found.scatter, 0.0, 0.0)
    return part.combined(weights[used])


def _forces(figures: dict[str, Figure], unit: str, scale: Scale) -> dict[str, Figure]:
    """Frictions in N."""
    forces = {}
    for name in ("friction", "breakaway", "breakaway_up", "breakaway_down"):
        one = figures[f"{name}_signal"]
        if unit == "N":
            forces[name] = one
        elif unit == "Pa" and scale.area_m2 is not None:
            forces[name] = one.times(scale.area_m2, "N")
        else:
            needs = "the diaphragm's area" if unit == "Pa" else "the diaphragm's area and the signal's pressure range"
            forces[name] = not_known("N", one.note or f"needs {needs}: give a nameplate", one.count)
    return forces


def _percents(figures: dict[str, Figure], kind: Input, nameplate: Nameplate | None, unit: str) -> dict[str, Figure]:
    """Bands and friction in percent of the span: the signal's range, else the bench set, as the signature has it."""
    span: float | None = None
    if unit == "%":
        span = 100.0
    elif nameplate is not None and unit == "Pa":
        ends = nameplate.signal.range_pa if nameplate.signal is not None else nameplate.actuator.bench_set_pa
        span = None if ends is None else ends[1] - ends[0]
    elif nameplate is not None and kind is Input.FORCE and nameplate.nominal_spring_rate_n_per_m is not None:
        span = nameplate.nominal_spring_rate_n_per_m * nameplate.actuator.travel_m
    percents = {}
    for key, name in _PERCENTS.items():
        one = figures[name]
        percents[key] = (
            one.times(100.0 / span, "percent")
            if span is not None
            else not_known(
                "percent", one.note or "needs the signal's range or the bench set: give a nameplate", one.count
            )
        )
    return percents


def _spring(found: Balance | None, unit: str, scale: Scale) -> Figure:
    if unit == "%" or (unit == "Pa" and scale.area_m2 is None) or scale.is_share:
        return not_known("N/m", "needs the diaphragm's area, the travel and a pressure: give a nameplate")
    if found is None or not found.spring_error <= _SPRING_KNOWN * abs(found.spring):
        return not_known("N/m", "the moves were too small or too few to show a slope: wider moves would tell")
    factor = 1.0 if unit == "N" or scale.area_m2 is None else scale.area_m2
    return estimated(
        found.spring * factor,
        found.spring_error * factor,
        "N/m",
        found.freedom,
        count=0,
        too_wide="the moves were too small or too few to show a slope: wider moves would tell",
    )


def _lag(recording: Recording) -> Figure:
    if recording.pressure_pa is None or recording.command_pa is None:
        return not_known("s", "needs both the command and the pressure")
    return lag_of(recording.time_s, recording.command_pa, recording.pressure_pa, names=("command", "pressure"))


def _notes(kind: Input, nameplate: Nameplate | None, rows: Rows, is_reversed: bool) -> list[str]:
    notes = []
    if kind is Input.COMMAND:
        notes.append(
            "There is a command and no pressure: the lag of I/P, positioner and air is in friction and bands. "
            "Take them for upper bounds."
        )
    if is_reversed:
        notes.append("The position falls where the signal rises: up means towards larger positions.")
    if not rows.is_even:
        notes.append("The rows are uneven, as a historian reports changes: forces are known to the steps between rows.")
    if nameplate is not None and nameplate.actuator.action is Action.SPRING and nameplate.actuator.bench_set_pa is None:
        notes.append("The nameplate has no bench set: the spring comes from the moves alone.")
    return notes


def to_json(found: Watched) -> dict[str, Any]:
    """Return the result as an object of JSON, ``breakaway/watch/1``."""
    factor = 100.0 if found.position_unit == "%" else 1.0
    travel = found.travel
    return {
        "schema": "breakaway/watch/1",
        "recording": {
            "samples": found.rows,
            "duration_s": found.duration_s,
            "covered_s": found.covered_s,
            "sample_period_s": found.period_s,
            "is_even": found.is_even,
            "gaps": found.gaps,
            "driven_by": str(found.driven_by),
            "position_unit": found.position_unit,
            "position_noise": found.position_noise,
            "is_reversed": found.is_reversed,
        },
        "moves": found.moves,
        "breakaways": found.breakaways,
        "figures": {name: one.to_json() for name, one in sorted(found.figures.items())},
        "travel": {
            "unit": found.position_unit,
            "total": travel.total * factor,
            "total_ci95": [end * factor for end in travel.total_ci95],
            "per_hour": travel.per_hour * factor,
            "cycles": travel.cycles,
            "lowest": travel.lowest * factor,
            "highest": travel.highest * factor,
            "mean": travel.mean * factor,
            "histogram": {"edges": (travel.edges * factor).tolist(), "time_shares": travel.shares.tolist()},
        },
        "notes": list(found.notes),
    }
