"""Acceptance: what a valve must do from its first test on, whatever its baseline does."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from service.health.results import Case, Check, Finding, Ne107
from service.model.health_figures import Figure, Figures
from service.model.health_limits import HealthLimits
from service.words.units import measured_said
from valve.messages import joined, say

_AT_END: Final = 2.0  # own choice, percent of the span: the signal counts as at its end
_WHOLE: Final = 100.0
_WAYS: Final = ("opening", "closing")
_STROKE_TEST: Final = say(
    "run_whole_strokes",
    "run the sequence steps with levels_percent [0, 100, 0], and with a hold longer than the stroke",
)
#: What each check is called, and its unit.
_MEANINGS: Final = {
    "closed_end": (say("check_closed_end", "distance from the closed end"), "percent"),
    "open_end": (say("check_open_end", "distance from the open end"), "percent"),
    "friction_share": (say("check_friction_share", "friction in percent of the actuator's force"), "percent"),
    "dead_band": (say("check_dead_band", "dead band"), "percent"),
    "breakaway_share": (say("check_breakaway_share", "pressure to break away in percent of what there is"), "percent"),
    "repeatability": (say("check_repeatability", "scatter from breakaway to breakaway"), "percent"),
    "transducer_lag": (say("check_transducer_lag", "lag of the I/P"), "s"),
    "response_time": (say("check_response_time", "response, T63"), "s"),
    "stroke_time": (say("check_stroke_time", "stroke time"), "s"),
    "seat_load": (say("check_seat_load", "seat load in percent of the actuator's force"), "percent"),
}


def checks_of(case: Case, now: Figures) -> tuple[Check, ...]:
    """Return every check of one result, each with its value, its limit and whether it is met.

    A check is not met where the whole 95 % interval of its value is beyond the limit. One whose value is not known is
    open: ``met`` is None. A check that has no limit is left out.
    """
    made = [*_ends(case), *(make(case, now) for make in _CHECKS)]
    return tuple(one for one in made if one is not None)


def unmet(checks: tuple[Check, ...], case: Case) -> Iterator[Finding]:
    """Yield a finding for each check that is not met, unless a person chose a baseline that did not meet it either."""
    for one in checks:
        if one.met is False and not is_known(one, case):
            yield Finding(one.state, one.sentence, one.effect_percent)


def is_known(check: Check, case: Case) -> bool:
    """Whether a person knows that the valve does not meet this check, and wants it so."""
    if case.baseline is None or check.is_widened:
        return False
    return case.is_chosen and check.name in case.baseline.test.unmet


def remark(cause: Mapping[str, Any], analysis: Mapping[str, Any], limits: HealthLimits) -> str:
    """Return what is said of a cause that does not matter yet: it moves the stem by too little; "" where it matters.

    A preload off the nameplate's has the bench set's limit. A cause whose effect is not known matters.
    """
    offset = (cause.get("parameters") or {}).get("offset_n")
    span_n = ((analysis.get("signature") or {}).get("span") or {}).get("force_n")
    if cause["cause"] == "spring_preload" and offset is not None and span_n:
        percent, most = _WHOLE * abs(float(offset["value"]) / float(span_n)), limits.bench_set_percent
        if percent > most:
            return ""
        return say(
            "within_share_of_span",
            "{cause} That is within {most:.3g} % of the span.",
            cause=cause["sentence"],
            most=most,
        )
    effect, limit = cause.get("effect_percent_of_span"), limits.cause_effect_percent
    if effect is None or effect > limit:
        return ""
    return say(
        "does_not_matter_yet",
        "{cause} Seen, does not matter yet: it moves the stem by {effect:.2g} % of its travel, the limit is "
        "{limit:.3g} %.",
        cause=cause["sentence"],
        effect=float(effect),
        limit=limit,
    )


def remarked(analysis: Mapping[str, Any]) -> frozenset[str]:
    """Return the causes of an analysis that do not matter yet, as its health found; without one by default limits."""
    known = (analysis.get("health") or {}).get("remarks")
    if known is not None:
        return frozenset(known)
    causes, limits = (analysis.get("discrepancy") or {}).get("causes") or (), HealthLimits()
    return frozenset(str(one["cause"]) for one in causes if remark(one, analysis, limits))


def _met(figure: Figure | None, most: float | None = None, least: float | None = None) -> bool | None:
    if figure is None:
        return None
    low, high = figure.ci95 or (figure.value, figure.value)
    return (most is None or low <= most) and (least is None or high >= least)


def _span(case: Case) -> tuple[float, tuple[float, float]] | None:
    """Force, N, and pressures, Pa, of the signal's span; None where they are not known."""
    span = (case.analysis.get("signature") or {}).get("span") or {}
    if not span.get("force_n") or not span.get("pressure_pa"):
        return None
    return float(span["force_n"]), (float(span["pressure_pa"][0]), float(span["pressure_pa"][1]))


def _scaled(figure: Figure | None, factor: float, offset: float = 0.0) -> Figure | None:
    if figure is None:
        return None
    ends = None if figure.ci95 is None else (factor * figure.ci95[0] + offset, factor * figure.ci95[1] + offset)
    return Figure(factor * figure.value + offset, ends)


def _ends(case: Case) -> Iterator[Check]:
    """Whether the stem reaches each end of its travel once the signal is at that end.

    An end that the stem did not reach is open where the signal was not there either.
    """
    signature = case.analysis.get("signature") or {}
    stroke_m = (case.analysis.get("recording") or {}).get("stroke_m")
    signal, stops_m = signature.get("input_percent"), signature.get("stops_m") or (None, None)
    limit, to_percent = case.limits.travel_end_percent, _WHOLE / case.valve.rated_travel_m
    reached_m = () if stroke_m is None else (float(stroke_m[0]), float(stroke_m[1]))
    missed = () if not reached_m else (to_percent * reached_m[0], _WHOLE - to_percent * reached_m[1])
    at_end = (False, False) if signal is None else (signal[0] <= _AT_END, signal[1] >= _WHOLE - _AT_END)
    lost = sum(max(one, 0.0) for one, is_there in zip(missed, at_end, strict=False) if is_there)
    state = Ne107.FAILURE if lost > case.limits.travel_failed_percent else Ne107.OUT_OF_SPECIFICATION
    for place, name in enumerate(("closed_end", "open_end")):
        met, percent, sentence = None, None, ""
        if missed and (at_end[place] or missed[place] <= limit):
            percent, met = missed[place], missed[place] <= limit
            sentence = _end_missed(case, place, reached_m[place], limit, stops_m[place])
        yield Check(name, *_MEANINGS[name], percent, limit, met, state, sentence, percent)


def _end_missed(case: Case, place: int, reached_m: float, limit: float, stop_m: float | None) -> str:
    rated_m = case.valve.rated_travel_m
    if place == 0:
        said = say("stays_open", "At 0 % signal the stem stays {reached:.3g mm} open", reached=reached_m)
    else:
        said = say(
            "does_not_open",
            "At 100 % signal the stem reaches {reached:.3g mm} of {rated:.4g mm}",
            reached=reached_m,
            rated=rated_m,
        )
    why = say(
        "force_brings_no_further", "the signal's force brings it no further: look at friction, bench set and supply"
    )
    if stop_m is not None:
        why = say("rests_on_stop", "it rests on a stop there: look for what blocks it, or correct the rated travel")
    return say(
        "end_missed",
        "{what}, {missed:.3g} % of the travel from that end, {limit:.3g} % is allowed; {why}.",
        what=said,
        missed=_WHOLE * abs(reached_m - (0.0, rated_m)[place]) / rated_m,
        limit=limit,
        why=why,
    )


def _dead_band(case: Case, now: Figures) -> Check:
    figure, limit = now.get("dead_band_percent"), case.limits.dead_band_percent
    said = say(
        "dead_band_wide",
        "Dead band is {now} % of the signal, {limit:.3g} % is allowed: look at packing and guide.",
        now=_number(figure),
        limit=limit,
    )
    return _most("dead_band", figure, limit, said, figure)


def _friction(case: Case, now: Figures) -> Check:
    span, limit = _span(case), case.limits.friction_share_percent
    friction = now.get("friction_mean_n") or now.get("friction_coulomb_n")
    figure = None if span is None else _scaled(friction, _WHOLE / span[0])
    shown = "" if friction is None else measured_said(friction.value, None, "N")
    said = say(
        "friction_high",
        "Friction is {friction}, {now} % of the actuator's force, {limit:.3g} % is allowed: look at the packing and "
        "its lubrication.",
        friction=shown,
        now=_number(figure),
        limit=limit,
    )
    return _most("friction_share", figure, limit, said, figure)


def _breakaway(case: Case, now: Figures) -> Check | None:
    """Against the actuator: reversing a stuck stem takes the dead band's pressure, out of all that there is.

    A valve that a person took as its baseline like that is known; it is told of again once half of the margin that was
    left then is gone.
    """
    span, allowed = _span(case), case.limits.breakaway_share_percent
    if span is None:
        return None
    to_share = (span[1][1] - span[1][0]) / case.valve.available_pa
    was = None if case.baseline is None else case.baseline.test.figures.get("dead_band_percent")
    if case.is_chosen and was is not None:
        allowed = max(allowed, (_WHOLE + to_share * was.value) / 2.0)
    dead_band = now.get("dead_band_percent")
    share = None if dead_band is None else to_share * dead_band.value
    travel, rated_m = now.get("travel_m"), case.valve.rated_travel_m
    said = ""
    if share is not None:
        margin: str = say("hardly_any_margin", "the actuator has hardly any margin")
        if travel is not None:
            margin = say(
                "hardly_any_margin_moved",
                "the actuator has hardly any margin, and the stem moved {moved:.3g mm} of its {rated:.4g mm}",
                moved=travel.value,
                rated=rated_m,
            )
        said = say(
            "breakaway_takes_much",
            "Breaking away takes {takes:.3g kPa}, {share:.3g} % of the {available:.4g kPa} that there are, "
            "{limit:.3g} % is allowed: {margin}.",
            takes=share / _WHOLE * case.valve.available_pa,
            share=share,
            available=case.valve.available_pa,
            limit=allowed,
            margin=margin,
        )
    return Check(
        "breakaway_share",
        *_MEANINGS["breakaway_share"],
        share,
        allowed,
        None if share is None else share <= allowed,
        Ne107.OUT_OF_SPECIFICATION,
        said,
        share,
        is_widened=case.is_chosen,
    )


def _repeatability(case: Case, _now: Figures) -> Check:
    """How much F_s differs from breakaway to breakaway; a scatter too small to move the stem counts for nothing."""
    known, span, limit = _breakaway_scatter(case.analysis), _span(case), case.limits.repeatability_percent
    figure = effect = None
    if known is not None:
        static_n, scatter_n = known
        figure = Figure(_WHOLE * scatter_n / static_n)
        if span is not None:
            effect = Figure(_WHOLE * scatter_n / span[0])
            limit = max(limit, case.limits.cause_effect_percent * span[0] / static_n)
    said = say(
        "breakaway_repeats_badly",
        "The breakaway repeats to ± {now} % only, {limit:.3g} % is allowed: look at packing and guide.",
        now=_number(figure),
        limit=limit,
    )
    return _most("repeatability", figure, limit, said, effect)


def _breakaway_scatter(analysis: Mapping[str, Any]) -> tuple[float, float] | None:
    """F_s and its scatter, N, by the best method that gives both; None without one."""
    estimates = [one for one in analysis.get("estimates") or () if one.get("status") == "ok"]
    for one in sorted(estimates, key=lambda one: bool(one["method"] != "maximum_likelihood")):
        entry = (one.get("parameters") or {}).get("F_s") or {}
        if entry.get("value") and entry.get("scatter") is not None:
            return float(entry["value"]), float(entry["scatter"])
    return None


def _transducer_lag(case: Case, now: Figures) -> Check:
    figure, limit = now.get("transducer_lag_s"), case.limits.transducer_lag_s
    said = say(
        "transducer_lags",
        "The I/P lags by {now} s, {limit:.3g s} is allowed: look at its supply and tubing.",
        now=_number(figure),
        limit=limit,
    )
    return _most("transducer_lag", figure, limit, said)


def _response(case: Case, now: Figures) -> Check | None:
    figure, limit = now.get("response_t63_s"), case.limits.response_time_s
    if limit is None:
        return None
    said = say(
        "response_slow",
        "The stem takes {now} s (T63) to answer a step, {limit:.3g s} is allowed: look at the I/P.",
        now=_number(figure),
        limit=limit,
    )
    return _most("response_time", figure, limit, said)


def _stroke_time(case: Case, _now: Figures) -> Check | None:
    """The slower way of a stroke; open where a step shows neither, or one alone and that is fast enough."""
    limit = case.limits.stroke_time_max_s
    if limit is None:
        return None
    steps = (case.analysis.get("signature") or {}).get("steps") or {}
    told = (steps.get("summary") or {}).get("stroke_time_s") or {"note": say("no_steps", "the test had no steps")}
    known = {way: Figure(told[way]["value"], tuple(told[way]["ci95"])) for way in _WAYS if told.get(way)}
    slow = max(known, key=lambda way: known[way].value, default="")
    figure = known.get(slow)
    met = _met(figure, limit)
    because = "" if met is False or len(known) == len(_WAYS) else joined("; ", (told["note"], _STROKE_TEST))
    said = say(
        "stroke_slow",
        "The {way} stroke takes {now} s, {limit:.3g s} is allowed: look at supply, tubing, I/P and booster, and at the "
        "friction.",
        way=say("opening", "opening") if slow == _WAYS[0] else say("closing", "closing"),
        now=_number(figure),
        limit=limit,
    )
    value, state = None if figure is None else figure.value, Ne107.OUT_OF_SPECIFICATION
    return Check(
        "stroke_time",
        *_MEANINGS["stroke_time"],
        value,
        limit,
        None if because else met,
        state,
        said,
        open_because=because,
    )


def _seat_load(case: Case, now: Figures) -> Check | None:
    """What presses the plug on its seat at 0 % signal: F_0 - A p_0 - F_c, of the force that the span gives."""
    limit, span = case.limits.seat_load_percent, _span(case)
    if limit is None:
        return None
    bench, figure = now.get("bench_low_pa"), None
    friction = now.get("friction_mean_n") or now.get("friction_coulomb_n")
    if span is not None and bench is not None and friction is not None:
        low_pa, high_pa = span[1]
        to_percent = _WHOLE / (high_pa - low_pa)
        figure = _scaled(bench, to_percent, -to_percent * low_pa - _WHOLE * friction.value / span[0])
    said = say(
        "seat_load_low",
        "At 0 % signal the plug is pressed on its seat by {now} % of the actuator's force, {limit:.3g} % is asked for: "
        "look at the spring's adjustment and at the packing.",
        now=_number(figure),
        limit=limit,
    )
    met = _met(figure, least=limit)
    value = None if figure is None else figure.value
    return Check("seat_load", *_MEANINGS["seat_load"], value, limit, met, Ne107.OUT_OF_SPECIFICATION, said)


def _most(name: str, figure: Figure | None, limit: float, said: str, effect: Figure | None = None) -> Check:
    value, moved = (None if one is None else one.value for one in (figure, effect))
    return Check(name, *_MEANINGS[name], value, limit, _met(figure, limit), Ne107.MAINTENANCE, said, moved)


def _number(figure: Figure | None) -> str:
    return "?" if figure is None else say("three_digits", "{x:.3g}", x=figure.value)


_CHECKS: Final[tuple[Callable[[Case, Figures], Check | None], ...]] = (
    _friction,
    _dead_band,
    _breakaway,
    _repeatability,
    _transducer_lag,
    _response,
    _stroke_time,
    _seat_load,
)
