"""An analysis in few words: the verdict, and five lines of what a technician asks of a valve first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from service.health.acceptance import remarked
from service.shown.diagnosis_words import (
    UNEXPLAINED,
    beside_no_fault,
    cause_line,
    plain_cause,
    seen_without_matter,
    to_tell_apart,
)
from service.shown.next_step import next_step
from service.words.plain_numbers import as_read, plus_minus, scatter_words
from service.words.reader import Reader
from service.words.sentences import NO_FAULT, as_clause, as_heading, together
from service.words.units import measured_said
from valve.messages import say

_NOT_KNOWN: Final = say("not_known_from_recording", "not known from this recording")
_METHODS: Final = ("maximum_likelihood", "regression", "garcia")  # whose value is shown, the first that is ok
_STATUSES: Final = ("ok", "poor")


def summary_of(analysis: Mapping[str, Any], reader: Reader | None = None) -> dict[str, Any]:
    """Return what the answer of an upload has under ``summary``: sentences of the verdict, and named lines.

    They are as the ``reader`` of a page reads them; a program has English and the units of the analysis.
    """
    told = as_read if reader is None else reader.told
    return {
        "verdict": [told(line) for line in verdict_lines(analysis)],
        "lines": [{"name": told(name), "words": told(words)} for name, words in summary_lines(analysis)],
        "notes": [told(note) for note in analysis.get("notes", [])],
    }


def verdict_lines(analysis: Mapping[str, Any]) -> list[str]:
    """Return what was found, as sentences: the verdict, its cause and what to do."""
    found = analysis["discrepancy"]
    verdict, message = found["verdict"], found.get("message") or ""
    causes = found.get("causes") or []
    if verdict == "none":
        return [together([NO_FAULT, *beside_no_fault(message)])]
    if verdict == "not_assessed":
        if not message:
            return [say("not_assessed", "Not assessed.")]
        return [say("not_assessed_because", "Not assessed: {why}.", why=as_clause(message))]
    if verdict == "unexplained" or not causes:
        return [UNEXPLAINED, *_some(next_step(analysis, None))]
    small = remarked(analysis)
    seen: list[str] = [seen_without_matter(one["sentence"]) for one in causes if one["cause"] in small]
    causes = [one for one in causes if one["cause"] not in small]
    if not causes:
        return [NO_FAULT, *seen]
    lines = [*(cause_line(one, as_heading(plain_cause(one["cause"]))) for one in causes), *seen]
    if verdict == "likely":
        first = say(
            "probable_cause",
            "Probably {line} This is not proven.",
            line=cause_line(causes[0], plain_cause(causes[0]["cause"])),
        )
        return [first, *lines[1:]]
    if verdict == "ambiguous":
        rivals = tuple(plain_cause(name) for name in found.get("not_told_apart_from") or [])
        lines.append(
            say("could_as_well_be", "It could as well be: {rivals:, }.", rivals=rivals)
            if rivals
            else say("other_causes_fit", "Other causes fit as well.")
        )
        separating = found.get("separating_test")
        lines += [to_tell_apart(separating["sentence"])] if separating else []
    if verdict == "named":
        lines += _some(message)  # what could not be looked for beside it
    return lines


def _some(sentence: str) -> list[str]:
    return [sentence] if sentence else []


def summary_lines(analysis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return five lines, each with its name: what a technician asks of a valve first."""
    signature, estimates = analysis["signature"], analysis["estimates"]
    friction = _value(estimates, "F_c")
    share = signature.get("friction_mean_percent")
    if share is not None:
        of_force = say("share_of_force", "{percent} % of the actuator's force", percent=plus_minus(share, None))
        friction = together([friction, of_force], "; ")
    spring = _value(estimates, "k")
    bench = signature.get("bench_set_pa")
    if bench is not None and None not in bench:
        low, high = (round(end, 0) for end in bench)  # 0.001 kPa
        between = say("bench_set_between", "bench set {low:.4g in kPa} to {high:.4g kPa}", low=low, high=high)
        spring = together([spring, between], "; ")
    dead_band = signature.get("dead_band_percent")
    return [
        (say("line_friction", "Friction"), friction),
        (say("line_breakaway", "Breakaway"), _value(estimates, "F_s")),
        (say("line_spring_rate", "Spring rate"), spring),
        (say("line_dead_band", "Dead band"), _NOT_KNOWN if dead_band is None else _of_span(dead_band)),
        (say("line_recording", "Recording"), _recording(analysis["recording"])),
    ]


def _of_span(percent: float) -> str:
    return say("percent_of_span", "{percent} % of the span", percent=plus_minus(percent, None))


def _value(estimates: Sequence[Mapping[str, Any]], symbol: str) -> str:
    by_method = {one["method"]: one for one in estimates}
    for status in _STATUSES:
        for method in _METHODS:
            one = by_method.get(method)
            if one is None or one["status"] != status or one["parameters"][symbol]["value"] is None:
                continue
            entry = one["parameters"][symbol]
            shown = measured_said(entry["value"], entry["ci95"], entry["unit"])
            told = together([shown, scatter_words(symbol, entry["value"], entry.get("scatter"))], ", ")
            return told if status == "ok" else say("poor_fit", "{value} (poor fit)", value=told)
    return _NOT_KNOWN


def _recording(recording: Mapping[str, Any]) -> str:
    sampling, stroke = recording.get("sampling"), recording.get("position_range_m")
    said: list[str] = [
        say("rows_over", "{rows} rows over {lasted:.4g} s", rows=recording["samples"], lasted=recording["duration_s"])
    ]
    if sampling is not None:
        said = [say("at_rate", "{rows} at {rate:.4g} Hz", rows=said[0], rate=sampling["rate_hz"])]
    if stroke is not None:
        # + 0.0: no minus before a zero
        low, high = (round(end, 4) + 0.0 for end in stroke)
        said.append(say("travel_between", "travel {low:g in mm} to {high:g mm}", low=low, high=high))
    if recording["gaps"]:
        said.append(say("count_of_gaps", "{n} gaps", n=recording["gaps"]))
    return together(said, ", ")
