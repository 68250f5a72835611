"""What the demonstration prints of a test: truth beside both methods' estimates."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table

from service.cli.demo_plant import DemoValve
from valve.parameters import PARAMETER_SYMBOLS


def _cells(parameter: dict[str, Any] | None, truth: float) -> tuple[str, str]:
    """Value with its interval, and its error in percent of the truth, as text."""
    value = None if parameter is None else parameter.get("value")
    if value is None:
        return "not known", ""
    error = f"{100.0 * (value - truth) / truth:+.3g} %" if truth != 0.0 else ""
    return f"{value:.6g}", error


def _table(valve: DemoValve, made: dict[str, Any]) -> Table:
    estimates = {estimate["method"]: estimate for estimate in made["test"]["analysis"]["estimates"]}
    recording = made["test"]["analysis"]["recording"]
    table = Table(
        title=f"{valve.tag}: {valve.parameter_set} valve, Modbus {valve.transport.upper()}, {valve.mode}, "
        f"{recording['samples']} samples, {1e3 * recording['sample_period_s']:.3g} ms apart",
        title_justify="left",
    )
    table.add_column("parameter")
    table.add_column("truth", justify="right")
    for method, estimate in estimates.items():
        table.add_column(f"{method} ({estimate['status']})", justify="right")
        table.add_column("error", justify="right")
    for symbol, entry in PARAMETER_SYMBOLS.items():
        truth = made["truth"][symbol]
        cells = [cell for estimate in estimates.values() for cell in _cells(estimate["parameters"].get(symbol), truth)]
        table.add_row(f"{symbol} [{entry.unit}]".replace("[", r"\["), f"{truth:.6g}", *cells)
    return table


def print_test(console: Console, valve: DemoValve, made: dict[str, Any]) -> None:
    """Print the table of one completed test, the reasons for what is missing, and the diagnosis."""
    console.print()
    test = made["test"]
    if test["state"] != "completed":
        console.print(f"{valve.tag}: {test['state']}: {test.get('error') or 'no reason given'}", style="bold")
        return
    console.print(_table(valve, made))
    for estimate in test["analysis"]["estimates"]:
        _print_reasons(console, estimate)
    discrepancy = test["analysis"]["discrepancy"]
    console.print(f"  diagnosis: {discrepancy['verdict']}. {discrepancy.get('message', '')}")


def _print_reasons(console: Console, estimate: dict[str, Any]) -> None:
    """Print why an estimate is not better than it is, each reason once."""
    if estimate["message"]:
        console.print(f"  {estimate['method']}: {estimate['message']}")
    reasons: dict[str, list[str]] = {}
    for symbol, parameter in estimate["parameters"].items():
        if parameter["value"] is None and parameter["note"] not in estimate["message"]:
            reasons.setdefault(parameter["note"], []).append(symbol)
    for reason, symbols in reasons.items():
        console.print(f"  {estimate['method']}, {', '.join(symbols)} not known: {reason}")
