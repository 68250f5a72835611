"""The judgement: what a result says of the valve's health, as NAMUR NE 107 has it, with reasons in plain words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from service.health.changes import Change, ValveFacts, changes_between
from service.health.figures import Figures, figures_of
from service.health.forecast import forecasts, trends_of
from service.health.limits import HealthLimits
from service.health.results import Baseline, Case, Finding, Health, Ne107

_HARDLY_MOVED: Final = 0.02  # of rated travel: what a sensor's drift and noise may look like
# Properties of what the valve is measured with: a lag that was always there is no reason to send anybody.
_OF_THE_INSTRUMENTS: Final = frozenset({"transducer_lag", "transducer_dead_time", "position_lag"})
_ADVICE: Final = {
    "friction up": "look at the packing and its lubrication",
    "friction down": "the packing may have lost its load: look for a leak at the stem",
    "friction highest": "look for a tight place: a bent stem, a scored plug, the guide",
    "spring_rate_n_per_m": "look for a broken or a wrong spring",
    "bench_low_pa": "check the spring's adjustment: the valve may not shut tight",
    "bench_high_pa": "check the spring's adjustment: the valve may not open fully",
    "travel_m": "look for what blocks the stroke, at the supply and at the stops",
    "response_t63_s": "look at the I/P's supply, its filter and the tubing",
    "transducer_lag_s": "look at the I/P's supply, its filter and the tubing",
}
_STATES: Final = {
    "spring_rate_n_per_m": Ne107.OUT_OF_SPECIFICATION,
    "bench_low_pa": Ne107.OUT_OF_SPECIFICATION,
    "bench_high_pa": Ne107.OUT_OF_SPECIFICATION,
    "travel_m": Ne107.OUT_OF_SPECIFICATION,
}


def assess(case: Case) -> Health:
    """Judge one result. A change counts where it is beyond both its 95 % interval and its limit."""
    now = figures_of(case.analysis)
    was = None if case.baseline is None else case.baseline.test.figures
    changes = changes_between(was, now, case.limits, case.valve)
    trends = trends_of(case, now)
    stuck = _stuck(now, case.valve, is_full_stroke=case.is_full_stroke)
    findings: list[Finding] = [] if stuck is None else [stuck]
    if stuck is None:
        findings += _of_changes(changes, case.limits, case.valve)
        findings += _of_breakaway(case, now)
        findings += _of_causes(case)
        findings += forecasts(case, trends, changes)
        findings += _not_judged(case.analysis, now, was)
    notes = tuple(_notes(case, findings, changes))
    return Health(tuple(findings), tuple(changes), tuple(trends), case.baseline, notes)


def is_good(analysis: Mapping[str, Any]) -> bool:
    """Whether a result may become a baseline: it shows friction and spring, or at least one of them with its size."""
    figures = figures_of(analysis)
    return any(name in figures for name in ("friction_mean_n", "friction_coulomb_n", "spring_rate_n_per_m"))


def _all_well(baseline: Baseline | None, changes: Sequence[Change]) -> str:
    if baseline is None:
        return "nothing is out of limits; the first test of this motion: it is the baseline of those that follow"
    compared = sum(one.change is not None for one in changes)
    return (
        f"nothing is out of limits; {compared} figures were compared with the baseline of {baseline.test.at:%Y-%m-%d}"
    )


def _stuck(now: Figures, valve: ValveFacts, *, is_full_stroke: bool) -> Finding | None:
    travel = now.get("travel_m")
    if travel is None or travel.value > _HARDLY_MOVED * valve.rated_travel_m:
        return None
    told = (
        f"The stem moved {1e3 * travel.value:.3g} mm of its {1e3 * valve.rated_travel_m:.4g} mm: "
        "a stuck stem, no supply, or a position that is not measured"
    )
    if is_full_stroke:
        return Finding(Ne107.FAILURE, f"{told}. Go and look at the valve.")
    return Finding(
        Ne107.FUNCTION_CHECK, f"{told}, or a motion too small for its dead band. Repeat over the full stroke."
    )


def _of_changes(changes: Sequence[Change], limits: HealthLimits, valve: ValveFacts) -> Iterator[Finding]:
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
        yield Finding(state, f"{one.sentence()}: {advice}.")


def _of_breakaway(case: Case, now: Figures) -> Iterator[Finding]:
    """Against the actuator: reversing a stuck stem takes the dead band's pressure, out of all that there is.

    A valve that a person took as its baseline like that is known; it is told of again once half of the margin that was
    left then is gone.
    """
    dead_band, span = now.get("dead_band_percent"), ((case.analysis.get("signature") or {}).get("span") or {})
    if dead_band is None or not span.get("pressure_pa"):
        return
    one_percent_pa = float(span["pressure_pa"][1] - span["pressure_pa"][0]) / 100.0
    needed_pa, there_pa = dead_band.value * one_percent_pa, case.valve.available_pa
    share, allowed = 100.0 * needed_pa / there_pa, case.limits.breakaway_share_percent
    was = None if case.baseline is None else case.baseline.test.figures.get("dead_band_percent")
    if case.is_chosen and was is not None:
        allowed = max(allowed, (100.0 + 100.0 * was.value * one_percent_pa / there_pa) / 2.0)
    if share > allowed:
        travel, rated_m = now.get("travel_m"), case.valve.rated_travel_m
        reached = (
            "" if travel is None else f", and the stem moved {1e3 * travel.value:.3g} of its {1e3 * rated_m:.4g} mm"
        )
        yield Finding(
            Ne107.OUT_OF_SPECIFICATION,
            f"Breaking away takes {1e-3 * needed_pa:.3g} kPa, {share:.3g} % of the {1e-3 * there_pa:.4g} kPa "
            f"that there are, {allowed:.3g} % is allowed: the actuator has hardly any margin{reached}.",
        )


def _is_small(cause: Mapping[str, Any], case: Case) -> bool:
    """Whether a cause is within what the limits allow of it: a bench set that is off from the nameplate's by little."""
    offset = (cause.get("parameters") or {}).get("offset_n")
    span = (case.analysis.get("signature") or {}).get("span") or {}
    if cause["cause"] != "spring_preload" or offset is None or not span.get("force_n"):
        return False
    return 100.0 * abs(float(offset["value"]) / float(span["force_n"])) <= case.limits.bench_set_percent


def _of_causes(case: Case) -> Iterator[Finding]:
    """Causes that the baseline does not have; one that a person chose as the baseline, or accepted, is known."""
    found, baseline = case.analysis.get("discrepancy") or {}, case.baseline
    if case.analysis.get("accepted_model") is not None and found.get("verdict") in ("none", "not_assessed"):
        return
    known = set(baseline.test.causes) if baseline is not None else set()
    for cause in found.get("causes") or ():
        name = str(cause["cause"])
        excused = name in known and (case.is_chosen or name in _OF_THE_INSTRUMENTS)
        if excused or _is_small(cause, case) or (baseline is None and name in _OF_THE_INSTRUMENTS):
            continue
        fresh = "New since the baseline: " if baseline is not None and name not in known else ""
        yield Finding(Ne107.MAINTENANCE, f"{fresh}{cause['sentence']} {cause['action']}")
    accounted = baseline is not None and baseline.test.verdict not in ("none", "named")
    if found.get("verdict") == "unexplained" and not (accounted and case.is_chosen):
        fresh = "New since the baseline: something" if baseline is not None and not accounted else "Something"
        yield Finding(Ne107.MAINTENANCE, f"{fresh} that no known cause explains. Run the diagnostic sequence.")


def _notes(case: Case, findings: Sequence[Finding], changes: Sequence[Change]) -> Iterator[str]:
    """Yield what is no reason for a state and still worth a word."""
    if not findings:
        yield _all_well(case.baseline, changes)
    found = case.analysis.get("discrepancy") or {}
    if found.get("verdict") == "not_assessed" and found.get("message"):
        yield f"Causes were not looked for. {found['message']}"
    for cause in found.get("causes") or ():
        if _is_small(cause, case):
            yield f"{cause['sentence']} That is within {case.limits.bench_set_percent:.3g} % of the span."


def _not_judged(analysis: Mapping[str, Any], now: Figures, was: Figures | None) -> Iterator[Finding]:
    if not any(name.startswith("friction") for name in now):
        note = ((analysis.get("signature") or {}).get("notes") or {}).get("friction_mean_n")
        because = f" ({note})" if note else ""
        yield Finding(Ne107.FUNCTION_CHECK, f"Friction could not be judged{because}: repeat the test.")
    elif was is not None and not any(name in now for name in was if name.startswith("friction")):
        yield Finding(
            Ne107.FUNCTION_CHECK, "Friction was found otherwise than in the baseline and cannot be compared: repeat."
        )
