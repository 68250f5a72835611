"""A diagnosis as words and a small table for a terminal: what is wrong, what to do, what it gains, what else it is."""

from __future__ import annotations

from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from service.words.plain_numbers import as_read, with_span
from service.words.sentences import NO_FAULT

_NO_GAIN: Final = 0.005  # of the misfit without the cause
_VERDICTS: Final = {
    "none": "no fault found",
    "named": "named",
    "likely": "probably, not proven",
    "ambiguous": "several causes would explain it",
    "unexplained": "something is there that no cause of the catalogue explains",
    "not_assessed": "not assessed",
}


def print_diagnosis(console: Console, discrepancy: dict[str, Any], indent: str = "") -> None:
    """Print the verdict, each cause with what to do, what it gains, what else it could be and how to tell."""
    for line in diagnosis_lines(discrepancy):
        console.print(Text(f"{indent}{as_read(line)}"))
    if discrepancy.get("causes"):
        console.print(_parameters(discrepancy["causes"]))
    model = discrepancy.get("extended_model")
    if model is not None:
        console.print(_valve(model["parameters"]))


def diagnosis_lines(discrepancy: dict[str, Any]) -> list[str]:
    """Return the diagnosis as sentences, the verdict first."""
    verdict = discrepancy["verdict"]
    message = str(discrepancy.get("message") or "").removeprefix(NO_FAULT).strip()
    lines = [f"Diagnosis: {_VERDICTS.get(verdict, verdict)}. {message}".rstrip()]
    misfit = discrepancy.get("misfit")
    if misfit is not None and misfit["where"] and verdict not in ("none", "not_assessed"):
        lines.append(f"Misfit: {misfit['where']}")
    lines += [
        f"{_plain(found['cause'])}: {found['sentence']} What to do: {found['action']}"
        for found in discrepancy.get("causes", [])
    ]
    lines += [f"Remark: {found['sentence']}" for found in discrepancy.get("remarks") or ()]
    rivals = discrepancy.get("not_told_apart_from")
    if rivals:
        first = _plain(discrepancy["causes"][0]["cause"])
        lines.append(f"Instead of {first} it could as well be: {', '.join(_plain(name) for name in rivals)}.")
    # without a cause there is nothing to gain by
    gains = (discrepancy.get("gains") or [discrepancy.get("gain")]) if discrepancy.get("causes") else []
    lines += [_gain(gain) for gain in gains if gain is not None and not _is_nothing(gain)]
    separating = discrepancy.get("separating_test")
    if separating is not None:
        lines.append(f"To tell them apart: {separating['sentence']}")
    return lines


def _is_nothing(gain: dict[str, Any]) -> bool:
    """Whether a cause changes no prediction: of what is measured anyway, such as a supply that ends."""
    before_m, after_m = gain["rmse_before_m"], gain["rmse_after_m"]
    return before_m is not None and abs(before_m - after_m) <= _NO_GAIN * before_m


def _gain(gain: dict[str, Any]) -> str:
    if gain["rmse_before_m"] is None:
        return (
            f"Gain on {gain['held_out']}: the force is missed by {gain['rmse_after_n']:.3g} N rms "
            f"({gain['error_after_percent']:.2g} %) with it in the model, by {gain['rmse_before_n']:.3g} N "
            f"({gain['error_before_percent']:.2g} %) without."
        )
    before_m, after_m, floor_m = gain["rmse_before_m"], gain["rmse_after_m"], gain["noise_floor_m"]
    possible = before_m**2 - floor_m**2
    share = ""
    if possible > 0.0:
        share = f", {min(100.0 * (before_m**2 - after_m**2) / possible, 100.0):.0f} % of what could be gained"
    return (
        f"Gain on {gain['held_out']}: the simulation misses by {_length(after_m)} rms with it in the model, "
        f"by {_length(before_m)} without{share}; the noise is {_length(floor_m)}."
    )


def _parameters(causes: list[dict[str, Any]]) -> Table:
    table = Table(title="What was found", title_justify="left")
    for heading in ("cause", "parameter"):
        table.add_column(heading)
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    for found in causes:
        for name, entry in found["parameters"].items():
            if entry["ci95"][0] == entry["ci95"][1]:
                # held, as where a gradient is counted from: nothing that the recording told
                continue
            value, span = with_span(entry["value"], *entry["ci95"])
            unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
            table.add_row(_plain(found["cause"]), name, f"{value}{unit}", span)
    return table


def _valve(parameters: dict[str, Any]) -> Table:
    """Return the valve's own parameters as they are with the cause in the model."""
    table = Table(title="The valve with the cause in its model", title_justify="left")
    table.add_column("parameter")
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    for symbol, entry in parameters.items():
        table.add_row(Text(f"{symbol} [{entry['unit']}]"), *with_span(entry["value"], *entry["ci95"]))
    return table


def _plain(cause: str) -> str:
    return cause.replace("_", " ")


def _length(length_m: float) -> str:
    return f"{1e6 * length_m:.3g} um" if length_m < 1.0e-3 else f"{1e3 * length_m:.3g} mm"
