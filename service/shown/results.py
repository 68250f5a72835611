"""A finished test as page and report tell it: the methods beside each other, what is missing and why, the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import tzinfo
from typing import Any

from service.figures.methods import all_estimates, method_words
from service.health.acceptance import remarked
from service.model.analysis import words_of_repetition
from service.model.requester import person_of
from service.model.run import Run
from service.model.stands_words import where_it_stands
from service.shown.diagnosis_words import beside_no_fault, plain_cause
from service.shown.words import FIGURES, POSITION_NOISE, SAMPLES, VERDICTS
from service.words.names import named
from service.words.plain_numbers import scatter_words
from service.words.sentences import NO_FAULT, together
from valve.carried_digits import carried_places
from valve.messages import Message, say
from valve.parameters import PARAMETER_SYMBOLS


@dataclass(frozen=True, slots=True)
class Cell:
    """One method's value of one parameter, SI; None where the data cannot give it.

    ``scatter`` says how much the quantity itself varies in the test, in words; empty where none is seen.
    """

    value: float | None
    ci95: tuple[float, float] | None
    scatter: str = ""


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter with the methods' values."""

    symbol: str
    meaning: str
    unit: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class FigureRow:
    """One figure of the signature beside the baseline's; ``limit`` is by how much it may differ, None without one."""

    words: str
    unit: str
    value: float | None
    ci95: tuple[float, float] | None
    was: float | None
    note: str
    tells: str
    limit: float | None = None
    is_kept: bool = True


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The diagnosis in sentences; ``verdict`` is the analysis object's word.

    ``causes`` are those that matter, ``remarks`` those that were seen and do not matter yet.
    """

    verdict: str
    headline: str
    message: str
    causes: tuple[Mapping[str, Any], ...]
    others: tuple[str, ...]
    separating_test: Any
    gain: Mapping[str, Any] | None
    remarks: tuple[Mapping[str, Any], ...] = ()


def method_names(analysis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what each method is called, and how its fit is (ok, poor, failed)."""
    return [(method_words(one["method"]), one["status"]) for one in all_estimates(analysis)]


def parameter_rows(analysis: Mapping[str, Any]) -> list[ParameterRow]:
    """Return a row a parameter, a cell a method."""
    estimates = all_estimates(analysis)
    return [
        ParameterRow(
            symbol,
            named(entry.meaning),
            entry.unit,
            tuple(_cell(symbol, (estimate.get("parameters") or {}).get(symbol)) for estimate in estimates),
        )
        for symbol, entry in PARAMETER_SYMBOLS.items()
    ]


def _cell(symbol: str, entry: Mapping[str, Any] | None) -> Cell:
    if entry is None or entry.get("value") is None:
        return Cell(None, None)
    words = scatter_words(symbol, entry["value"], entry.get("scatter"))
    return Cell(entry["value"], _pair(entry.get("ci95")), words)


def _pair(values: Any) -> tuple[float, float] | None:
    return None if values is None else (values[0], values[1])


def missing_reasons(analysis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return why no method gives a value: parameters and reason, each reason once, that of the last method."""
    said: dict[str, list[str]] = {}
    for symbol in PARAMETER_SYMBOLS:
        found = [(estimate.get("parameters") or {}).get(symbol) for estimate in all_estimates(analysis)]
        entries = [entry for entry in found if entry is not None]
        if entries and all(entry.get("value") is None for entry in entries):
            said.setdefault(entries[-1]["note"], []).append(symbol)
    return [(", ".join(symbols), reason) for reason, symbols in said.items()]


def method_messages(analysis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what the methods whose fit is not good say of it."""
    return [
        (method_words(one["method"]), one["message"])
        for one in analysis.get("estimates") or ()
        if one["status"] != "ok" and one.get("message")
    ]


def figure_rows(analysis: Mapping[str, Any], baseline: Mapping[str, Any] | None) -> list[FigureRow]:
    """Return the figures of the signature; what has neither a value nor a reason is left out."""
    signature = analysis.get("signature") or {}
    old = (baseline or {}).get("signature") or {}
    notes, intervals = signature.get("notes") or {}, signature.get("intervals") or {}
    rows = [
        FigureRow(
            words,
            unit,
            signature.get(key),
            _pair((intervals.get(key) or {}).get("ci95")),
            old.get(key),
            notes.get(key, ""),
            tells,
        )
        for key, words, unit, tells in FIGURES
    ]
    rows += _bench_rows(signature, old)
    judged = {one["name"]: one for one in (analysis.get("health") or {}).get("changes") or ()}
    names = [key for key, *_ in FIGURES] + ["bench_low_pa", "bench_high_pa"]
    return [
        _judged(row, judged.get(name))
        for name, row in zip(names, rows, strict=True)
        if row.value is not None or row.note
    ]


def _judged(row: FigureRow, change: Mapping[str, Any] | None) -> FigureRow:
    if change is None or change.get("limit") is None:
        return row
    return replace(row, limit=change["limit"], is_kept=bool(change.get("kept", True)))


def told_once(rows: Sequence[FigureRow]) -> tuple[list[FigureRow], list[tuple[str, str]]]:
    """Return the rows, and each reason why several figures are not given once, after the figures' names.

    A row that would show nothing but such a reason is left out.
    """
    whose: dict[str, list[str]] = {}
    for row in rows:
        if row.value is None:
            whose.setdefault(row.note, []).append(row.words)
    several = {note: together(words, "; ") for note, words in whose.items() if len(words) > 1}
    shown = [
        replace(row, note="") if row.value is None and row.note in several else row
        for row in rows
        if row.value is not None or row.was is not None or row.note not in several
    ]
    return shown, [(names, note) for note, names in several.items()]


def _bench_rows(signature: Mapping[str, Any], old: Mapping[str, Any]) -> list[FigureRow]:
    bench, was = signature.get("bench_set_pa") or (None, None), old.get("bench_set_pa") or (None, None)
    ends = (
        (say("figure_bench_low", "Bench set, closed end"), say("tells_bench_low", "the spring's adjustment")),
        (say("figure_bench_high", "Bench set, open end"), ""),
    )
    known = ((signature.get("intervals") or {}).get("bench_set_pa") or {}).get("ci95") or (None, None)
    now, before = bench if None not in known else _to_the_larger(bench), _to_the_larger(was)
    return [
        FigureRow(words, "Pa", now[place], _pair(known[place]), before[place], "", tells)
        for place, (words, tells) in enumerate(ends)
    ]


def _to_the_larger(ends: Sequence[float | None]) -> list[float | None]:
    """Round both ends of a range as the larger one is known: a spring that starts at zero reads 0, not -0.0001."""
    places, _ = carried_places(max((abs(one) for one in ends if one), default=1.0))
    return [None if one is None else round(one, places) + 0.0 for one in ends]  # + 0.0: no minus before a zero


def diagnosis_of(analysis: Mapping[str, Any]) -> Diagnosis:
    """Return the diagnosis as the page tells it: no fault where all that was seen does not matter yet."""
    found = analysis.get("discrepancy") or {"verdict": "not_assessed"}
    verdict, small = str(found["verdict"]), remarked(analysis)
    seen = tuple(found.get("causes") or ())
    causes = tuple(one for one in seen if one["cause"] not in small)
    is_harmless = bool(seen) and not causes
    return Diagnosis(
        verdict,
        NO_FAULT if is_harmless else VERDICTS.get(verdict, verdict),
        "" if is_harmless else together(beside_no_fault(found.get("message") or "")),
        causes,
        () if is_harmless else tuple(plain_cause(str(other)) for other in found.get("not_told_apart_from") or ()),
        None if is_harmless else found.get("separating_test"),
        found.get("gain"),
        tuple(one for one in seen if one["cause"] in small),
    )


def reasons_beside(reasons: Sequence[str], diagnosis: Diagnosis) -> list[str]:
    """Return the reasons of a state without those that are a cause's sentence and action, word by word: they follow."""
    told = {together([cause.get("sentence") or "", cause.get("action") or ""]) for cause in diagnosis.causes}
    return [reason for reason in reasons if reason not in told]


def recording_facts(run: Run, zone: tzinfo | None) -> list[tuple[str, str]]:
    """Return how the recording was taken and what it hashes to, for the foot of the page."""
    summary: Mapping[str, Any] = (run.analysis or {}).get("recording") or {}
    sampling: Mapping[str, Any] = summary.get("sampling") or {}
    noise_m = summary.get("position_noise_m")
    facts = [
        (SAMPLES, _samples(summary)),
        (say("fact_taken", "Taken"), _taken(summary)),
        (say("fact_rate", "Rate"), rate_words(sampling) if sampling else None),
        (POSITION_NOISE, None if noise_m is None else rms(noise_m)),
        (say("fact_after_motion", "After the motion"), where_it_stands(run)),
        (say("fact_asked_by", "Asked for by"), person_of(run.requested_by)),
        (say("fact_schedule", "Schedule"), run.schedule),
        (say("fact_sha256", "SHA-256"), run.recording_sha256),
        (say("fact_software", "Software"), run.software),
        (say("fact_analysis", "Analysis"), words_of_repetition(run, zone)),
        (say("fact_test", "Test"), run.id),
    ]
    return [(name, value) for name, value in facts if value]


def _samples(summary: Mapping[str, Any]) -> str | None:
    if "samples" not in summary:
        return None
    return say("samples_missing", "{samples}, {gaps} missing", samples=summary["samples"], gaps=summary.get("gaps", 0))


def _taken(summary: Mapping[str, Any]) -> str | None:
    if "acquisition" not in summary:
        return None
    lasted_s: float = summary["duration_s"]
    return say("taken_over", "{how}, {lasted:.4g} s", how=named(summary["acquisition"]), lasted=lasted_s)


def rate_words(sampling: Mapping[str, Any]) -> Message:
    """Return how fast a recording was sampled, and how many of its slots were missed."""
    return say(
        "rate_and_missed",
        "{rate:.4g} Hz, {missed} slots missed",
        rate=sampling["rate_hz"],
        missed=sampling["missed_slots"],
    )


def rms(length_m: float) -> Message:
    """Return a length as the root of its mean square."""
    return say("length_rms", "{length:.3g m} rms", length=length_m)
