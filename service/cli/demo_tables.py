"""What the demonstration prints of a test: truth beside each method's estimates, in 80 columns."""

from __future__ import annotations

import math
import textwrap
from typing import Any, Final

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from service.cli.demo_plant import DemoValve
from service.cli.diagnosis_tables import diagnosis_lines
from service.words.plain_numbers import as_read, half_width, scatter_words
from service.words.sentences import sentences_of
from valve.messages import restored, say
from valve.parameters import PARAMETER_SYMBOLS

_METHODS: Final = {
    "regression": ("method 1", "regression"),
    "garcia": ("method 2", "garcia"),
    "maximum_likelihood": ("maximum", "likelihood"),
}
_FAULTS: Final = {"local_friction": "a tight spot", "supply_saturation": "a starved supply"}
_UNKNOWN: Final = "unknown"
_DIGITS: Final = 5  # of a value without an interval
_WIDEST: Final = 10  # characters of a value
_ERROR_PLACES: Final = ((10.0, 3), (100.0, 2))  # after the point, below so many percent: 6 characters
_INDENT: Final = 2  # columns


def _rounded(parameter: dict[str, Any]) -> str:
    """Value with two digits of half of its 95 % interval, so that no digit is shown that is not known."""
    value, half = float(parameter["value"]), half_width(parameter)
    if not half:
        return f"{value:.{_DIGITS}g}"
    places = 1 - math.floor(math.log10(half))
    plain = f"{round(value, places) + 0.0:.{max(places, 0)}f}"
    return plain if len(plain) <= _WIDEST else f"{value:.{_DIGITS}g}"


def _cells(parameter: dict[str, Any] | None, truth: float, scale: float) -> tuple[str, str]:
    """Value, and its error in percent of the ``scale``, as text."""
    if parameter is None or parameter.get("value") is None:
        return _UNKNOWN, ""
    error_percent = 100.0 * (float(parameter["value"]) - truth) / scale
    places = next((places for limit, places in _ERROR_PLACES if abs(error_percent) < limit), 0)
    return _rounded(parameter), f"{error_percent:+.{places}f}"


def _table(valve: DemoValve, made: dict[str, Any]) -> Table:
    estimates = made["test"]["analysis"]["estimates"]
    recording = made["test"]["analysis"]["recording"]
    table = Table(
        title=say(
            "demo_title",
            "{tag}: {parameter_set} valve, {hidden}, Modbus {transport}, {mode}:\n{samples} samples, {period:.3g ms} "
            "apart, position noise {noise:.2g um}",
            tag=valve.tag,
            parameter_set=valve.parameter_set,
            hidden=_hidden(valve),
            transport=valve.transport.upper(),
            mode=valve.mode,
            samples=recording["samples"],
            period=recording["sample_period_s"],
            noise=recording["position_noise_m"],
        ),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 0),
    )
    table.add_column("parameter", no_wrap=True)
    table.add_column("truth", justify="right", no_wrap=True)
    for estimate in estimates:
        name = _METHODS.get(estimate["method"], (estimate["method"].replace("_", " "),))
        table.add_column("\n".join(name), justify="right", no_wrap=True)
        table.add_column("error\n%", justify="right", no_wrap=True)
    for symbol, entry in PARAMETER_SYMBOLS.items():
        truth = made["truth"][symbol]
        scale = made["truth"]["F_s" if symbol == "F_0" else symbol]  # a preload may be 0
        cells = [cell for estimate in estimates for cell in _cells(estimate["parameters"].get(symbol), truth, scale)]
        table.add_row(Text(f"{symbol} [{entry.unit}]"), f"{truth:.6g}", *cells)
    table.add_row("fit", "", *(cell for estimate in estimates for cell in (estimate["status"], "")))
    return table


def _hidden(valve: DemoValve) -> str:
    """What is wrong with a valve of the demonstration."""
    return "healthy" if valve.cause is None else f"fault: {_FAULTS[valve.cause]}"


def _scatter_lines(made: dict[str, Any]) -> list[str]:
    """How friction varies, by maximum likelihood."""
    best = made["test"]["analysis"]["estimates"][-1]
    words = [
        f"{symbol} varies {said}"
        for symbol in ("F_s", "F_c")
        if (said := scatter_words(symbol, *(best["parameters"][symbol].get(key) for key in ("value", "scatter"))))
    ]
    return [say("by_likelihood", "{words:, } (maximum likelihood).", words=tuple(words))] if words else []


def _notes(estimates: list[dict[str, Any]], width: int) -> list[str]:
    """Why values are missing: each reason once, on one line after the parameters that no method can give for it.

    Of several methods' reasons for one parameter the last one's is taken: it is the one that can do most. A method
    whose fit is not good says why on a line of its own.
    """
    symbols: dict[str, list[str]] = {}
    for symbol in PARAMETER_SYMBOLS:
        given = [estimate["parameters"][symbol] for estimate in estimates if symbol in estimate["parameters"]]
        if given and all(parameter["value"] is None for parameter in given):
            symbols.setdefault(_first_sentence(given[-1]["note"]), []).append(symbol)
    methods: dict[str, list[str]] = {}
    for estimate in estimates:
        said = _first_sentence(estimate["message"])
        if estimate["status"] != "ok" and said and said not in symbols:
            methods.setdefault(said, []).append(" ".join(_METHODS.get(estimate["method"], (estimate["method"],))))
    told = [(", ".join(owners), reason) for reason, owners in symbols.items()]
    for reason, owners in methods.items():
        told.append((f"all {len(owners)} methods" if len(owners) == len(estimates) > 1 else ", ".join(owners), reason))
    return [textwrap.shorten(f"{subject}: {reason}", width, placeholder="…") for subject, reason in told]


def _first_sentence(text: str) -> str:
    return next(iter(sentences_of(text)), "")


def print_legend(console: Console) -> None:
    """Print what the tables' words stand for."""
    console.print()
    symbols = "; ".join(f"{symbol} {entry.meaning}" for symbol, entry in PARAMETER_SYMBOLS.items())
    console.print(
        Text(
            say(
                "demo_legend",
                "{symbols}. Truth is what the simulated valve was in this test, F_c over the travel that it swept; "
                "the error of F_0 is in percent of F_s. docs/glossary.md has the words.",
                symbols=symbols,
            )
        )
    )


def print_test(console: Console, valve: DemoValve, made: dict[str, Any]) -> None:
    """Print the table of one completed test, the reasons for what is missing, and the diagnosis."""
    console.print()
    test = made["test"]
    if test["state"] != "completed":
        console.print(f"{valve.tag}: {test['state']}: {test.get('error') or 'no reason given'}", style="bold")
        return
    made = {**made, "test": {**test, "analysis": restored(test["analysis"])}}
    analysis = made["test"]["analysis"]
    console.print(_table(valve, made))
    notes = _notes(analysis["estimates"], console.width - _INDENT)
    # a diagnosis that was not made says why, and that is the scatter
    scatter = [] if analysis["discrepancy"]["verdict"] == "not_assessed" else _scatter_lines(made)
    for line in [*scatter, *notes, *diagnosis_lines(analysis["discrepancy"])]:
        console.print(Padding(Text(as_read(line)), (0, 0, 0, _INDENT), expand=False))
