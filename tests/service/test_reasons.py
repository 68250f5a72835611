"""The reasons that stand below a table of estimates: each once, with whom it belongs to."""

from __future__ import annotations

from io import StringIO
from typing import Any

from rich.console import Console

from estimators.signature.measure import measure_signature
from estimators.steps.response import step_figures
from service.cli.analysis_tables import print_analysis, reasons
from tests.support.nominal_recordings import NOMINAL, recorded, triangle_test
from valve.messages import Message, joined, say
from valve.parameters import PARAMETER_SYMBOLS
from valve.waveform import steps

TOO_SLOW = "The sampling rate is too low: capture in the device."


def _estimate(method: str, message: str, notes: dict[str, str]) -> dict[str, Any]:
    parameters: dict[str, dict[str, Any]] = {
        symbol: {"value": None if symbol in notes else 52538.123, "ci95": None, "note": notes.get(symbol, "")}
        for symbol in PARAMETER_SYMBOLS
    }
    parameters["k"]["ci95"] = [52500.0, 52570.0]
    return {
        "method": method,
        "status": "poor",
        "message": message,
        "parameters": parameters,
        "residual_rms_m": 8.756e-4,
    }


ESTIMATES = [
    _estimate("regression", f"{TOO_SLOW} Not given: m, F_v.", {"m": TOO_SLOW, "F_v": TOO_SLOW, "DV": "one speed"}),
    _estimate("garcia", f"{TOO_SLOW} Not given: m.", {"m": f"known to +-55 % only: {TOO_SLOW}", "DV": "one speed"}),
]


def test_a_reason_of_both_methods_stands_there_once_without_what_the_table_shows() -> None:
    assert reasons(ESTIMATES) == [
        f"regression and garcia: {TOO_SLOW}",
        "regression and garcia, DV: one speed",
        "garcia, m: known to +-55 % only",
    ]


def test_reasons_that_are_messages_stand_there_as_texts_do() -> None:
    slow = say("rate_too_low", "The sampling rate is too low (1e+02 Hz): see No. 4. Capture in the device.")
    known = say("known_to", "known to +-{share:.0f %} only: {why}", share=0.55, why=slow)
    missing = [say("not_given", "Not given: {symbols:, }.", symbols=symbols) for symbols in (("m", "F_v"), ("m",))]
    estimates = [
        _estimate("regression", joined(" ", [slow, missing[0]]), {"m": slow, "F_v": slow}),
        _estimate("garcia", joined(" ", [slow, missing[1]]), {"m": known}),
    ]
    told = reasons(estimates)
    assert told == [f"regression and garcia: {slow}", "garcia, m: known to +-55 % only"]
    assert all(isinstance(one, Message) for one in told)


def _analysis(discrepancy: dict[str, Any]) -> dict[str, Any]:
    step_test = recorded(steps([0.0, 40_000.0, 43_000.0, 60_000.0, 10_000.0], 2.0), 0.01, 5.0e-6)
    return {
        "recording": {
            "samples": 1201,
            "duration_s": 60.0,
            "sample_period_s": 0.05,
            "sampling": None,
            "gaps": 0,
            "position_noise_m": None,
            "channels": ["command_pa", "position_m"],
        },
        "estimates": ESTIMATES,
        "signature": {
            **measure_signature(triangle_test(0.002), NOMINAL.nameplate).to_json(),
            "steps": step_figures(step_test, NOMINAL.nameplate),
        },
        "discrepancy": discrepancy,
        "health": {"ne107": None, "reasons": ["not assessed"]},
    }


def test_a_terminal_of_80_columns_breaks_no_cell_of_the_table() -> None:
    console = Console(width=80, record=True, file=StringIO())
    print_analysis(console, _analysis({"verdict": "not_assessed"}))
    lines = console.export_text().splitlines()
    rows = [line for line in lines if line.startswith("│ ") and "[" in line]
    assert [row.split()[1] for row in rows] == list(PARAMETER_SYMBOLS)
    assert sum(line.count("not identifiable") for line in lines) == 5
    assert not any("…" in line for line in lines)


def test_a_test_that_no_cause_explains_says_what_to_do_next_and_a_note_stands_below() -> None:
    console = Console(width=200, record=True, file=StringIO())
    note = "The moving mass is 2 times the nameplate's 1.36 kg. Check both."
    unexplained = {"verdict": "unexplained", "pictures": {"explained": {"speed": 0.7}}}
    print_analysis(console, _analysis(unexplained) | {"notes": [note]}, "diagnostic")
    text = console.export_text()
    assert "Next: Repeat the sequence diagnostic: what comes again at the same place is the valve's own" in text
    assert "look at packing and guide" in text
    assert f"Note: {note}" in text
    assert "garcia, m: known to ±55 % only" in text
