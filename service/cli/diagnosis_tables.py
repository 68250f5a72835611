"""A diagnosis as words and a small table for a terminal: what is wrong, what to do, what it gains, what else it is."""

from __future__ import annotations

from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.shown.diagnosis_words import beside_no_fault, cause_line, plain_cause, to_tell_apart
from service.words.plain_numbers import as_read, with_span
from service.words.sentences import together
from valve.messages import say

_NO_GAIN: Final = 0.005  # of the misfit without the cause
_VERDICTS: Final = {
    "none": say("in_short_none", "no fault found"),
    "named": say("in_short_named", "named"),
    "likely": say("in_short_likely", "probably, not proven"),
    "ambiguous": say("in_short_ambiguous", "several causes would explain it"),
    "unexplained": say("in_short_unexplained", "something is there that no cause of the catalogue explains"),
    "not_assessed": say("in_short_not_assessed", "not assessed"),
}


def print_diagnosis(console: Console, discrepancy: dict[str, Any], indent: str = "") -> None:
    """Print the verdict, each cause with what to do, what it gains, what else it could be and how to tell."""
    for line in diagnosis_lines(discrepancy):
        console.print(Text(indent + as_read(line)))
    if discrepancy.get("causes"):
        console.print(_parameters(discrepancy["causes"]))
    model = discrepancy.get("extended_model")
    if model is not None:
        console.print(_valve(model["parameters"]))


def diagnosis_lines(discrepancy: dict[str, Any]) -> list[str]:
    """Return the diagnosis as sentences, the verdict first."""
    verdict = discrepancy["verdict"]
    found = say("diagnosis", "Diagnosis: {verdict}.", verdict=_VERDICTS.get(verdict, verdict))
    lines: list[str] = [together([found, *beside_no_fault(discrepancy.get("message") or "")])]
    misfit = discrepancy.get("misfit")
    if misfit is not None and misfit["where"] and verdict not in ("none", "not_assessed"):
        lines.append(say("misfit", "Misfit: {where}", where=misfit["where"]))
    lines += [cause_line(cause, plain_cause(cause["cause"])) for cause in discrepancy.get("causes", [])]
    lines += [
        say("remark", "Remark: {sentence}", sentence=remark["sentence"]) for remark in discrepancy.get("remarks") or ()
    ]
    rivals = discrepancy.get("not_told_apart_from")
    if rivals:
        lines.append(
            say(
                "instead_of",
                "Instead of {cause} it could as well be: {rivals:, }.",
                cause=plain_cause(discrepancy["causes"][0]["cause"]),
                rivals=tuple(plain_cause(name) for name in rivals),
            )
        )
    # without a cause there is nothing to gain by
    gains = (discrepancy.get("gains") or [discrepancy.get("gain")]) if discrepancy.get("causes") else []
    lines += [_gain(gain) for gain in gains if gain is not None and not _is_nothing(gain)]
    separating = discrepancy.get("separating_test")
    if separating is not None:
        lines.append(to_tell_apart(separating["sentence"]))
    return lines


def _is_nothing(gain: dict[str, Any]) -> bool:
    """Whether a cause changes no prediction: of what is measured anyway, such as a supply that ends."""
    before_m, after_m = gain["rmse_before_m"], gain["rmse_after_m"]
    return before_m is not None and abs(before_m - after_m) <= _NO_GAIN * before_m


def _gain(gain: dict[str, Any]) -> str:
    if gain["rmse_before_m"] is None:
        return say(
            "gain_of_force",
            "Gain on {held_out}: the force is missed by {after:.3g N} rms ({after_percent:.2g} %) with it in the "
            "model, "
            "by {before:.3g N} ({before_percent:.2g} %) without.",
            held_out=gain["held_out"],
            after=gain["rmse_after_n"],
            after_percent=gain["error_after_percent"],
            before=gain["rmse_before_n"],
            before_percent=gain["error_before_percent"],
        )
    before_m, after_m, floor_m = gain["rmse_before_m"], gain["rmse_after_m"], gain["noise_floor_m"]
    possible = before_m**2 - floor_m**2
    after, before, noise = (_length(length_m) for length_m in (after_m, before_m, floor_m))
    missed = say(
        "gain_of_position",
        "Gain on {held_out}: the simulation misses by {after} rms with it in the model, by {before} without",
        held_out=gain["held_out"],
        after=after,
        before=before,
    )
    if possible > 0.0:
        share = min((before_m**2 - after_m**2) / possible, 1.0)
        missed = say("of_what_could_be", "{missed}, {share:.0f %} of what could be gained", missed=missed, share=share)
    return say("noise_is", "{missed}; the noise is {noise}.", missed=missed, noise=noise)


def _parameters(causes: list[dict[str, Any]]) -> Table:
    table = Table(title="What was found", title_justify="left")
    for heading in ("cause", "parameter"):
        table.add_column(heading)
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    for found in causes:
        for name, entry in found["parameters"].items():
            if entry["ci95"][0] == entry["ci95"][1]:
                # held, as where a gradient is counted from: nothing that the recording told
                continue
            value, span = with_span(entry["value"], *entry["ci95"])
            unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
            table.add_row(plain_cause(found["cause"]), name, f"{value}{unit}", span)
    return table


def _valve(parameters: dict[str, Any]) -> Table:
    """Return the valve's own parameters as they are with the cause in the model."""
    table = Table(title="The valve with the cause in its model", title_justify="left")
    table.add_column("parameter")
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    for symbol, entry in parameters.items():
        table.add_row(Text(f"{symbol} [{entry['unit']}]"), *with_span(entry["value"], *entry["ci95"]))
    return table


def _length(length_m: float) -> str:
    if length_m < 1.0e-3:
        return say("length_in_um", "{length:.3g um}", length=length_m)
    return say("length_in_mm", "{length:.3g mm}", length=length_m)
