"""What the demonstration prints of a test: truth beside both methods' estimates."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.cli.analysis_tables import reasons
from service.cli.demo_plant import DemoValve
from valve.parameters import PARAMETER_SYMBOLS


def _cells(parameter: dict[str, Any] | None, truth: float) -> tuple[str, str]:
    """Value, and its error in percent of the truth, as text; a truth of zero has no percents."""
    value = None if parameter is None else parameter.get("value")
    if value is None:
        return "not known", ""
    error_percent = 100.0 * (value - truth) / truth if truth != 0.0 else None
    return f"{value:.5g}", "" if error_percent is None else f"{error_percent:+.3f}"


def _table(valve: DemoValve, made: dict[str, Any]) -> Table:
    estimates = {estimate["method"]: estimate for estimate in made["test"]["analysis"]["estimates"]}
    recording = made["test"]["analysis"]["recording"]
    table = Table(
        title=f"{valve.tag}: {valve.parameter_set} valve, Modbus {valve.transport.upper()}, {valve.mode}, "
        f"{recording['samples']} samples, {1e3 * recording['sample_period_s']:.3g} ms apart, "
        f"position noise {1e6 * recording['position_noise_m']:.2g} um",
        title_justify="left",
    )
    table.add_column("parameter", no_wrap=True)
    table.add_column("truth", justify="right", no_wrap=True)
    for method, estimate in estimates.items():
        table.add_column(f"{method.replace('_', ' ')} ({estimate['status']})", justify="right")
        table.add_column("error %", justify="right", no_wrap=True)
    for symbol, entry in PARAMETER_SYMBOLS.items():
        truth = made["truth"][symbol]
        cells = [cell for estimate in estimates.values() for cell in _cells(estimate["parameters"].get(symbol), truth)]
        table.add_row(Text(f"{symbol} [{entry.unit}]"), f"{truth:.6g}", *cells)
    return table


def print_test(console: Console, valve: DemoValve, made: dict[str, Any]) -> None:
    """Print the table of one completed test, the reasons for what is missing, and the diagnosis."""
    console.print()
    test = made["test"]
    if test["state"] != "completed":
        console.print(f"{valve.tag}: {test['state']}: {test.get('error') or 'no reason given'}", style="bold")
        return
    console.print(_table(valve, made))
    for reason in reasons(test["analysis"]["estimates"]):
        console.print(Text(f"  {reason}"))
    discrepancy = test["analysis"]["discrepancy"]
    verdict = discrepancy["verdict"].replace("_", " ")
    console.print(Text(f"  diagnosis: {verdict}. {discrepancy.get('message', '')}"))
