"""A valve in service: friction, breakaway, bands, spring, lag and travel from what its loop made it do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from estimators.data_faults.drop_outs import without_drop_outs
from estimators.data_faults.fault import NOWHERE
from estimators.in_service.balance import Balance
from estimators.in_service.bands import SLIPS_HIDDEN, bands_of
from estimators.in_service.events import Kind, Observations, observations_of
from estimators.in_service.figure import Figure, amount, not_known
from estimators.in_service.fit import settled, spring_prior
from estimators.in_service.frictions import PERCENTS, forces, frictions, percents_of_span, spring_rate
from estimators.in_service.lag import lag_of
from estimators.in_service.moves import Moves, moves_of, no_moves
from estimators.in_service.one_line import new_line
from estimators.in_service.plausible import plausible
from estimators.in_service.result import COUNTED_FROM_M, Input, Scale, Watched
from estimators.in_service.rows import FEWEST, Rows, require_inside, resolution, rows_of
from estimators.in_service.stopped import Stopped, repeated, rows_of_stretches, stopped
from estimators.in_service.travel import travel_of
from valve.errors import MeasurementError, RecordingError
from valve.messages import Message, say
from valve.nameplate import Action, Nameplate
from valve.recording import FloatArray, Recording

_RESTS: Final = say("no_lag_of_resting_stem", "a stem that rests has none: see the dead band")
_TWO_CHANNELS: Final = say("needs_command_and_pressure", "needs both the command and the pressure")
_COMMAND_ALONE: Final = say(
    "watched_by_command",
    "There is a command and no pressure: the lag of I/P, positioner and air is in friction and bands. "
    "Take them for upper bounds.",
)
_REVERSED: Final = say(
    "position_reversed", "The position falls where the signal rises: up means towards larger positions."
)
_UNEVEN: Final = say(
    "rows_uneven", "The rows are uneven, as a historian reports changes: forces are known to the steps between rows."
)
_BY_THEMSELVES: Final = say(
    "reported_by_themselves",
    "Position and signal are reported each by itself: the last report of each holds until the next. Smaller exception "
    "limits of both tags make the figures surer.",
)
_NO_BENCH_SET: Final = say("no_bench_set", "The nameplate has no bench set: the spring comes from the moves alone.")


def watched(recording: Recording, nameplate: Nameplate | None, scale: Scale, *, subject: str) -> Watched:
    """Return what normal operation says of a valve.

    Without a nameplate the figures that need its area or travel are not known and say so. Raises RecordingError where
    the rows cannot be right (``rows_of``) or a channel's unit changes, and MeasurementError where the stem never moved
    beyond its noise.
    """
    travel = scale.travel_m if not scale.is_share else COUNTED_FROM_M
    require_inside(recording.position_m, travel, subject)
    recording, faults = without_drop_outs(recording, NOWHERE, by_pressure=True)
    kind, signal, unit = _signal(recording, scale)
    rows = rows_of(recording.time_s, recording.position_m, signal, subject=subject)
    moves = moves_of(rows)
    prior = spring_prior(kind, nameplate, scale, unit)
    rows, moves, stops = _without_stops(rows, moves, travel, prior)
    left_out = (*(fault.sentence for fault in faults), *stops)
    if moves.count < 2:
        restless = _restless(recording, rows, kind, scale, _never_moved(rows, moves, (scale, unit), subject))
        return replace(restless, notes=(*left_out, *restless.notes))
    found, rows, moves, seen, is_reversed = _balance(rows, moves, travel, prior)
    _require_one_line(seen, unit, subject)
    figures = _figures(found, rows, moves, seen, (kind, nameplate, scale, unit))
    figures["lag"] = _lag(recording)
    figures["stem_lag"] = not_known("s", _RESTS)
    figures, doubts = plausible(figures, prior, unit, scale)
    return _of_record(rows, kind, scale)(
        is_reversed=is_reversed,
        moves=moves.count,
        breakaways=int((seen.kind == Kind.BREAKAWAY).sum()),
        figures=figures,
        travel=travel_of(rows, moves, travel),
        notes=(*doubts, *left_out, *_notes(kind, nameplate, rows, is_reversed)),
    )


def _of_record(rows: Rows, kind: Input, scale: Scale) -> Callable[..., Watched]:
    """Return what is filled with the figures: all that the record itself says is in it."""
    return partial(
        Watched,
        rows=rows.time_s.size,
        duration_s=float(np.ptp(rows.time_s)),
        covered_s=rows.covered_s,
        period_s=rows.period_s,
        is_even=rows.is_even,
        gaps=rows.gaps,
        driven_by=kind,
        position_unit="%" if scale.is_share else "m",
        position_noise=rows.noise * (100.0 if scale.is_share else 1.0),
    )


def _balance(
    rows: Rows, moves: Moves, travel: float | None, prior: tuple[float, float] | None
) -> tuple[Balance | None, Rows, Moves, Observations, bool]:
    """Balance of the moves with what it is of, the signal turned round where the position falls with it."""
    seen = observations_of(rows, moves)
    is_reversed = _falls_with_signal(seen)
    if is_reversed:
        rows = replace(rows, signal=-rows.signal)
        seen = replace(seen, signal=-seen.signal)
    length = travel if travel is not None else float(np.ptp(rows.position))
    found, moves, seen = settled(rows, moves, seen, length, prior)
    return found, rows, moves, seen, is_reversed


def _without_stops(
    rows: Rows, moves: Moves, travel: float | None, prior: tuple[float, float] | None
) -> tuple[Rows, Moves, list[Message]]:
    """Leave out where one channel had stopped, by the balance of all other rows, and say so."""
    candidates = repeated(rows)
    out = rows_of_stretches([one for stretches in candidates.values() for one in stretches], rows.time_s.size)
    if not out.any() or np.count_nonzero(~out) < FEWEST:
        return rows, moves, []
    rest = rows.without(out)
    rest_moves = moves_of(rest)
    found = _balance(rest, rest_moves, travel, prior)[0] if rest_moves.count >= 2 else None
    stops = [] if found is None else stopped(rows, candidates, found)
    if not stops:
        return rows, moves, []
    rows = rows.without(np.any([one.out for one in stops], axis=0))
    return rows, moves_of(rows), [_stop_said(one) for one in stops]


def _stop_said(one: Stopped) -> Message:
    channel = say("position", "position") if one.is_position else say("signal", "signal")
    return say(
        "channel_stopped",
        "The {channel} holds one value for {hours:.3g} h, first after {time:.7g} s, while the other channel moves by "
        "more than that valve can: that time is left out. Look at the transmitter, link and tag of the {channel}.",
        channel=channel,
        hours=one.lasted_s / 3600.0,
        time=one.first_s,
    )


def _require_one_line(seen: Observations, unit: str, subject: str) -> None:
    new = new_line(seen)
    if new is None:
        return
    raise RecordingError(
        say(
            "line_changes",
            "{subject}: between {since:.7g} s and {until:.7g} s the signal at one position changes for good by up to "
            "{differs}, and the friction is {friction}: unit, range or zero of a channel changed there: cut the file "
            "there and give the parts by themselves",
            subject=subject,
            since=new.since_s,
            until=new.until_s,
            differs=amount(new.differs, unit),
            friction=amount(new.friction, unit),
        )
    )


def _figures(
    found: Balance | None,
    rows: Rows,
    moves: Moves,
    seen: Observations,
    of: tuple[Input, Nameplate | None, Scale, str],
) -> dict[str, Figure]:
    """Friction, bands and spring, in the signal's unit, in N and in percent of the span."""
    kind, nameplate, scale, unit = of
    position_unit = "%" if scale.is_share else "m"
    spring = None if found is None else found.spring if found.spring > 0.0 else None
    bands = bands_of(rows, moves, seen, spring=spring, signal_unit=unit, position_unit=position_unit)
    figures = frictions(found, rows, seen, unit)
    figures |= {
        "dead_band": bands.dead_band,
        "stick_band": bands.stick_band,
        "slip_jump": bands.slip_jump,
        "slip": bands.slip.times(100.0, "%") if scale.is_share else bands.slip,
    }
    if bands.slip.note is SLIPS_HIDDEN:
        figures |= {name: not_known(unit, SLIPS_HIDDEN, one.count) for name, one in figures.items() if name != "slip"}
    figures |= forces(figures, unit, scale)
    figures |= percents_of_span(figures, kind, nameplate, unit)
    figures["spring_rate"] = spring_rate(found, rows, seen, unit, scale)
    return figures


def _restless(recording: Recording, rows: Rows, kind: Input, scale: Scale, never_moved: str) -> Watched:
    """What can be said of a stem that follows its signal and never rests; raises MeasurementError where it does not."""
    travel = scale.travel_m if not scale.is_share else COUNTED_FROM_M
    names = say("signal", "signal"), say("stem", "stem")
    follows = [lag_of(rows.time_s, sign * rows.signal, rows.position, names=names) for sign in (1.0, -1.0)]
    stem_lag = follows[0] if follows[0].value is not None else follows[1]
    if stem_lag.value is None:
        raise MeasurementError(never_moved)
    quiet = resolution(rows.position) / np.sqrt(12.0)
    rows = replace(rows, noise=float(quiet))
    nothing = no_moves(2.0 * resolution(rows.position))
    why = say(
        "stem_never_rests",
        "the stem never came to rest for two rows of {period:.2g} s: faster rows, or an hour in which the loop is "
        "quieter",
        period=rows.period_s,
    )
    units = {
        **dict.fromkeys(("friction", "breakaway", "breakaway_up", "breakaway_down"), "N"),
        **dict.fromkeys(("friction_signal", "breakaway_signal", "dead_band", "stick_band", "slip_jump"), "Pa"),
        **dict.fromkeys(PERCENTS, "percent"),
        "slip": "m",
        "spring_rate": "N/m",
    }
    figures = {name: not_known(unit, why) for name, unit in units.items()}
    figures |= {"lag": _lag(recording), "stem_lag": stem_lag}
    way = travel_of(rows, nothing, travel)
    return _of_record(rows, kind, scale)(
        is_reversed=follows[0].value is None,
        moves=way.moves,
        breakaways=0,
        figures=figures,
        travel=way,
        notes=(
            say(
                "stem_followed",
                "The stem followed its signal all the time, {lag:.2g} s later: its noise cannot be told from its "
                "motion, and travel and cycles count all of it.",
                lag=stem_lag.value,
            ),
            *_held(rows),
        ),
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


def _never_moved(rows: Rows, moves: Moves, units: tuple[Scale, str], subject: str) -> Message:
    scale, unit = units
    return say(
        "few_moves_beyond_noise",
        "{subject}: the stem made {count} moves beyond {band:.2g {unit}}, five times its noise, in {hours:.3g} h while "
        "the signal went over {swings}; 2 are needed: record for longer, or while the set point changes",
        subject=subject,
        count=int(moves.count),
        band=float(moves.band),
        unit="%" if scale.is_share else "mm",
        hours=rows.covered_s / 3600.0,
        swings=amount(float(np.ptp(rows.signal)), unit),
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


def _lag(recording: Recording) -> Figure:
    if recording.pressure_pa is None or recording.command_pa is None:
        return not_known("s", _TWO_CHANNELS)
    names = say("command", "command"), say("pressure", "pressure")
    return lag_of(recording.time_s, recording.command_pa, recording.pressure_pa, names=names)


def _held(rows: Rows) -> list[Message]:
    notes = []
    if rows.repeats:
        notes.append(
            say(
                "rows_repeat",
                "{count} rows repeat both values of the row before, as an export does that holds the last report: they "
                "are left out. Export the values as stored, without rows in between.",
                count=rows.repeats,
            )
        )
    elif rows.is_held:
        notes.append(_BY_THEMSELVES)
    if not rows.held_s:
        return notes
    return [
        *notes,
        say(
            "both_hold_one_value",
            "Position and signal hold one value for {hours:.3g} h, first after {time:.7g} s: that time is left out. If "
            "the source had stopped, look at the logger or transmitter.",
            hours=float(rows.held_s) / 3600.0,
            time=float(rows.held_from_s),
        ),
    ]


def _notes(kind: Input, nameplate: Nameplate | None, rows: Rows, is_reversed: bool) -> list[Message]:
    notes = _held(rows)
    if kind is Input.COMMAND:
        notes.append(_COMMAND_ALONE)
    if is_reversed:
        notes.append(_REVERSED)
    if not rows.is_even:
        notes.append(_UNEVEN)
    if nameplate is not None and nameplate.actuator.action is Action.SPRING and nameplate.actuator.bench_set_pa is None:
        notes.append(_NO_BENCH_SET)
    return notes
