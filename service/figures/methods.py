"""The parameters of the methods beside each other: each with its 95 % interval, relative to the best known one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from service.figures.canvas import BLUE, INK, RED, SOFT, Picture, settings, sheet, svg_text, tidy
from service.words.names import named
from service.words.reader import Reader
from valve.messages import Message, say
from valve.parameters import PARAMETER_SYMBOLS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: What people call the methods, in the order of the analysis object.
METHOD_WORDS: Final = {
    "regression": say("method_regression", "method 1, regression"),
    "garcia": say("method_garcia", "method 2, Garcia"),
    "maximum_likelihood": say("method_maximum_likelihood", "maximum likelihood"),
    "extended": say("method_extended", "with the cause in the model"),
}
_TITLE: Final = say("title_methods", "The methods beside each other")
_AXIS: Final = say("axis_difference", "difference from the value with the narrowest interval, %")
_STYLE: Final = {
    "regression": ("o", SOFT),
    "garcia": ("s", BLUE),
    "maximum_likelihood": ("D", RED),
    "extended": ("^", INK),
}
_MOST_SHOWN: Final = 0.5  # of the reference: beyond that a bar leaves the picture


def method_words(method: str) -> Message:
    """Return what people call a method."""
    return METHOD_WORDS.get(method) or named(method)


def all_estimates(analysis: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the methods' estimates, and after them the model with the cause that was found, where there is one."""
    estimates = list(analysis.get("estimates") or ())
    model = (analysis.get("discrepancy") or {}).get("extended_model")
    if model is not None:
        estimates.append({"method": "extended", "status": "ok", "message": "", "parameters": model["parameters"]})
    return estimates


def can_compare(estimates: Sequence[Mapping[str, Any]]) -> bool:
    """Whether two methods give a parameter that is not zero."""
    return any(len(found) > 1 for _, found in _rows(estimates))


def methods_picture(estimates: Sequence[Mapping[str, Any]], reader: Reader) -> Picture | None:
    """Return one row a parameter, the methods' values in percent of the narrowest; None with nothing to compare.

    A parameter that may be zero has no percents and no row.
    """
    rows = _rows(estimates)
    if not can_compare(estimates):
        return None
    with settings():
        figure = sheet(7.2, 0.9 + 0.55 * len(rows))
        axes = figure.subplots()
        for place, (_, found) in enumerate(rows):
            _row(axes, len(rows) - 1 - place, found, reader)
        axes.axvline(0.0, color=SOFT, linewidth=0.8)
        tidy(axes, x=reader.told(_AXIS))
        axes.set_yticks([len(rows) - 1 - place for place in range(len(rows))], [symbol for symbol, _ in rows])
        axes.set_ylim(-0.6, len(rows) - 0.4)
        handles, labels = axes.get_legend_handles_labels()
        once = dict(zip(labels, handles, strict=True))
        figure.legend(once.values(), once.keys(), loc="outside upper left", frameon=False, ncols=2, labelcolor=INK)
    said = "; ".join(
        f"{symbol} {reader.told(method_words(method))} "
        f"{reader.measured(entry['value'], entry.get('ci95'), entry['unit'])}"
        for symbol, found in rows
        for method, entry in found.items()
    )
    return Picture(figure, reader.told(_TITLE), f"{said}.")


def methods_svg(estimates: Sequence[Mapping[str, Any]], reader: Reader) -> str | None:
    """Return the methods' picture as SVG text."""
    picture = methods_picture(estimates, reader)
    return None if picture is None else svg_text(picture)


def _rows(estimates: Sequence[Mapping[str, Any]]) -> list[tuple[str, dict[str, Mapping[str, Any]]]]:
    rows = [(symbol, found) for symbol in PARAMETER_SYMBOLS if (found := _found(estimates, symbol))]
    return [(symbol, found) for symbol, found in rows if not _may_be_zero(_narrowest(found))]


def _found(estimates: Sequence[Mapping[str, Any]], symbol: str) -> dict[str, Mapping[str, Any]]:
    found = {}
    for estimate in estimates:
        entry = (estimate.get("parameters") or {}).get(symbol)
        if entry is not None and entry.get("value"):
            found[str(estimate["method"])] = entry
    return found


def _row(axes: Axes, place: int, found: Mapping[str, Mapping[str, Any]], reader: Reader) -> None:
    reference = _narrowest(found)["value"]
    for number, (method, entry) in enumerate(found.items()):
        marker, colour = _STYLE.get(method, ("x", INK))
        height = place + 0.2 - 0.2 * number
        percent = [100.0 * (one - reference) / abs(reference) for one in (entry.get("ci95") or ())]
        at = 100.0 * (entry["value"] - reference) / abs(reference)
        if percent:
            most = 100.0 * _MOST_SHOWN
            axes.plot([max(percent[0], -most), min(percent[1], most)], [height, height], color=colour, linewidth=2.2)
        words = reader.told(method_words(method))
        axes.plot([at], [height], marker, color=colour, markersize=5.5, label=words)


def _narrowest(found: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Any]:
    return min(found.values(), key=_width)


def _may_be_zero(entry: Mapping[str, Any]) -> bool:
    ci95 = entry.get("ci95")
    return ci95 is not None and bool(ci95[0] <= 0.0 <= ci95[1])


def _width(entry: Mapping[str, Any]) -> float:
    ci95 = entry.get("ci95")
    return float("inf") if ci95 is None else float(ci95[1] - ci95[0])
