"""The answer about a loop: test this valve, not the valve, no oscillation, or cannot tell and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

import numpy as np

from estimators.loop_stiction.oscillation import FEWEST_CYCLES, Oscillation, oscillation_of, swing_share
from estimators.loop_stiction.rows import LoopRows, loop_rows
from estimators.loop_stiction.shapes import SINE, TRIANGLE, Shape, shape_of
from valve.recording import FloatArray

# Limits of this project's own, of the benchmark ``loops``.
_FEWEST_ROWS: Final = 12.0  # a period: fewer draw a triangle of any sine
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
    if (reason := _unusable(rows)) is not None:
        return LoopVerdict(Answer.CANNOT_TELL, reason, rows, notes=notes)
    swings = oscillation_of(rows)
    if swings is None:
        longest = shown_time(rows.duration_s / FEWEST_CYCLES)
        reason = f"nothing in the output repeats {FEWEST_CYCLES:g} times or more, with a period up to {longest}"
        return LoopVerdict(Answer.NO_OSCILLATION, reason, rows, notes=notes)
    shapes = shape_of(swings.output_halves), shape_of(swings.value_halves)
    answer, reason, process = _answer(rows, swings, *shapes)
    return LoopVerdict(answer, reason, rows, swings, *shapes, process, notes)


def _unusable(rows: LoopRows) -> str | None:
    """Return why nothing can be said of these rows, None where something can."""
    output, count = rows.output, rows.output.size
    if np.ptp(output) == 0.0:
        return (
            f"the controller output is {output[0]:.4g} in all {count} rows: the controller was in manual, or the "
            "column is another one; export a time in automatic"
        )
    if np.ptp(rows.value) == 0.0:
        return (
            f"the process value is {rows.value[0]:.4g} in all {count} rows: its transmitter is frozen, or the column "
            "is another one; export a time in which it moves"
        )
    if rows.is_drawn:
        return (
            "the rows are a historian's reports of changes, or stand on straight lines between such reports, and these "
            "lines look like a sticking valve: export evenly what was measured, without compression or interpolation"
        )
    changes = np.concatenate([[0], np.flatnonzero(np.diff(output) != 0.0) + 1, [count]])
    still = int(np.diff(changes).max())
    if still > _STANDS * count:
        return (
            f"the controller output does not change for {shown_time(still * rows.period_s)} of "
            f"{shown_time(rows.duration_s)}, {100.0 * _STANDS:g} % are allowed: the controller was in manual or at its "
            "end, or its steps are too coarse; export a time in automatic"
        )
    at_ends = {float(end): float(np.mean(output == end)) for end in (output.min(), output.max())}
    end = max(at_ends, key=lambda one: at_ends[one])
    if at_ends[end] > _SATURATED:
        return (
            f"the controller output stands at its end, {end:.4g}, in {100.0 * at_ends[end]:.0f} % of the rows, "
            f"{100.0 * _SATURATED:g} % are allowed: what is cut off has no shape; export a time within the limits"
        )
    return None


def _answer(
    rows: LoopRows, swings: Oscillation, output_shape: Shape, value_shape: Shape
) -> tuple[Answer, str, str | None]:
    """Return the answer about a loop that oscillates, its reason, and the process that it seems to hold."""
    lag, rows_a_period = swings.lag_deg, swings.period_s / rows.period_s
    if abs(lag) < _PROPORTIONAL_DEG and rows_a_period >= _FEWEST_ROWS_OF_A_LAG:
        reason = (
            f"the output follows the error at once (lag {lag:.0f}°, a stuck valve makes {_BOTH_DEG:g}° or more), so "
            "the proportional action drives it: a gain too high, or a disturbance from outside"
        )
        return Answer.NOT_THE_VALVE, reason, None
    if rows_a_period < _FEWEST_ROWS:
        reason = (
            f"a period of {shown_time(swings.period_s)} has {rows_a_period:.3g} rows, its shape needs "
            f"{_FEWEST_ROWS:g}: export a row every {shown_time(swings.period_s / _FEWEST_ROWS)} or faster"
        )
        return Answer.CANNOT_TELL, reason, None
    relevant = [output_shape] if lag >= _INTEGRAL_DEG else [output_shape, value_shape]
    largest = max(one.index for one in relevant)
    if lag < _MOST_DEG and largest < SINE:
        reason = f"it swings like a sine (index {largest:.2f}, below {SINE:g}): a disturbance from outside, or tuning"
        return Answer.NOT_THE_VALVE, reason, None
    process = _stuck(lag, output_shape, value_shape)
    if process is None:
        reason = (
            f"neither a sine nor the run of a stuck valve fits: index of the output {output_shape.index:.2f}, of the "
            f"process value {value_shape.index:.2f}, {TRIANGLE:g} is a triangle, lag {lag:.0f}°: put the controller in "
            "manual for some periods; if the swing stays, its cause is elsewhere"
        )
        return Answer.CANNOT_TELL, reason, None
    if (reason := _doubt(rows, swings)) != "":
        return Answer.CANNOT_TELL, reason, None
    what, index = (
        ("output", output_shape.index) if process == "self-regulating" else ("process value", value_shape.index)
    )
    reason = (
        f"the {what} runs straight to and fro (index {index:.2f}, a triangle above {TRIANGLE:g}), the output goes the "
        f"same way each time (± {100.0 * swings.scatter:.0f} %) and the integral action drives it (lag {lag:.0f}°): so "
        "it is where a controller waits for a stuck stem"
    )
    return Answer.TEST_VALVE, reason, process


def _doubt(rows: LoopRows, swings: Oscillation) -> str:
    """Return what speaks against a stuck valve though the shape is right, "" for nothing."""
    if swings.scatter > _SWINGS_ALIKE:
        return (
            f"the swings of the output differ by ± {100.0 * swings.scatter:.0f} %, ± {100.0 * _SWINGS_ALIKE:g} % is "
            "the limit for a stuck valve: export a quieter or longer time"
        )
    if rows.setpoint is None:
        return ""
    share = swing_share(rows.setpoint, rows.value, rows.period_s, swings.period_s)
    if share <= _SETPOINT:
        return ""
    return (
        f"the set point swings with the same period, by {100.0 * share:.0f} % of the process value's swing, "
        f"{100.0 * _SETPOINT:g} % are allowed: export a time with a constant set point, in a cascade with the outer "
        "controller in manual"
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
            f"{rows.gaps} gaps: the longest stretch between them is judged, {shown_time(rows.duration_s)}; "
            f"{shown_time(rows.left_out_s)} are left out."
        )
    return tuple(notes)


def shown_time(seconds: float) -> str:
    """Return a time in the unit that reads best."""
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60.0:.3g} min" if seconds < 7200.0 else f"{seconds / 3600.0:.3g} h"


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
