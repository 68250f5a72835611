"""The answer about a loop: test this valve, not the valve, no oscillation, or cannot tell and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

import numpy as np

from estimators.loop_stiction.oscillation import FEWEST_CYCLES, Oscillation, oscillation_of, swing_share
from estimators.loop_stiction.rows import LoopRows, loop_rows
from estimators.loop_stiction.shapes import SINE, TRIANGLE, Shape, shape_of
from valve.messages import Message, say
from valve.recording import FloatArray

# Limits of this project's own, of the benchmark ``loops``.
_FEWEST_ROWS: Final = 12.0  # a period: fewer draw a triangle of any sine
_SHORTEST_S: Final = 120.0  # a period: a record too short for it says nothing of a valve
_USUAL_S: Final = 600.0  # a period: flow loops with a stuck valve swing faster, level loops slower
_FEWEST_ROWS_OF_A_LAG: Final = 6.0
_PROPORTIONAL_DEG: Final = 20.0  # lag of a controller whose integral action does not take part
_BOTH_DEG: Final = 30.0  # from here on an integrating process with a stuck valve
_INTEGRAL_DEG: Final = 60.0  # and from here on a self-regulating one
_MOST_DEG: Final = 130.0
_SWINGS_ALIKE: Final = 0.3  # robust scatter of the output's half cycles: a stuck stem waits for the same way each time
_MIDDLE: Final = 0.12  # how far from 0.5 the mean place of the peaks may be: a pulse that dies away leans
_SATURATED: Final = 0.1  # of the rows with the output at its lowest or highest value
_STANDS: Final = 0.25  # of the rows without one change of the output: no controller drives it
_SETPOINT: Final = 0.3  # set point's swings over the value's


class Answer(StrEnum):
    """What to do about a loop."""

    TEST_VALVE = "test_valve"
    NOT_THE_VALVE = "not_the_valve"
    NO_OSCILLATION = "no_oscillation"
    CANNOT_TELL = "cannot_tell"


@dataclass(frozen=True, slots=True, eq=False)
class LoopVerdict:
    """The answer with its reason, a sentence; oscillation and shapes None where none was seen.

    ``process``: what the loop seems to hold, "self-regulating" or "integrating", where the valve is the likely cause.
    """

    answer: Answer
    reason: str
    rows: LoopRows
    oscillation: Oscillation | None = None
    output_shape: Shape | None = None
    value_shape: Shape | None = None
    process: str | None = None
    notes: tuple[str, ...] = field(default_factory=tuple)


def judged_loop(
    time_s: FloatArray,
    output: FloatArray,
    value: FloatArray,
    setpoint: FloatArray | None = None,
    *,
    subject: str,
) -> LoopVerdict:
    """Return whether a loop oscillates by its valve; arrays of shape (n,), s and any unit, NaN for a missing value.

    By the shapes of output and process value (``shapes``) and by the lag of the output behind the control error. That
    lag is the controller's alone: it says whether its integral action takes part, without which no stuck valve
    oscillates. Raises RecordingError as ``loop_rows``.
    """
    rows = loop_rows(time_s, output, value, setpoint, subject=subject)
    notes = _notes(rows)
    if (unusable := _unusable(rows)) is not None:
        return LoopVerdict(Answer.CANNOT_TELL, unusable, rows, notes=notes)
    swings = oscillation_of(rows)
    if swings is None:
        return _nothing_repeats(rows, notes)
    shapes = shape_of(swings.output_halves), shape_of(swings.value_halves)
    answer, why, process = _answer(rows, swings, *shapes)
    return LoopVerdict(answer, why, rows, swings, *shapes, process, notes)


def _nothing_repeats(rows: LoopRows, notes: tuple[str, ...]) -> LoopVerdict:
    """No oscillation, unless the record is too short to show one."""
    longest = shown_time(rows.duration_s / FEWEST_CYCLES)
    if rows.duration_s < FEWEST_CYCLES * _SHORTEST_S:
        short = say(
            "loop_record_short",
            "the record is {duration} long and shows periods up to {longest} alone, a stuck valve swings in minutes: "
            "export {needed} at least",
            duration=shown_time(rows.duration_s),
            longest=longest,
            needed=shown_time(FEWEST_CYCLES * _USUAL_S),
        )
        return LoopVerdict(Answer.CANNOT_TELL, short, rows, notes=notes)
    reason = say(
        "nothing_repeats",
        "nothing in the output repeats {cycles:g} times or more, with a period up to {longest}",
        cycles=FEWEST_CYCLES,
        longest=longest,
    )
    return LoopVerdict(Answer.NO_OSCILLATION, reason, rows, notes=notes)


def _unusable(rows: LoopRows) -> Message | None:
    """Return why nothing can be said of these rows, None where something can."""
    output, count = rows.output, rows.output.size
    if np.ptp(output) == 0.0:
        return say(
            "output_constant",
            "the controller output is {value:.4g} in all {count} rows: the controller was in manual, or the column is "
            "another one; export a time in automatic",
            value=float(output[0]),
            count=count,
        )
    if np.ptp(rows.value) == 0.0:
        return say(
            "process_value_constant",
            "the process value is {value:.4g} in all {count} rows: its transmitter is frozen, or the column is another "
            "one; export a time in which it moves",
            value=float(rows.value[0]),
            count=count,
        )
    if rows.is_drawn:
        return say(
            "rows_drawn",
            "the rows are a historian's reports of changes, or stand on straight lines between such reports, and these "
            "lines look like a sticking valve: export evenly what was measured, without compression or interpolation",
        )
    changes = np.concatenate([[0], np.flatnonzero(np.diff(output) != 0.0) + 1, [count]])
    still = int(np.diff(changes).max())
    if still > _STANDS * count:
        return say(
            "output_stands",
            "the controller output does not change for {still} of {whole}, {allowed:g %} are allowed: the controller "
            "was in manual or at its end, or its steps are too coarse; export a time in automatic",
            still=shown_time(still * rows.period_s),
            whole=shown_time(rows.duration_s),
            allowed=_STANDS,
        )
    at_ends = {float(end): float(np.mean(output == end)) for end in (output.min(), output.max())}
    end = max(at_ends, key=lambda one: at_ends[one])
    if at_ends[end] > _SATURATED:
        return say(
            "output_at_end",
            "the controller output stands at its end, {end:.4g}, in {share:.0f %} of the rows, {allowed:g %} are "
            "allowed: what is cut off has no shape; export a time within the limits",
            end=end,
            share=at_ends[end],
            allowed=_SATURATED,
        )
    return None


def _answer(
    rows: LoopRows, swings: Oscillation, output_shape: Shape, value_shape: Shape
) -> tuple[Answer, str, str | None]:
    """Return the answer about a loop that oscillates, its reason, and the process that it seems to hold."""
    lag, rows_a_period = swings.lag_deg, swings.period_s / rows.period_s
    if abs(lag) < _PROPORTIONAL_DEG and rows_a_period >= _FEWEST_ROWS_OF_A_LAG:
        reason = say(
            "output_follows_at_once",
            "the output follows the error at once (lag {lag:.0f}°, a stuck valve makes {least:g}° or more), so the "
            "proportional action drives it: a gain too high, or a disturbance from outside",
            lag=lag,
            least=_BOTH_DEG,
        )
        return Answer.NOT_THE_VALVE, reason, None
    if rows_a_period < _FEWEST_ROWS:
        reason = say(
            "few_rows_a_period",
            "a period of {period} has {rows:.3g} rows, its shape needs {needed:g}: export a row every {row} or faster",
            period=shown_time(swings.period_s),
            rows=rows_a_period,
            needed=_FEWEST_ROWS,
            row=shown_time(swings.period_s / _FEWEST_ROWS),
        )
        return Answer.CANNOT_TELL, reason, None
    relevant = [output_shape] if lag >= _INTEGRAL_DEG else [output_shape, value_shape]
    largest = max(one.index for one in relevant)
    if lag < _MOST_DEG and largest < SINE:
        reason = say(
            "swings_like_sine",
            "it swings like a sine (index {index:.2f}, below {limit:g}): a disturbance from outside, or tuning",
            index=largest,
            limit=SINE,
        )
        return Answer.NOT_THE_VALVE, reason, None
    process = _stuck(lag, output_shape, value_shape)
    if process is None:
        reason = say(
            "neither_sine_nor_stuck",
            "neither a sine nor the run of a stuck valve fits: index of the output {output:.2f}, of the process value "
            "{value:.2f}, {triangle:g} is a triangle, lag {lag:.0f}°: put the controller in manual for some periods; "
            "if the swing stays, its cause is elsewhere",
            output=output_shape.index,
            value=value_shape.index,
            triangle=TRIANGLE,
            lag=lag,
        )
        return Answer.CANNOT_TELL, reason, None
    if (doubt := _doubt(rows, swings)) is not None:
        return Answer.CANNOT_TELL, doubt, None
    by_output = process == "self-regulating"
    reason = say(
        "runs_as_stuck",
        "the {what} runs straight to and fro (index {index:.2f}, a triangle above {triangle:g}), the output goes the "
        "same way each time (± {scatter:.0f %}) and the integral action drives it (lag {lag:.0f}°): so it is where a "
        "controller waits for a stuck stem",
        what=say("output", "output") if by_output else say("process_value", "process value"),
        index=output_shape.index if by_output else value_shape.index,
        triangle=TRIANGLE,
        scatter=swings.scatter,
        lag=lag,
    )
    return Answer.TEST_VALVE, reason, process


def _doubt(rows: LoopRows, swings: Oscillation) -> Message | None:
    """Return what speaks against a stuck valve though the shape is right, None for nothing."""
    if swings.scatter > _SWINGS_ALIKE:
        return say(
            "swings_differ",
            "the swings of the output differ by ± {scatter:.0f %}, ± {limit:g %} is the limit for a stuck valve: "
            "export a quieter or longer time",
            scatter=swings.scatter,
            limit=_SWINGS_ALIKE,
        )
    if rows.setpoint is None:
        return None
    share = swing_share(rows.setpoint, rows.value, rows.period_s, swings.period_s)
    if share <= _SETPOINT:
        return None
    return say(
        "set_point_swings",
        "the set point swings with the same period, by {share:.0f %} of the process value's swing, {allowed:g %} are "
        "allowed: export a time with a constant set point, in a cascade with the outer controller in manual",
        share=share,
        allowed=_SETPOINT,
    )


def _stuck(lag: float, output_shape: Shape, value_shape: Shape) -> str | None:
    """Return the process whose loop a stuck valve would make swing so, None for no such process."""
    if _INTEGRAL_DEG <= lag < _MOST_DEG and _is_triangle(output_shape):
        return "self-regulating"
    if _BOTH_DEG <= lag < _INTEGRAL_DEG and _is_triangle(value_shape) and output_shape.index < value_shape.index:
        return "integrating"
    return None


def _is_triangle(shape: Shape) -> bool:
    return shape.halves >= FEWEST_CYCLES and shape.index >= TRIANGLE and abs(shape.peak - 0.5) < _MIDDLE


def _notes(rows: LoopRows) -> tuple[str, ...]:
    notes = []
    if rows.gaps:
        notes.append(
            say(
                "longest_stretch_judged",
                "{gaps} gaps: the longest stretch between them is judged, {judged}; {left_out} are left out.",
                gaps=int(rows.gaps),
                judged=shown_time(rows.duration_s),
                left_out=shown_time(rows.left_out_s),
            )
        )
    return tuple(notes)


def shown_time(seconds: float) -> Message:
    """Return a time in the unit that reads best."""
    if seconds < 120.0:
        return say("in_seconds", "{time:.3g} s", time=seconds)
    if seconds < 7200.0:
        return say("in_minutes", "{time:.3g} min", time=seconds / 60.0)
    return say("in_hours", "{time:.3g} h", time=seconds / 3600.0)


def to_json(found: LoopVerdict) -> dict[str, Any]:
    """Return the verdict as an object of JSON, ``breakaway/loop/1``."""
    swings, shapes = found.oscillation, (found.output_shape, found.value_shape)
    return {
        "schema": "breakaway/loop/1",
        "answer": str(found.answer),
        "reason": found.reason,
        "process": found.process,
        "recording": {
            "samples": int(found.rows.output.size),
            "duration_s": found.rows.duration_s,
            "sample_period_s": found.rows.period_s,
            "gaps": found.rows.gaps,
            "left_out_s": found.rows.left_out_s,
            "has_set_point": found.rows.setpoint is not None,
        },
        "oscillation": None
        if swings is None
        else {
            "period_s": swings.period_s,
            "cycles": swings.cycles,
            "output_swing": swings.output_swing,
            "value_swing": swings.value_swing,
            "regularity": swings.regularity,
            "swing_scatter": swings.scatter,
            "lag_deg": swings.lag_deg,
        },
        "shapes": {
            name: None if one is None else {"index": one.index, "peak": one.peak, "half_cycles": one.halves}
            for name, one in zip(("output", "value"), shapes, strict=True)
        },
        "notes": list(found.notes),
    }
