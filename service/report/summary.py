"""Page one, for a supervisor: the verdict in a sentence, the state, friction with its trend, what to do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any, Final

from service.report.source import ReportSource
from service.shown.forecast import all_forecasts
from service.shown.next_step import next_step
from service.shown.results import diagnosis_of
from service.shown.words import NE107, NOT_ASSESSED
from service.words.plain_numbers import plus_minus
from service.words.reader import Reader
from service.words.sentences import NO_FAULT, as_sentence, together
from valve.messages import Message, say

_VERDICTS: Final[dict[str, Callable[[str], Message]]] = {
    "F": lambda tag: say("verdict_failed", "{tag} has failed: go and look at it.", tag=tag),
    "S": lambda tag: say("verdict_out_of_specification", "{tag} works outside its specification.", tag=tag),
    "M": lambda tag: say("verdict_maintenance", "{tag} needs maintenance.", tag=tag),
    "C": lambda tag: say("verdict_not_judged", "{tag} could not be judged by this test.", tag=tag),
    "N": lambda tag: say("verdict_no_fault", "{tag}: no fault found.", tag=tag),
}
_FRICTION_NAME: Final = say("key_friction", "Friction")
_AGAINST: Final = say("key_friction_against", "Friction against the baseline")
_TREND: Final = say("key_friction_trend", "Trend of friction")
_DEAD_BAND: Final = say("key_dead_band", "Dead band")
_FRICTION: Final = ("friction_mean_n", "friction_coulomb_n")
_MONTH_DAYS: Final = 30.0
_SAME_SHARE: Final = 0.001  # less is not worth a number to whoever plans the work


def summary_of(source: ReportSource) -> dict[str, Any]:
    """Return what a supervisor reads."""
    health = source.analysis.get("health") or {}
    state = health.get("ne107")
    shown = NE107.get(state or "")
    return {
        "verdict": _verdict(source, state),
        "state": "!" if source.alarm else state or "–",
        "state_words": NOT_ASSESSED.words if shown is None else shown.words,
        "reasons": [as_sentence(reason) for reason in health.get("reasons") or ()],
        "diagnosis": _diagnosis(source.analysis, health.get("reasons") or (), state),
        "actions": _actions(source),
        "key_figures": key_figures(source.analysis, source.reader),
    }


def _verdict(source: ReportSource, state: str | None) -> str:
    """Return the verdict; whatever was measured, a valve that was not left where it should be is not in order."""
    if source.alarm:
        return say("verdict_alarm", "{tag}: {alarm}.", tag=source.tag, alarm=source.alarm)
    verdict = _VERDICTS.get(state or "")
    if verdict is not None:
        return verdict(source.tag)
    return say("verdict_not_assessed", "{tag} was measured; its health was not assessed.", tag=source.tag)


def _diagnosis(analysis: Mapping[str, Any], reasons: Sequence[str], state: str | None) -> str:
    """Return the diagnosis with the causes' sentences that the reasons do not have; "" where they say it all."""
    found = diagnosis_of(analysis)
    sentences: list[str] = [cause["sentence"] for cause in found.causes]
    left = [one for one in sentences if not any(one in reason for reason in reasons)]
    is_told = sentences and not left and found.verdict in {"named", "likely"}
    is_told = is_told or (found.headline == NO_FAULT and state == "N")
    if is_told or any(found.headline in reason for reason in reasons):
        return together(left)
    return together([found.headline, *left])


def _actions(source: ReportSource) -> list[str]:
    causes = diagnosis_of(source.analysis).causes
    actions = [
        *(cause["action"] for cause in causes),
        next_step(source.analysis, source.sequence),
        *(source.analysis.get("notes") or ()),  # each ends with what to check
    ]
    return [action for action in dict.fromkeys(actions) if action]


def key_figures(analysis: Mapping[str, Any], reader: Reader) -> list[dict[str, str]]:
    """Return what a crew wants first, as texts: friction, how it stands against the baseline, its trend, dead band."""
    signature = analysis.get("signature") or {}
    rows = []
    friction = _friction(analysis)
    if friction is not None:
        value, ci95 = friction
        rows.append(
            {"name": _FRICTION_NAME, "value": reader.measured(value, ci95, "N"), "beside": _of_span(analysis, value)}
        )
    rows += [{"name": _AGAINST, "value": text, "beside": ""} for text in _against(analysis)]
    rows += [{"name": _TREND, "value": text, "beside": ""} for text in _trend(analysis, reader)]
    dead_band = (signature.get("intervals") or {}).get("dead_band_percent") or {}
    if signature.get("dead_band_percent") is not None:
        rows.append(
            {
                "name": _DEAD_BAND,
                "value": reader.measured(signature["dead_band_percent"], dead_band.get("ci95"), "percent"),
                "beside": say("dead_band_means", "how far the signal turns back before the stem answers"),
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
    if not force_n:
        return ""
    return say("percent_of_whole_span", "{percent} % of span", percent=plus_minus(100.0 * friction_n / force_n, None))


def _against(analysis: Mapping[str, Any]) -> list[str]:
    for change in (analysis.get("health") or {}).get("changes") or ():
        if change["name"] in _FRICTION and change["change"] is not None and change["was"]:
            share = abs(change["change"] / change["was"])
            if share < _SAME_SHARE:
                moved = say("friction_same", "the same")
            elif change["change"] > 0.0:
                moved = say("friction_up", "up {share:.2g %}", share=share)
            else:
                moved = say("friction_down", "down {share:.2g %}", share=share)
            if change["limit"] is None:
                return [moved]
            allowed = change["limit"] / change["was"]
            return [say("is_allowed", "{moved}, {allowed:.3g %} is allowed", moved=moved, allowed=allowed)]
    return []


def _stepped(analysis: Mapping[str, Any], reader: Reader) -> list[str]:
    for step in (analysis.get("health") or {}).get("steps") or ():
        if step["name"] in _FRICTION:
            by = reader.quantity(abs(step["change"]), "N", 2)
            day = f"{datetime.fromisoformat(step['since']).astimezone(reader.zone):%Y-%m-%d}"
            return [
                say("higher_since", "{by} higher since {day}", by=by, day=day)
                if step["change"] > 0.0
                else say("lower_since", "{by} lower since {day}", by=by, day=day)
            ]
    return []


def _trend(analysis: Mapping[str, Any], reader: Reader) -> list[str]:
    for trend in (analysis.get("health") or {}).get("trends") or ():
        if trend["name"] in _FRICTION:
            low, high = trend["ci95"]
            if low <= 0.0 <= high:
                stepped = _stepped(analysis, reader)
                if stepped:
                    return stepped
                return [say("steady_over", "steady over {n} tests", n=trend["tests"])]
            by = reader.quantity(abs(trend["per_day"]) * _MONTH_DAYS, "N", 2)
            moved = (
                say("rising_by", "rising by {by} a month", by=by)
                if trend["per_day"] > 0.0
                else say("falling_by", "falling by {by} a month", by=by)
            )
            met = [one.dates(reader.zone) for one in all_forecasts(analysis["health"]) if one.name == trend["name"]]
            return [say("at_its_limit", "{moved}, at its limit {when}", moved=moved, when=met[0]) if met else moved]
    return []
