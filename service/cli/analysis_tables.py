"""An analysis object as tables and plain words for a terminal."""

from __future__ import annotations

from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.cli.diagnosis_tables import print_diagnosis
from service.cli.signature_tables import print_signature
from service.shown.next_step import next_step
from service.shown.words import NE107
from service.words.plain_numbers import as_read, plus_minus, scatter_words, with_span
from service.words.sentences import sentences_of, without_end, without_stop
from valve.messages import Message, say
from valve.parameters import PARAMETER_SYMBOLS

_NOT_GIVEN: Final = say("not_identifiable", "not identifiable")
_IN_THE_TABLE: Final = "not_given"  # the code by which an estimate lists what its table shows as missing
_LISTED: Final = "Not given: "  # the same in a text that is no message
_WIDE: Final = 140  # columns of the terminal from which each parameter's meaning has room


def print_analysis(console: Console, analysis: dict[str, Any], sequence: str | None = None) -> None:
    """Print the recording's quality, the methods beside each other, what is missing and why, and the rest.

    ``sequence`` is the one that the test played, None where nobody knows.
    """
    _print_recording(console, analysis["recording"])
    console.print(_parameters(analysis["estimates"], wide=console.width >= _WIDE))
    for line in scatters(analysis["estimates"]):
        _say(console, line)
    for reason in reasons(analysis["estimates"]):
        _say(console, reason)
    print_signature(console, analysis["signature"])
    for tried in analysis.get("held_out", []):
        _print_held_out(console, tried)
    print_diagnosis(console, analysis["discrepancy"])
    if what_next := next_step(analysis, sequence):
        _say(console, say("next", "Next: {step}", step=what_next))
    for note in analysis.get("notes", []):
        _say(console, say("note", "Note: {note}", note=note))
    health = analysis["health"]
    told: list[str] = [without_stop(reason) for reason in health["reasons"]]
    if letter := health["ne107"]:
        told.insert(0, say("state_and_letter", "{state} (NE 107: {letter})", state=_state(letter), letter=letter))
    _say(console, say("health", "Health: {told:; }.", told=tuple(told)))


def _state(letter: str) -> str:
    return NE107[letter].words.lower()


def _say(console: Console, sentence: str) -> None:
    console.print(Text(as_read(sentence)))


def _print_recording(console: Console, recording: dict[str, Any]) -> None:
    table = Table(title="Recording", title_justify="left", show_header=False)
    table.add_column()
    table.add_column(justify="right")
    table.add_row("samples", f"{recording['samples']} over {recording['duration_s']:.4g} s")
    sampling = recording["sampling"]
    if sampling is not None:
        period_s = recording["sample_period_s"]
        table.add_row("sample period", f"{1e3 * period_s:.4g} ms, largest {1e3 * sampling['largest_period_s']:.4g} ms")
        table.add_row("rate achieved", f"{sampling['rate_hz']:.4g} Hz")
        jitter_s = sampling["jitter_rms_s"]
        table.add_row("jitter, rms", f"{1e3 * jitter_s:.3g} ms" if jitter_s >= 1.0e-6 else "below 0.001 ms")
        table.add_row("missed slots", f"{sampling['missed_slots']}")
        if sampling["exchange_s"] is not None:
            table.add_row("request to answer", f"{1e3 * sampling['exchange_s']:.3g} ms (median)")
    table.add_row("gaps", f"{recording['gaps']}")
    table.add_row("position noise, rms", _micrometres(recording["position_noise_m"]))
    table.add_row("channels", ", ".join(recording["channels"]))
    console.print(table)


def _parameters(estimates: list[dict[str, Any]], *, wide: bool) -> Table:
    table = Table(title="Parameters (± is half of the 95 % interval)", title_justify="left")
    table.add_column("parameter", no_wrap=True)
    for estimate in estimates:
        table.add_column(Text(f"{estimate['method'].replace('_', ' ')} ({estimate['status']})"), justify="right")
    for symbol, entry in PARAMETER_SYMBOLS.items():
        cells = [_cell(estimate["parameters"][symbol]) for estimate in estimates]
        meaning = f"  {entry.meaning}" if wide else ""
        table.add_row(Text(f"{symbol} [{entry.unit}]{meaning}"), *cells)
    residuals = [_micrometres(estimate["residual_rms_m"]) for estimate in estimates]
    table.add_row("residual, rms" if wide else "residual", *residuals)
    return table


def _cell(parameter: dict[str, Any]) -> str:
    if parameter["value"] is None:
        return _NOT_GIVEN
    if parameter["ci95"] is None:
        return plus_minus(parameter["value"], None)
    low, high = parameter["ci95"]
    return plus_minus(parameter["value"], max(high - parameter["value"], parameter["value"] - low))


def scatters(estimates: list[dict[str, Any]]) -> list[str]:
    """What varies in the test itself: ``garcia: F_s 1708 N (1695 to 1721), from breakaway to breakaway ± 2.4 %``."""
    lines: list[str] = []
    for estimate in estimates:
        for symbol, parameter in estimate["parameters"].items():
            words = scatter_words(symbol, parameter["value"], parameter.get("scatter"))
            if not words:
                continue
            low, high = parameter["ci95"] or (parameter["value"], parameter["value"])
            value, span = with_span(parameter["value"], low, high)
            method = estimate["method"].replace("_", " ")
            lines.append(
                say(
                    "varies_in_test",
                    "{method}: {symbol} {value} {unit} ({span}), {words}.",
                    method=method,
                    symbol=symbol,
                    value=value,
                    unit=parameter["unit"],
                    span=span,
                    words=words,
                )
            )
    return lines


def _micrometres(length_m: float | None) -> str:
    if length_m is None:
        return "unknown"
    return f"{1e6 * length_m:.4g} um" if length_m == 0.0 or length_m >= 1.0e-9 else "below 0.001 um"


def reasons(estimates: list[dict[str, Any]]) -> list[str]:
    """Why values are missing or weak: each reason once, after the methods and parameters that it belongs to."""
    whose: dict[str, dict[tuple[str, ...], list[str]]] = {}
    for estimate in estimates:
        method, said = estimate["method"].replace("_", " "), estimate["message"]
        sentences = sentences_of(said)
        of_method: dict[str, list[str]] = {sentence: [] for sentence in sentences if not _is_in_the_table(sentence)}
        for symbol, parameter in estimate["parameters"].items():
            note = without_end(parameter["note"], sentences)
            if note not in said:
                of_method.setdefault(note, []).append(symbol)
        for reason, symbols in of_method.items():
            whose.setdefault(reason, {}).setdefault(tuple(symbols), []).append(method)
    return [
        say("reason_of", "{owners}: {reason}", owners=_owners(owners), reason=reason)
        for reason, owners in whose.items()
    ]


def _is_in_the_table(sentence: str) -> bool:
    return sentence.code == _IN_THE_TABLE if isinstance(sentence, Message) else sentence.startswith(_LISTED)


def _owners(owners: dict[tuple[str, ...], list[str]]) -> str:
    return "; ".join(
        " and ".join(methods) + (f", {', '.join(symbols)}" if symbols else "") for symbols, methods in owners.items()
    )


def _print_held_out(console: Console, tried: dict[str, Any]) -> None:
    parts = []
    for method, rmse_m in tried["rmse_m"].items():
        note = tried["notes"].get(method)
        found = "unknown" if rmse_m is None else f"{_micrometres(rmse_m)} rms"
        of_method = say("misfit_of_method", "{method} {found}", method=method.replace("_", " "), found=found)
        parts.append(of_method if not note else say("with_note", "{said} ({note})", said=of_method, note=note))
    _say(
        console,
        say(
            "held_out",
            "Held-out {file}: simulated beside measured position: {parts:; }; noise {noise}.",
            file=tried["file"],
            parts=tuple(parts),
            noise=_micrometres(tried["position_noise_m"]),
        ),
    )
