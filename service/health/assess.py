"""The judgement: what a result says of the valve's health, as NAMUR NE 107 has it, with reasons in plain words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from service.health.acceptance import checks_of, is_known, remark, unmet
from service.health.changes import Change, changes_between
from service.health.forecast import forecasts, scatter_of, steps_of, told_steps, trends_of
from service.health.results import Case, Check, Finding, Health, Ne107
from service.model.family_rule import event_words
from service.model.health_figures import Figures, figures_of, widened
from service.model.past_test import Baseline
from service.words.sentences import as_heading
from valve.messages import joined, say

_NOT_ASSESSED: Final = "not_assessed"
_NO_BASELINE: Final = say(
    "no_baseline_by_itself",
    "This test does not become the baseline by itself, because of what was found. If the valve is meant to be so, "
    "accept the test as the baseline on its page.",
)
_HARDLY_MOVED: Final = 0.02  # of rated travel: what a sensor's drift and noise may look like
# Properties of what the valve is measured with: a lag that was always there is no reason to send anybody.
_OF_THE_INSTRUMENTS: Final = frozenset({"transducer_lag", "transducer_dead_time", "position_lag"})
_ADVICE: Final = {
    "friction up": say("look_at_packing", "look at the packing and its lubrication"),
    "friction down": say("packing_lost_load", "the packing may have lost its load: look for a leak at the stem"),
    "friction highest": say("look_for_tight_place", "look for a tight place: a bent stem, a scored plug, the guide"),
    "spring_rate_n_per_m": say("look_for_broken_spring", "look for a broken or a wrong spring"),
    "bench_low_pa": say("may_not_shut_tight", "check the spring's adjustment: the valve may not shut tight"),
    "bench_high_pa": say("may_not_open_fully", "check the spring's adjustment: the valve may not open fully"),
    "travel_m": say("look_for_block", "look for what blocks the stroke, at the supply and at the stops"),
    "response_t63_s": say("look_at_supply_of_transducer", "look at the I/P's supply, its filter and the tubing"),
    "transducer_lag_s": say("look_at_supply_of_transducer", "look at the I/P's supply, its filter and the tubing"),
}
_STATES: Final = {
    "spring_rate_n_per_m": Ne107.OUT_OF_SPECIFICATION,
    "bench_low_pa": Ne107.OUT_OF_SPECIFICATION,
    "bench_high_pa": Ne107.OUT_OF_SPECIFICATION,
    "travel_m": Ne107.OUT_OF_SPECIFICATION,
}


def assess(case: Case) -> Health:
    """Judge one result: by itself against what a valve must do, and against its baseline and history.

    A change counts where it is beyond both its 95 % interval and its limit.
    """
    now = figures_of(case.analysis)
    was = None if case.baseline is None else case.baseline.test.figures
    scatter = scatter_of(case, now)  # of figures between tests, which no single test's interval holds
    held = None if was is None else widened(was, scatter)
    changes = changes_between(held, widened(now, scatter), case.limits, case.valve)
    trends = trends_of(case, held, widened(now, scatter))
    steps = steps_of(case, held, now)
    checks = checks_of(case, now)
    findings = list(_by_itself(case, now, checks))
    if _stuck(case, now) is None:
        findings += _of_changes(case, changes)
        findings += forecasts(case, trends, changes)
        findings += _not_comparable(now, was)
    alone = replace(case, baseline=None)
    is_accepted = not any(_by_itself(alone, now, checks_of(alone, now)))
    remarks = _remarks(case)
    of_steps = told_steps(steps, trends, changes)
    notes = (*of_steps, *_notes(case, findings, changes, checks, is_accepted=is_accepted), *remarks.values())
    found = (tuple(findings), tuple(changes), tuple(trends), case.baseline)
    return Health(*found, notes, checks, tuple(remarks), is_accepted=is_accepted, steps=tuple(steps))


def _by_itself(case: Case, now: Figures, checks: tuple[Check, ...]) -> Iterator[Finding]:
    """Yield what stands against the valve by this result alone, but for what a person knows of it."""
    stuck = _stuck(case, now)
    if stuck is not None:
        yield stuck
        return
    if case.out_of_family is not None:
        yield Finding(
            Ne107.MAINTENANCE,
            say(
                "test_cut_out_of_family",
                "The test ended early: {event}. Look at the packing and the guide, then repeat the test.",
                event=event_words(case.out_of_family),
            ),
        )
    yield from unmet(checks, case)
    yield from _of_causes(case)
    yield from _no_friction(case.analysis, now)
    if _is_not_assessed(case) and not _is_known_well(case, checks):
        again = say("repeat_the_test", "Repeat the test.")
        yield Finding(Ne107.FUNCTION_CHECK, joined(" ", (_not_looked_for(case), again)))


def _is_not_assessed(case: Case) -> bool:
    return ((case.analysis.get("discrepancy") or {}).get("verdict") or _NOT_ASSESSED) == _NOT_ASSESSED


def _is_known_well(case: Case, checks: tuple[Check, ...]) -> bool:
    """Whether a person chose the baseline and everything that can be measured is as it should be."""
    return case.is_chosen and not any(unmet(checks, case))


def _not_looked_for(case: Case) -> str:
    message = (case.analysis.get("discrepancy") or {}).get("message") or ""
    told = say("causes_not_looked_for", "Causes were not looked for.")
    return joined(" ", (told, message)) if message.strip() else told


def _all_well(baseline: Baseline | None, changes: Sequence[Change]) -> str:
    if baseline is None:
        return say(
            "first_of_motion",
            "nothing is out of limits; the first test of this motion: it is the baseline of those that follow",
        )
    compared = sum(one.change is not None for one in changes)
    return say(
        "nothing_out_of_limits",
        "nothing is out of limits; {n} figures were compared with the baseline of {day}",
        n=compared,
        day=f"{baseline.test.at:%Y-%m-%d}",
    )


def _stuck(case: Case, now: Figures) -> Finding | None:
    travel, valve = now.get("travel_m"), case.valve
    if travel is None or travel.value > _HARDLY_MOVED * valve.rated_travel_m:
        return None
    told = say(
        "hardly_moved",
        "The stem moved {moved:.3g mm} of its {rated:.4g mm}: a stuck stem, no supply, or a position that is not "
        "measured",
        moved=travel.value,
        rated=valve.rated_travel_m,
    )
    if case.is_full_stroke:
        return Finding(Ne107.FAILURE, say("go_and_look", "{what}. Go and look at the valve.", what=told), 100.0)
    return Finding(
        Ne107.FUNCTION_CHECK,
        say(
            "hardly_moved_at_all",
            "{what}, or a motion too small for its dead band. Repeat over the full stroke.",
            what=told,
        ),
    )


def _of_changes(case: Case, changes: Sequence[Change]) -> Iterator[Finding]:
    limits, valve = case.limits, case.valve
    by_name = {one.name: one for one in changes if not one.kept}
    for name, one in by_name.items():
        assert one.change is not None
        if name == "friction_max_n" and "friction_mean_n" in by_name:
            continue  # said already
        if name == "friction_coulomb_n" and "friction_mean_n" in by_name:
            continue
        advice = _ADVICE.get(name)
        if name == "friction_max_n":
            advice = _ADVICE["friction highest"]
        elif name.startswith("friction"):
            advice = _ADVICE["friction up" if one.change > 0.0 else "friction down"]
        state = _STATES.get(name, Ne107.MAINTENANCE)
        if name == "travel_m" and -one.change > limits.travel_failed_percent / 100.0 * valve.rated_travel_m:
            state = Ne107.FAILURE
        told = say("changed_so", "{change}: {advice}.", change=one.sentence(), advice=advice or "None")
        yield Finding(state, told, _effect_percent(case, one))


def _effect_percent(case: Case, change: Change) -> float | None:
    """What a change does to the stem, percent of rated travel, that the signal's span drives it over; None unknown."""
    span_n = ((case.analysis.get("signature") or {}).get("span") or {}).get("force_n")
    whole = None
    if change.name == "travel_m":
        whole = case.valve.rated_travel_m
    elif change.name.startswith("bench"):
        whole = case.valve.span_pa
    elif change.name.startswith("friction"):
        whole = span_n
    return None if not whole or change.change is None else 100.0 * abs(change.change) / float(whole)


def _remarks(case: Case) -> dict[str, str]:
    """What is said of the causes that do not matter yet, by their names."""
    causes = (case.analysis.get("discrepancy") or {}).get("causes") or ()
    said = {str(one["cause"]): remark(one, case.analysis, case.limits) for one in causes}
    return {name: sentence for name, sentence in said.items() if sentence}


def _of_causes(case: Case) -> Iterator[Finding]:
    """Causes that the baseline does not have; one that a person chose as the baseline, or accepted, is known."""
    found, baseline = case.analysis.get("discrepancy") or {}, case.baseline
    if case.analysis.get("accepted_model") is not None and found.get("verdict") in ("none", _NOT_ASSESSED):
        return
    known = set(baseline.test.causes) if baseline is not None else set()
    for cause in found.get("causes") or ():
        name = str(cause["cause"])
        excused = name in known and (case.is_chosen or name in _OF_THE_INSTRUMENTS)
        if excused or remark(cause, case.analysis, case.limits) or (baseline is None and name in _OF_THE_INSTRUMENTS):
            continue
        said = joined(" ", (cause["sentence"], cause["action"]))
        if baseline is not None and name not in known:
            said = say("new_since_baseline", "New since the baseline: {what}", what=said)
        yield Finding(Ne107.MAINTENANCE, said, cause.get("effect_percent_of_span"))
    accounted = baseline is not None and baseline.test.verdict not in ("none", "named")
    if found.get("verdict") == "unexplained" and not (accounted and case.is_chosen):
        told = say("unexplained", "Something that no known cause explains. Run the diagnostic sequence.")
        if baseline is not None and not accounted:
            told = say(
                "unexplained_since_baseline",
                "New since the baseline: something that no known cause explains. Run the diagnostic sequence.",
            )
        yield Finding(Ne107.MAINTENANCE, told)


def _notes(
    case: Case,
    findings: Sequence[Finding],
    changes: Sequence[Change],
    checks: tuple[Check, ...],
    *,
    is_accepted: bool,
) -> Iterator[str]:
    """Yield what is no reason for a state and still worth a word."""
    if not findings:
        yield _all_well(case.baseline, changes)
    if case.baseline is None and not is_accepted:
        yield _NO_BASELINE
    known = [one.words for one in checks if one.met is False and is_known(one, case)]
    if known and case.baseline is not None:
        yield say(
            "known_since_baseline",
            "Known since {who} chose the baseline: {checks:, }.",
            who=case.baseline.set_by,
            checks=tuple(known),
        )
    for one in checks:
        if one.open_because:
            yield say(
                "check_not_assessed",
                "{check} was not assessed: {why}.",
                check=as_heading(one.words),
                why=one.open_because,
            )
    if _is_not_assessed(case) and _is_known_well(case, checks):
        as_chosen = say(
            "as_in_chosen_baseline", "All that could be measured is as in the baseline that a person chose."
        )
        yield joined(" ", (_not_looked_for(case), as_chosen))


def _no_friction(analysis: Mapping[str, Any], now: Figures) -> Iterator[Finding]:
    if not any(name.startswith("friction") for name in now):
        note = ((analysis.get("signature") or {}).get("notes") or {}).get("friction_mean_n")
        told = say("friction_not_judged", "Friction could not be judged: repeat the test.")
        if note:
            told = say(
                "friction_not_judged_because", "Friction could not be judged ({why}): repeat the test.", why=note
            )
        yield Finding(Ne107.FUNCTION_CHECK, told)


def _not_comparable(now: Figures, was: Figures | None) -> Iterator[Finding]:
    has_friction = any(name.startswith("friction") for name in now)
    if has_friction and was is not None and not any(name in now for name in was if name.startswith("friction")):
        yield Finding(
            Ne107.FUNCTION_CHECK,
            say(
                "friction_not_comparable",
                "Friction was found otherwise than in the baseline and cannot be compared: repeat.",
            ),
        )
