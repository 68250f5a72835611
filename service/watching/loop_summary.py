"""A loop's verdict in words: the answer, why, and what it rests on."""

from __future__ import annotations

from typing import Final

from estimators.loop_stiction.verdict import Answer, LoopVerdict, shown_time
from service.words.sentences import as_sentence
from valve.messages import Message, joined, say

_ANSWERS: Final = {
    Answer.TEST_VALVE: say("oscillates_by_valve", "oscillates, and the valve is the likely cause: test this valve"),
    Answer.NOT_THE_VALVE: say(
        "oscillates_not_by_valve", "oscillates, but not by the valve: look at the tuning, or for a disturbance"
    ),
    Answer.NO_OSCILLATION: say("no_oscillation", "no oscillation"),
    Answer.CANNOT_TELL: say("cannot_tell_sticks", "cannot tell whether the valve sticks"),
}


def loop_sentence(found: LoopVerdict, subject: str) -> Message:
    """Return the answer with its subject, one sentence."""
    return say("loop_answer", "{subject}: {answer}.", subject=subject, answer=_ANSWERS[found.answer])


def loop_lines(found: LoopVerdict, output_unit: str, value_unit: str) -> list[tuple[str, str]]:
    """Return why, then period, swings, evidence and record, each with its name."""
    lines: list[tuple[str, str]] = [(say("why", "Why"), as_sentence(found.reason))]
    swings = found.oscillation
    if swings is not None:
        evidence = say(
            "loop_evidence",
            "triangle (1) or sine (0): {shapes:, }; lag of the output {lag:.0f}°; swings differ by ± {scatter:.0f %}; "
            "regularity {regularity:.2g}",
            shapes=tuple(_shapes(found)),
            lag=swings.lag_deg,
            scatter=swings.scatter,
            regularity=min(swings.regularity, 99.0),
        )
        period = say(
            "period_times",
            "{period}, {cycles:.0f} times in the record",
            period=shown_time(swings.period_s),
            cycles=swings.cycles,
        )
        swing = say(
            "swing_of_both",
            "output {output}, process value {value}, from end to end",
            output=_with_unit(swings.output_swing, output_unit),
            value=_with_unit(swings.value_swing, value_unit),
        )
        lines += [(say("period", "Period"), period), (say("swing", "Swing"), swing)]
        lines.append((say("evidence", "Evidence"), evidence))
    rows = found.rows
    record: Message = say(
        "record_of_loop",
        "{duration}, {rows} rows, {period:.3g} s apart",
        duration=shown_time(rows.duration_s),
        rows=int(rows.output.size),
        period=rows.period_s,
    )
    if rows.gaps:
        record = joined(", ", (record, say("so_many_gaps", "{gaps} gaps", gaps=int(rows.gaps))))
    lines.append((say("record", "Record"), record))
    return lines


def _with_unit(value: float, unit: str) -> Message:
    if not unit:
        return say("swing_without_unit", "{swing:.3g}", swing=value)
    return say("swing_in_own_unit", "{swing:.3g} {unit}", swing=value, unit=unit)


def _shapes(found: LoopVerdict) -> list[Message]:
    told = []
    if found.output_shape is not None:
        told.append(say("shape_of_output", "output {index:.2f}", index=found.output_shape.index))
    if found.value_shape is not None:
        told.append(say("shape_of_process_value", "process value {index:.2f}", index=found.value_shape.index))
    return told
