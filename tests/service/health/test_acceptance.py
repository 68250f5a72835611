"""Acceptance: what a valve must do from its first test on."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest

from service.health.assess import assess
from service.health.results import Case, Health
from service.model.health_figures import figures_of
from service.model.health_limits import HealthLimits
from service.model.past_test import Baseline, PastTest
from service.shown.analysis_summary import verdict_lines
from tests.service.health.analyses import FACTS, LIMITS, SPOT, analysis
from valve.errors import ConfigurationError

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
WHOLE: dict[str, Any] = {"signal_percent": (0.0, 100.0), "stroke_m": (0.001, 0.1006)}
FAR: dict[str, Any] = {"signal_percent": (0.0, 100.0), "stroke_m": (0.027, 0.074)}


def judged(found: dict[str, Any], limits: HealthLimits = LIMITS, baseline: Baseline | None = None) -> Health:
    return assess(Case(found, NOW, FACTS, limits, baseline))


def met(health: Health, name: str) -> bool | None:
    return {one.name: one.met for one in health.checks}[name]


def reasons(health: Health) -> str:
    return " ".join(health.to_json()["reasons"])


def breakaways(static_n: float, scatter_n: float) -> list[dict[str, Any]]:
    entry = {"value": static_n, "ci95": [static_n - 1.0, static_n + 1.0], "scatter": scatter_n}
    return [{"method": "maximum_likelihood", "status": "ok", "parameters": {"F_s": entry}}]


def with_lag(lag_s: float) -> dict[str, Any]:
    told = {"cause": "transducer_lag", "sentence": "The I/P lags.", "action": "Look.", "parameters": {}}
    parameters = {"lag_s": {"value": lag_s, "ci95": [lag_s - 0.01, lag_s + 0.01]}}
    return analysis(discrepancy={"verdict": "named", "causes": [told | {"parameters": parameters}]})


def spot(effect_percent: float | None, verdict: str = "named") -> dict[str, Any]:
    cause = SPOT | {"effect_percent_of_span": effect_percent}
    return analysis(discrepancy={"verdict": verdict, "causes": [cause]})


def test_a_valve_that_reaches_neither_end_is_not_normal_and_says_by_how_much() -> None:
    health = judged(analysis(friction_n=1423.0, dead_band_percent=58.8, **FAR))
    assert health.ne107 == "F"
    assert not health.is_accepted
    assert health.effect_percent == pytest.approx(58.8)
    told = reasons(health)
    assert "At 0 % signal the stem stays 27 mm open, 26.6 % of the travel from that end, 5 % is allowed" in told
    assert "At 100 % signal the stem reaches 74 mm of 101.6 mm, 27.2 % of the travel from that end" in told
    assert "Dead band is 58.8 % of the signal, 30 % is allowed" in told
    assert "Friction is 1423 N, 26.7 % of the actuator's force, 15 % is allowed" in told
    assert "accept the test as the baseline on its page" in told


def test_a_valve_that_does_what_is_asked_is_normal_and_may_be_the_baseline() -> None:
    health = judged(analysis(**WHOLE))
    assert (health.ne107, health.is_accepted) == ("N", True)
    assert [one.name for one in health.checks if one.met is None] == ["repeatability", "transducer_lag"]
    assert health.to_json()["acceptance"]["passed"] is True


@pytest.mark.parametrize(
    ("stroke_m", "signal_percent", "closed", "opened", "state"),
    [
        ((0.006, 0.1), (0.0, 100.0), False, True, "S"),
        ((0.005, 0.1), (0.0, 100.0), True, True, "N"),
        ((0.001, 0.09), (0.0, 100.0), True, False, "S"),
        ((0.001, 0.09), (0.0, 90.0), True, None, "N"),  # the signal was not there
        ((0.03, 0.1), (20.0, 100.0), None, True, "N"),
        ((0.03, 0.06), (0.0, 100.0), False, False, "F"),  # more than half of the travel is missing
    ],
)
def test_an_end_must_be_reached_where_the_signal_is(
    stroke_m: tuple[float, float],
    signal_percent: tuple[float, float],
    closed: bool | None,
    opened: bool | None,
    state: str,
) -> None:
    health = judged(analysis(stroke_m=stroke_m, signal_percent=signal_percent))
    assert (met(health, "closed_end"), met(health, "open_end"), health.ne107) == (closed, opened, state)


def test_a_stop_that_the_stem_rests_on_is_told_apart_from_a_force_that_is_too_small() -> None:
    stroke: dict[str, Any] = {"stroke_m": (0.02, 0.08), "signal_percent": (0.0, 100.0)}
    told = reasons(judged(analysis(**stroke, stops_m=(0.02, None))))
    assert "stays 20 mm open, 19.7 % of the travel from that end, 5 % is allowed; it rests on a stop there" in told
    assert "reaches 80 mm of 101.6 mm, 21.3 % of the travel from that end, 5 % is allowed; the signal's force" in told


@pytest.mark.parametrize(
    ("found", "name", "state"),
    [
        (analysis(dead_band_percent=30.05), "dead_band", "N"),  # its interval reaches 29.95 %
        (analysis(dead_band_percent=30.2), "dead_band", "M"),
        (analysis(friction_n=801.5), "friction_share", "N"),  # 15 % are 800.7 N
        (analysis(friction_n=802.0), "friction_share", "M"),
        (analysis(estimates=breakaways(800.0, 79.0)), "repeatability", "N"),
        (analysis(estimates=breakaways(800.0, 81.0)), "repeatability", "M"),
        (analysis(estimates=breakaways(200.0, 50.0)), "repeatability", "N"),  # 50 N do not move the stem by 1 %
        (analysis(estimates=breakaways(200.0, 55.0)), "repeatability", "M"),
        (with_lag(0.30), "transducer_lag", "N"),
        (with_lag(0.32), "transducer_lag", "M"),
    ],
)
def test_each_figure_is_held_against_its_limit_from_the_first_test_on(
    found: dict[str, Any], name: str, state: str
) -> None:
    health = judged(found)
    assert (health.ne107, met(health, name), health.is_accepted) == (state, state == "N", state == "N")


def test_each_limit_is_the_valves_own_and_two_are_off_until_they_are_set() -> None:
    found = analysis(dead_band_percent=40.0, bench_pa=(16547.4, 82700.0))  # 20 % of the span, less 9.4 % friction
    found["signature"]["steps"] = {"summary": {"t63_s": 2.0}}
    assert judged(found).ne107 == "M"
    lenient = replace(LIMITS, dead_band_percent=45.0)
    assert judged(found, lenient).ne107 == "N"
    slow = judged(found, replace(lenient, response_time_s=1.5))
    assert "The stem takes 2 s (T63) to answer a step, 1.5 s is allowed" in reasons(slow)
    assert (slow.ne107, met(judged(found, replace(lenient, response_time_s=2.5)), "response_time")) == ("M", True)
    weak = judged(found, replace(lenient, seat_load_percent=12.0))
    assert "the plug is pressed on its seat by 10.6 % of the actuator's force, 12 % is asked for" in reasons(weak)
    assert (weak.ne107, judged(found, replace(lenient, seat_load_percent=10.0)).ne107) == ("S", "N")
    with pytest.raises(ConfigurationError, match="seat_load_percent is 0"):
        HealthLimits(seat_load_percent=0.0)
    with pytest.raises(ConfigurationError, match="dead_band_percent is 0"):
        HealthLimits(dead_band_percent=0.0)


def stroked(opening_s: float | None, closing_s: float | None, note: str = "") -> dict[str, Any]:
    found = analysis()
    ways = {
        way: None if value_s is None else {"value": value_s, "ci95": [value_s - 0.1, value_s + 0.1]}
        for way, value_s in (("opening", opening_s), ("closing", closing_s))
    }
    found["signature"]["steps"] = {"summary": {"stroke_time_s": {**ways, "note": note}}}
    return found


@pytest.mark.parametrize(
    ("found", "is_met", "state"),
    [
        (stroked(1.5, 1.95), True, "N"),
        (stroked(1.5, 2.05), True, "N"),  # its interval reaches 1.95 s
        (stroked(1.5, 2.2), False, "S"),
        (stroked(None, 2.2, "opening: the stem still moved when the step ended"), False, "S"),
        (stroked(None, 1.5, "opening: the stem still moved when the step ended"), None, "N"),
        (stroked(None, None, "opening: no step; closing: no step"), None, "N"),
        (analysis(), None, "N"),
    ],
)
def test_the_slower_stroke_is_judged_where_a_limit_is_set_and_a_step_shows_it(
    found: dict[str, Any], is_met: bool | None, state: str
) -> None:
    assert "stroke_time" not in [one.name for one in judged(found).checks], "nobody asked for it"
    health = judged(found, replace(LIMITS, stroke_time_max_s=2.0))
    assert (met(health, "stroke_time"), health.ne107) == (is_met, state)
    told = reasons(health)
    assert ("The closing stroke takes 2.2 s, 2 s is allowed" in told) == (is_met is False)
    assert ("Stroke time was not assessed" in told) == (is_met is None)
    assert ("run the sequence steps with levels_percent [0, 100, 0]" in told) == (is_met is None)


@pytest.mark.parametrize("verdict", ["named", "likely", "ambiguous"])
def test_a_cause_is_maintenance_only_where_it_moves_the_stem_by_more_than_its_limit(verdict: str) -> None:
    small, large, unknown = judged(spot(0.075, verdict)), judged(spot(1.2, verdict)), judged(spot(None, verdict))
    assert (small.ne107, small.is_accepted, small.effect_percent) == ("N", True, None)
    assert "Seen, does not matter yet: it moves the stem by 0.075 % of its travel, the limit is 1 %." in reasons(small)
    assert (large.ne107, large.is_accepted, large.effect_percent) == ("M", False, 1.2)
    assert "does not matter" not in reasons(large)
    assert unknown.ne107 == "M"
    assert judged(spot(1.2, verdict), replace(LIMITS, cause_effect_percent=2.0)).ne107 == "N"


def test_the_command_line_says_no_fault_where_all_that_was_seen_is_small() -> None:
    small = verdict_lines(spot(0.075, "likely"))
    assert small == ["No fault found.", f"Seen, does not matter yet: {SPOT['sentence']}"]
    assert verdict_lines(spot(1.2, "likely"))[0].startswith("Probably local friction:")
    known = spot(1.2) | {"health": {"remarks": ["local_friction"]}}  # the valve's own limit is wider
    assert verdict_lines(known)[0] == "No fault found."


def test_what_a_person_chose_as_the_baseline_is_known_and_what_came_since_is_told() -> None:
    found = analysis(friction_n=1423.0, dead_band_percent=58.8, **FAR)
    first = judged(found)
    unmet = tuple(one.name for one in first.checks if one.met is False)
    assert unmet == ("closed_end", "open_end", "friction_share", "dead_band")
    test = PastTest("first", NOW, figures_of(found), verdict="none", unmet=unmet)
    known = judged(found, LIMITS, Baseline(test, "anna"))
    assert known.ne107 == "N"
    assert "Known since anna chose the baseline: distance from the closed end, " in reasons(known)
    assert judged(found, LIMITS, Baseline(test)).ne107 == "F"
    healthy = replace(test, figures=figures_of(analysis(**WHOLE)), unmet=())
    assert judged(found, LIMITS, Baseline(healthy, "anna")).ne107 == "F"


def test_the_largest_effect_is_told_first_among_reasons_of_one_state() -> None:
    health = judged(analysis(friction_n=1000.0, dead_band_percent=45.0))
    assert [one[:9] for one in health.to_json()["reasons"][:2]] == ["Dead band", "Friction "]
    assert health.to_json()["effect_percent_of_span"] == 45.0
