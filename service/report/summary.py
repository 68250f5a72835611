"""Page one, for a supervisor: the verdict in a sentence, the state, friction with its trend, what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import tzinfo
from typing import Any, Final

from service.report.source import ReportSource
from service.shown.forecast import all_forecasts
from service.shown.next_step import next_step
from service.shown.results import diagnosis_of
from service.shown.words import NE107
from service.words.plain_numbers import plus_minus
from service.words.sentences import NO_FAULT, as_sentence
from service.words.units import UnitSystem, measured, quantity

_VERDICTS: Final = {
    "F": " has failed: go and look at it.",
    "S": " works outside its specification.",
    "M": " needs maintenance.",
    "C": " could not be judged by this test.",
    "N": ": no fault found.",
}
_NOT_ASSESSED: Final = " was measured; its health was not assessed."
_FRICTION: Final = ("friction_mean_n", "friction_coulomb_n")
_MONTH_DAYS: Final = 30.0
_SAME_PERCENT: Final = 0.1  # less is not worth a number to whoever plans the work


def summary_of(source: ReportSource) -> dict[str, Any]:
    """Return what a supervisor reads."""
    health = source.analysis.get("health") or {}
    state = health.get("ne107")
    shown = NE107.get(state or "")
    return {
        "verdict": _verdict(source, state),
        "state": "!" if source.alarm else state or "–",
        "state_words": "Not assessed" if shown is None else shown.words,
        "reasons": [as_sentence(reason) for reason in health.get("reasons") or ()],
        "diagnosis": _diagnosis(source.analysis, health.get("reasons") or (), state),
        "actions": _actions(source),
        "key_figures": key_figures(source.analysis, source.system, source.zone),
    }


def _verdict(source: ReportSource, state: str | None) -> str:
    """Return the verdict; whatever was measured, a valve that was not left where it should be is not in order."""
    if source.alarm:
        return f"{source.tag}: {source.alarm}."
    return f"{source.tag}{_VERDICTS.get(state or '', _NOT_ASSESSED)}"


def _diagnosis(analysis: Mapping[str, Any], reasons: Sequence[str], state: str | None) -> str:
    """Return the diagnosis with the causes' sentences that the reasons do not have; "" where they say it all."""
    found = diagnosis_of(analysis)
    sentences = [str(cause["sentence"]) for cause in found.causes]
    left = [one for one in sentences if not any(one in reason for reason in reasons)]
    is_told = sentences and not left and found.verdict in {"named", "likely"}
    is_told = is_told or (found.headline == NO_FAULT and state == "N")
    if is_told or any(found.headline in reason for reason in reasons):
        return " ".join(left)
    return " ".join([found.headline, *left])


def _actions(source: ReportSource) -> list[str]:
    causes = diagnosis_of(source.analysis).causes
    actions = [
        *(str(cause["action"]) for cause in causes),
        next_step(source.analysis, source.sequence),
        *(str(note) for note in source.analysis.get("notes") or ()),  # each ends with what to check
    ]
    return [action for action in dict.fromkeys(actions) if action]


def key_figures(analysis: Mapping[str, Any], system: UnitSystem, zone: tzinfo | None = None) -> list[dict[str, str]]:
    """Return what a crew wants first, as texts: friction, how it stands against the baseline, its trend, dead band.

    Dates are by the clock of ``zone``, None for this machine's.
    """
    signature = analysis.get("signature") or {}
    rows = []
    friction = _friction(analysis)
    if friction is not None:
        value, ci95 = friction
        rows.append(
            {"name": "Friction", "value": measured(value, ci95, "N", system), "beside": _of_span(analysis, value)}
        )
    rows += [{"name": "Friction against the baseline", "value": text, "beside": ""} for text in _against(analysis)]
    rows += [{"name": "Trend of friction", "value": text, "beside": ""} for text in _trend(analysis, system, zone)]
    dead_band = (signature.get("intervals") or {}).get("dead_band_percent") or {}
    if signature.get("dead_band_percent") is not None:
        rows.append(
            {
                "name": "Dead band",
                "value": measured(signature["dead_band_percent"], dead_band.get("ci95"), "percent", system),
                "beside": "how far the signal turns back before the stem answers",
            }
        )
    return rows


def _friction(analysis: Mapping[str, Any]) -> tuple[float, Any] | None:
    """Mean friction of the loop; where it has none the Coulomb friction that health found."""
    signature = analysis.get("signature") or {}
    if signature.get("friction_mean_n") is not None:
        interval = (signature.get("intervals") or {}).get("friction_mean_n") or {}
        return signature["friction_mean_n"], interval.get("ci95")
    for change in (analysis.get("health") or {}).get("changes") or ():
        if change["name"] in _FRICTION and change["now"] is not None:
            return change["now"], None
    model = (analysis.get("discrepancy") or {}).get("extended_model")
    found = None if model is None else model["parameters"].get("F_c")
    return None if found is None or found.get("value") is None else (found["value"], found.get("ci95"))


def _of_span(analysis: Mapping[str, Any], friction_n: float) -> str:
    span = (analysis.get("signature") or {}).get("span") or {}
    force_n = span.get("force_n")
    return "" if not force_n else f"{plus_minus(100.0 * friction_n / force_n, None)} % of span"


def _against(analysis: Mapping[str, Any]) -> list[str]:
    for change in (analysis.get("health") or {}).get("changes") or ():
        if change["name"] in _FRICTION and change["change"] is not None and change["was"]:
            percent = 100.0 * abs(change["change"] / change["was"])
            way = "up" if change["change"] > 0.0 else "down"
            moved = "the same" if percent < _SAME_PERCENT else f"{way} {percent:.2g} %"
            limit = "" if change["limit"] is None else f", {100.0 * change['limit'] / change['was']:.3g} % is allowed"
            return [f"{moved}{limit}"]
    return []


def _trend(analysis: Mapping[str, Any], system: UnitSystem, zone: tzinfo | None) -> list[str]:
    for trend in (analysis.get("health") or {}).get("trends") or ():
        if trend["name"] in _FRICTION:
            low, high = trend["ci95"]
            if low <= 0.0 <= high:
                return [f"steady over {trend['tests']} tests"]
            moved = quantity(abs(trend["per_day"]) * _MONTH_DAYS, "N", system, 2)
            way = "rising" if trend["per_day"] > 0.0 else "falling"
            met = [one.dates(zone) for one in all_forecasts(analysis["health"]) if one.name == trend["name"]]
            return [", at its limit ".join([f"{way} by {moved} a month", *met])]
    return []
