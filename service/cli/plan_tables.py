"""A plan as one table that compares the sequences, and in plain words what they do not tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from valve.messages import say
from valve.parameters import PARAMETER_SYMBOLS

_FIRST_COLUMN: Final = 24  # characters of a terminal's line: a parameter with value and unit
_COLUMN: Final = 14  # a sequence


def print_plan(console: Console, document: dict[str, Any]) -> None:
    """Print where the numbers come from, the table, what is not told and why, and which sequence tells most."""
    parameters, sampling = document["parameters"], document["sampling"]
    _say(
        console, say("what_test_would_tell", "{valve}: what a test would tell. Nothing moves.", valve=document["valve"])
    )
    _say(console, f"Parameters: {parameters['source']}.")
    pressure = "pressure measured" if sampling["pressure_measured"] else "pressure not measured, the command stands in"
    _say(
        console,
        say(
            "plan_sampling",
            "Sampling: {period:.4g ms} ({period_source}), position noise {noise:.3g um} rms ({noise_source}), "
            "{pressure}, I/P lag {lag:.2g} s.",
            period=sampling["sample_period_s"],
            period_source=sampling["sample_period_source"],
            noise=sampling["position_noise_m"],
            noise_source=sampling["position_noise_source"],
            pressure=pressure,
            lag=sampling["transducer_lag_s"],
        ),
    )
    scatter = document["friction_scatter"]
    _say(
        console,
        say(
            "friction_varies_as",
            "Friction varies as that of {source}: by {breakaway:.2g %} from breakaway to breakaway, "
            "{roughness:.2g %} along the travel, {wander:.2g %} in time.",
            source=scatter["source"],
            breakaway=scatter["breakaway"],
            roughness=scatter["roughness"],
            wander=scatter["wander"],
        ),
    )
    _say(console, "Expected 95 % interval of each parameter, by sequence:")
    possible = [one for one in document["sequences"] if one["possible"]]
    together = max(1, (console.width - _FIRST_COLUMN) // _COLUMN)
    for first in range(0, len(possible), together):
        console.print(_table(document, possible[first : first + together]))
    for one in document["sequences"]:
        _print_reasons(console, one)
    _print_choice(console, document)


def _say(console: Console, sentence: str) -> None:
    console.print(Text(sentence))


def _table(document: dict[str, Any], sequences: Sequence[dict[str, Any]]) -> Table:
    table = Table()
    table.add_column("", no_wrap=True)
    for one in sequences:
        table.add_column(one["sequence"], justify="right", no_wrap=True)
    values = document["parameters"]["values"]
    for symbol, entry in PARAMETER_SYMBOLS.items():
        cells = [_cell(one["parameters"], symbol) for one in sequences]
        table.add_row(Text(f"{symbol} {values[symbol]:.4g} {entry.unit}"), *cells)
    table.add_section()
    table.add_row("parameters told", *(_told(one) for one in sequences))
    table.add_row("test time", *(_or_dash(one["duration_s"], "{:.0f} s") for one in sequences))
    table.add_row("rate, of limit", *(_rate(one) for one in sequences))
    return table


def _cell(parameters: dict[str, Any] | None, symbol: str) -> str:
    if parameters is None:
        return "-"
    parameter = parameters[symbol]
    if not parameter["identifiable"]:
        tied = parameter["tied_to"]
        return "no" if not tied or tied[0] not in PARAMETER_SYMBOLS else f"no ({tied[0]})"
    if symbol == "F_0":  # it may be 0: in its unit
        return f"±{parameter['half_width_95']:.2g}N"
    percent = parameter["half_width_percent"]
    return "<0.001%" if percent < 0.001 else f"±{percent:.2g}%"


def _told(sequence: dict[str, Any]) -> str:
    if sequence["parameters"] is None:
        return "-"
    told = sum(one["identifiable"] for one in sequence["parameters"].values())
    return f"{told} of {len(sequence['parameters'])}"


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _rate(sequence: dict[str, Any]) -> str:
    if sequence["duration_s"] is None:
        return "-"
    rate = sequence["fastest_rate_pa_per_s"]
    return "steps" if rate is None else f"{100.0 * rate / sequence['rate_limit_pa_per_s']:.0f}%"


def _print_reasons(console: Console, sequence: dict[str, Any]) -> None:
    """Each reason once, with the parameters that it is of."""
    name = sequence["sequence"]
    if not sequence["possible"]:
        _say(console, say("not_possible", "{sequence} is not possible: {why}.", sequence=name, why=sequence["message"]))
        return
    reasons: dict[str, list[str]] = {}
    for symbol, parameter in sequence["parameters"].items():
        if not parameter["identifiable"]:
            reasons.setdefault(parameter["note"], []).append(symbol)
    for reason, symbols in reasons.items():
        _say(
            console,
            say(
                "does_not_tell",
                "{sequence} does not tell {symbols: and }: {why}.",
                sequence=name,
                symbols=tuple(symbols),
                why=reason,
            ),
        )


def _print_choice(console: Console, document: dict[str, Any]) -> None:
    default, reason, best = (document[key] for key in ("default_sequence", "default_sequence_reason", "best_sequence"))
    if len(document["sequences"]) > 1 and best is not None:
        _say(console, say("most_is_told", "Most is told, for its time, by {best}.", best=best))
    if default is None:
        _say(console, say("default_refused", "A test without --sequence is refused: {why}.", why=reason))
    elif reason:
        _say(
            console,
            say(
                "default_because",
                "A test without --sequence runs {sequence} ({why}).",
                sequence=default,
                why=reason,
            ),
        )
    else:
        _say(console, say("default_runs", "A test without --sequence runs {sequence}.", sequence=default))
