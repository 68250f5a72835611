"""A loop's verdict in words: the answer, why, and what it rests on."""

from __future__ import annotations

from typing import Final

from estimators.loop_stiction.verdict import Answer, LoopVerdict, shown_time

_ANSWERS: Final = {
    Answer.TEST_VALVE: "oscillates, and the valve is the likely cause: test this valve",
    Answer.NOT_THE_VALVE: "oscillates, but not by the valve: look at the tuning, or for a disturbance",
    Answer.NO_OSCILLATION: "no oscillation",
    Answer.CANNOT_TELL: "cannot tell whether the valve sticks",
}


def loop_sentence(found: LoopVerdict, subject: str) -> str:
    """Return the answer with its subject, one sentence."""
    return f"{subject}: {_ANSWERS[found.answer]}."


def loop_lines(found: LoopVerdict, output_unit: str, value_unit: str) -> list[tuple[str, str]]:
    """Return why, then period, swings, evidence and record, each with its name."""
    lines = [("Why", f"{found.reason[0].upper()}{found.reason[1:]}.")]
    swings = found.oscillation
    if swings is not None:
        of_output = f"output {swings.output_swing:.3g} {output_unit}".rstrip()
        of_value = f"process value {swings.value_swing:.3g} {value_unit}".rstrip()
        evidence = (
            f"{_shapes(found)}; lag of the output {swings.lag_deg:.0f}°; swings differ by "
            f"± {100.0 * swings.scatter:.0f} %; regularity {min(swings.regularity, 99.0):.2g}"
        )
        lines += [
            ("Period", f"{shown_time(swings.period_s)}, {swings.cycles:.0f} times in the record"),
            ("Swing", f"{of_output}, {of_value}, from end to end"),
            ("Evidence", evidence),
        ]
    rows = found.rows
    gaps = f", {rows.gaps} gaps" if rows.gaps else ""
    lines.append(
        ("Record", f"{shown_time(rows.duration_s)}, {rows.output.size} rows, {rows.period_s:.3g} s apart{gaps}")
    )
    return lines


def _shapes(found: LoopVerdict) -> str:
    named = {"output": found.output_shape, "process value": found.value_shape}
    told = [f"{name} {one.index:.2f}" for name, one in named.items() if one is not None]
    return f"triangle (1) or sine (0): {', '.join(told)}"
