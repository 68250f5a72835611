"""An analysis in few words: the verdict, and five lines of what a technician asks of a valve first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from service.health.acceptance import remarked
from service.shown.next_step import next_step
from service.words.plain_numbers import as_read, half_width, plus_minus, scatter_words
from service.words.sentences import NO_FAULT, as_sentence

_NOT_KNOWN: Final = "not known from this recording"
_METHODS: Final = ("maximum_likelihood", "regression", "garcia")  # whose value is shown, the first that is ok
_STATUSES: Final = ("ok", "poor")


def summary_of(analysis: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the answer of an upload has under ``summary``: sentences of the verdict, and named lines."""
    return {
        "verdict": [as_read(line) for line in verdict_lines(analysis)],
        "lines": [{"name": name, "words": as_read(words)} for name, words in summary_lines(analysis)],
        "notes": [as_read(note) for note in analysis.get("notes", [])],
    }


def verdict_lines(analysis: Mapping[str, Any]) -> list[str]:
    """Return what was found, as sentences: the verdict, its cause and what to do."""
    found = analysis["discrepancy"]
    verdict, message = found["verdict"], as_sentence(found.get("message") or "")
    causes = found.get("causes") or []
    if verdict == "none":
        return [" ".join([NO_FAULT, *_some(message.removeprefix(NO_FAULT).strip())])]
    if verdict == "not_assessed":
        return [f"Not assessed: {message[:1].lower()}{message[1:]}" if message else "Not assessed."]
    if verdict == "unexplained" or not causes:
        return ["Something is there that no cause of the catalogue explains.", *_some(next_step(analysis, None))]
    small = remarked(analysis)
    seen = [f"Seen, does not matter yet: {one['sentence']}" for one in causes if one["cause"] in small]
    causes = [one for one in causes if one["cause"] not in small]
    if not causes:
        return [NO_FAULT, *seen]
    lines = [f"{_plain(one['cause']).capitalize()}: {one['sentence']} What to do: {one['action']}" for one in causes]
    lines += seen
    if verdict == "likely":
        return [f"Probably {lines[0][:1].lower()}{lines[0][1:]} This is not proven.", *lines[1:]]
    if verdict == "ambiguous":
        rivals = ", ".join(_plain(name) for name in found.get("not_told_apart_from") or [])
        lines.append(f"It could as well be: {rivals}." if rivals else "Other causes fit as well.")
        separating = found.get("separating_test")
        lines += _some(f"To tell them apart: {separating['sentence']}" if separating else "")
    return lines


def _some(sentence: str) -> list[str]:
    return [sentence] if sentence else []


def summary_lines(analysis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return five lines, each with its name: what a technician asks of a valve first."""
    signature, estimates = analysis["signature"], analysis["estimates"]
    friction = _value(estimates, "F_c", 1.0, "N")
    share = signature.get("friction_mean_percent")
    if share is not None:
        friction += f"; {plus_minus(share, None)} % of the actuator's force"
    spring = _value(estimates, "k", 1.0e-3, "N/mm")
    bench = signature.get("bench_set_pa")
    if bench is not None and None not in bench:
        low, high = (float(f"{end / 1.0e3:.3f}") for end in bench)
        spring += f"; bench set {low:.4g} to {high:.4g} kPa"
    dead_band = signature.get("dead_band_percent")
    return [
        ("Friction", friction),
        ("Breakaway", _value(estimates, "F_s", 1.0, "N")),
        ("Spring rate", spring),
        ("Dead band", _NOT_KNOWN if dead_band is None else f"{plus_minus(dead_band, None)} % of the span"),
        ("Recording", _recording(analysis["recording"])),
    ]


def _value(estimates: Sequence[Mapping[str, Any]], symbol: str, scale: float, unit: str) -> str:
    by_method = {one["method"]: one for one in estimates}
    for status in _STATUSES:
        for method in _METHODS:
            one = by_method.get(method)
            if one is None or one["status"] != status or one["parameters"][symbol]["value"] is None:
                continue
            entry = one["parameters"][symbol]
            shown = f"{plus_minus(scale * entry['value'], half_width(entry, scale))} {unit}"
            varies = scatter_words(symbol, entry["value"], entry.get("scatter"))
            shown += f", {varies}" if varies else ""
            return shown if status == "ok" else f"{shown} (poor fit)"
    return _NOT_KNOWN


def _recording(recording: Mapping[str, Any]) -> str:
    sampling, stroke = recording.get("sampling"), recording.get("position_range_m")
    words = f"{recording['samples']} rows over {recording['duration_s']:.4g} s"
    if sampling is not None:
        words += f" at {sampling['rate_hz']:.4g} Hz"
    if stroke is not None:
        # + 0.0: no minus before a zero
        words += f", travel {round(1.0e3 * stroke[0], 1) + 0.0:g} to {round(1.0e3 * stroke[1], 1) + 0.0:g} mm"
    if recording["gaps"]:
        words += f", {recording['gaps']} gaps"
    return words


def _plain(cause: str) -> str:
    return cause.replace("_", " ")
