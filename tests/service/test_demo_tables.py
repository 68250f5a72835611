"""The demonstration's tables: readable in 80 columns, no digit that is not known, each reason once."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from service.cli.demo_plant import DEMO_VALVES
from service.cli.demo_tables import print_legend, print_test
from service.words.sentences import together
from valve.messages import say, with_table
from valve.parameter_sets import PARAMETER_SETS
from valve.parameters import PARAMETER_SYMBOLS

TRUTH = PARAMETER_SETS["nominal"].parameters.by_symbol()
LONG = (
    "The motion of a valve with these values misses what was recorded by more than the noise: look for what else moves "
    "or holds the stem, or let maximum likelihood search further."
)


def estimate(method: str, status: str, message: str, **notes: str) -> dict[str, Any]:
    parameters = {
        symbol: {
            "value": None if symbol in notes else TRUTH[symbol] * 1.00123 + 0.0123,
            "ci95": None if symbol in notes else [0.999 * TRUTH[symbol], 1.003 * TRUTH[symbol] + 1.0e-6],
            "note": notes.get(symbol, ""),
        }
        for symbol in PARAMETER_SYMBOLS
    }
    return {"method": method, "status": status, "message": message, "parameters": parameters}


def printed(*estimates: dict[str, Any], **more: Any) -> list[str]:
    recording = {"samples": 40001, "sample_period_s": 1.0e-3, "position_noise_m": 4.9e-7}
    analysis = {
        "estimates": list(estimates),
        "recording": recording,
        "discrepancy": {"verdict": "not_assessed", "message": "Nothing was looked for."},
        **more,
    }
    out = io.StringIO()
    made = {"truth": TRUTH, "test": {"state": "completed", "analysis": analysis}}
    print_test(Console(file=out, width=80), DEMO_VALVES[1], made)
    return out.getvalue().splitlines()


def test_three_methods_stand_beside_the_truth_uncut_in_80_columns() -> None:
    lines = printed(
        estimate("regression", "poor", LONG, m=LONG, F_v=LONG),
        estimate("garcia", "poor", LONG, m=LONG, F_v=LONG),
        estimate("maximum_likelihood", "ok", "", DV="known to +-290 % only, the limit is 30 %: it is tied to F_s"),
    )
    assert max(map(len, lines)) <= 80
    table = "\n".join(lines[: next(i for i, line in enumerate(lines) if line.startswith(" fit"))])
    assert "…" not in table
    for words in ("method 1", "regression", "method 2", "garcia", "maximum", "likelihood"):
        assert words in table
    (rate,) = (line for line in lines if line.startswith(" k [N/m]"))
    # half of the interval is 105 N/m: no digit below ten
    assert rate.split()[2:] == ["52538", *["52600", "+0.123"] * 3]


def test_each_reason_stands_once_and_on_one_line() -> None:
    lines = printed(
        estimate("regression", "poor", LONG, m=LONG, F_v=LONG, DV="on ramps of one speed it is tied to F_s"),
        estimate("garcia", "poor", LONG, m=LONG, F_v=LONG, DV="the method does not give it"),
        estimate("maximum_likelihood", "ok", "", DV="known to +-290 % only, the limit is 30 %: it is tied to F_s"),
    )
    notes = [line for line in lines if line.startswith("  ") and ": " in line]
    assert notes == [
        "  DV: known to ±290 % only, the limit is 30 %: it is tied to F_s",
        "  method 1 regression, method 2 garcia: The motion of a valve with these values…",
        "  Diagnosis: not assessed. Nothing was looked for.",
    ]


def test_of_a_reason_its_first_message_stands_whatever_its_words_are() -> None:
    reason = together([say("one", "It stuck at A. Bore 2."), say("another", "Repeat the test.")])
    one = with_table({"estimates": [estimate("maximum_likelihood", "poor", reason)]})
    lines = printed(*one["estimates"], messages=json.loads(json.dumps(one["messages"])))
    assert "  maximum likelihood: It stuck at A. Bore 2." in lines


def test_what_all_methods_say_keeps_its_reason() -> None:
    lines = printed(*(estimate(name, "poor", LONG) for name in ("regression", "garcia", "maximum_likelihood")))
    assert "  all 3 methods: The motion of a valve with these values" in "\n".join(lines)


@pytest.mark.parametrize(("factor", "said"), [(1.0, "+0.000"), (1.4079, "+40.79"), (26.11, "+2511"), (0.99, "-1.000")])
def test_the_error_keeps_to_its_column(factor: float, said: str) -> None:
    one = estimate("maximum_likelihood", "ok", "")
    one["parameters"]["DV"]["value"] = factor * TRUTH["DV"]
    (line,) = (line for line in printed(one) if line.startswith(" DV"))
    assert line.split()[-1] == said


def test_the_words_of_the_tables_are_explained_under_them() -> None:
    out = io.StringIO()
    print_legend(Console(file=out, width=80))
    said = " ".join(out.getvalue().split())
    assert all(f"{symbol} {entry.meaning}" in said for symbol, entry in PARAMETER_SYMBOLS.items())
    assert (Path(__file__).parents[2] / "docs" / "glossary.md").exists()
    assert "docs/glossary.md" in said
