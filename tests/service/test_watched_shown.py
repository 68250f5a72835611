"""What days in service add to a valve's state, and where it is shown: a reason to test, never a verdict."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta

import numpy as np
import pytest

from drivers.motion.motion import Motion
from drivers.motion.orders import MotionLostError, Unread
from service.config.plant import Plant
from service.figures.trend import Trend, TrendPoint, trends_picture
from service.health.changes import ValveFacts
from service.health.staleness import Oldest, Staleness
from service.health.watched import friction_changed, notes_of
from service.model.health_figures import Figure
from service.model.health_limits import HealthLimits
from service.model.watched_day import ChangedInService, FrictionInService, JudgedBy, WatchedDay
from service.schedules.watched import WatchedDays
from service.store.store import Store
from service.words.reader import Reader
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.processes import until
from tests.support.running_service import running_application
from tests.support.watched_days import DAY, JUDGED_BY, NOON, document, said

FACTS = ValveFacts(0.1, 80_000.0, 80_000.0)


def frictions(*values_n: float, half_n: float = 30.0) -> list[FrictionInService]:
    first = DAY - timedelta(days=len(values_n) - 1)
    return [
        FrictionInService(
            first + timedelta(days=place),
            Figure(value, (value - half_n, value + half_n)),
            NOON + timedelta(days=place - len(values_n) + 1),
        )
        for place, value in enumerate(values_n)
    ]


def test_friction_that_rises_in_service_is_a_reason_to_test() -> None:
    changed = friction_changed(frictions(1000, 1010, 990, 1200, 1400, 1420, 1390), DAY, HealthLimits(), FACTS)
    assert changed is not None
    assert changed.sentence == (
        "Friction in service has risen by 40 % since 2026-11-15, from 1000 N to 1400 N "
        "(watched, not tested; 25 % are allowed): test this valve."
    )
    assert changed.since == NOON - timedelta(days=1)  # the first day whose last three had a median beyond the limit
    fallen = friction_changed(frictions(1000, 1000, 1000, 500, 500, 500), DAY, HealthLimits(), FACTS)
    assert fallen is not None
    assert "fallen by 50 %" in fallen.sentence


@pytest.mark.parametrize("factor", [6.894757, 1.0 / 14.50377, 100.0])
def test_friction_that_changes_as_a_unit_does_asks_for_a_look_at_the_unit_first(factor: float) -> None:
    now = 1000.0 * factor
    changed = friction_changed(frictions(1000, 1000, 1000, now, 1.02 * now, now), DAY, HealthLimits(), FACTS)
    assert changed is not None
    assert changed.sentence.endswith(
        "between units of pressure: compare the transmitter's unit with the map's, and test this valve if they are the "
        "same."
    )


@pytest.mark.parametrize(
    "days",
    [
        frictions(1000, 1000, 1400, 1400, 1400),  # too few days
        frictions(1000, 1010, 990, 1100, 1200, 1180),  # within what is allowed
        frictions(1000, 1000, 1000, 1400, 1400, 1400, half_n=400.0),  # within the intervals
        frictions(1000, 1000, 1000, 1000, 1400, 1000),  # one odd day
        [],
    ],
)
def test_friction_that_may_be_as_it_was_is_no_reason(days: list[FrictionInService]) -> None:
    assert friction_changed(days, DAY, HealthLimits(), FACTS) is None


def test_days_of_another_signal_are_not_held_against_each_other() -> None:
    risen = frictions(1000, 1000, 1000, 1400, 1400, 1400)
    by_pressure = [replace(one, driven_by="pressure") for one in risen]
    by_command = [replace(one, driven_by="command") for one in risen]
    assert friction_changed([*by_pressure[:3], *by_command[3:]], DAY, HealthLimits(), FACTS) is None
    assert friction_changed(by_command, DAY, HealthLimits(), FACTS)


def test_days_that_are_long_ago_say_nothing_of_today() -> None:
    risen = frictions(1000, 1000, 1000, 1400, 1400, 1400)
    assert friction_changed(risen, DAY + timedelta(days=10), HealthLimits(), FACTS)
    assert friction_changed(risen, DAY + timedelta(days=11), HealthLimits(), FACTS) is None


def test_what_days_in_service_say_holds_from_the_day_on_which_they_said_it(plant: Plant) -> None:
    stale, since = Staleness(plant), NOON
    stale.note_watched({"FV-101": ChangedInService("Friction in service has risen.", since)})
    before, after = (stale.oldest("FV-101", since + timedelta(hours=hours)) for hours in (-1, 1))
    assert before.state("N", since) == "N"
    assert after.state("N", since - timedelta(days=1)) == "M"
    assert stale.oldest("FV-102", since + timedelta(hours=1)).state("N", since) == "N"


def test_a_test_that_came_behind_it_has_answered_what_days_in_service_asked_for(plant: Plant) -> None:
    stale, since = Staleness(plant), NOON
    stale.note_watched({"FV-101": ChangedInService("Friction in service has risen: test this valve.", since)})
    now, tested_at = since + timedelta(days=2), since + timedelta(days=1)
    oldest = stale.oldest("FV-101", now)
    assert oldest.state("N", tested_at) == "N"
    assert oldest.health({"ne107": "N", "reasons": []}, tested_at, now) == {"ne107": "N", "reasons": []}
    assert oldest.state("N", since - timedelta(hours=1)) == "M"
    assert oldest.state(None, None) == "M"


@pytest.mark.parametrize(("tested", "shown"), [("N", "M"), ("C", "M"), ("M", "M"), ("S", "S"), ("F", "F"), (None, "M")])
def test_what_was_watched_asks_for_maintenance_at_most(tested: str | None, shown: str) -> None:
    oldest = Oldest(NOON - timedelta(days=35), "35 are allowed", "Friction in service has risen.")
    assert oldest.state(tested, NOON) == shown
    health = oldest.health({"ne107": tested, "reasons": ["as tested"]}, NOON, NOON)
    assert health is not None
    assert (health["ne107"], health["reasons"]) == (shown, ["Friction in service has risen.", "as tested"])
    assert health["watched"] is True


async def test_a_valve_whose_friction_rose_in_service_is_shown_so_everywhere(plant: Plant) -> None:
    store = Store(plant.service.store)
    today = datetime.now(UTC).date()
    for back, friction_n in enumerate((1400.0, 1410.0, 1390.0, 1000.0, 1000.0, 1000.0)):
        store.watched.add(said(today - timedelta(days=back), friction_n), "")
        store.watched.add(said(today - timedelta(days=back), 1000.0, valve="FV-102"), "")
    async with running_application(app_of(plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:

        async def is_noted() -> bool:
            return (await client.get("/valves/FV-101")).json()["health"] is not None

        await until(is_noted, 10.0, "the first look at days in service")
        health = (await client.get("/valves/FV-101")).json()["health"]
        assert health["ne107"] == "M"
        assert "risen by 40 %" in health["reasons"][0]
        assert (await client.get("/valves/FV-102")).json()["health"] is None
        listed = {one["tag"]: one["health"] for one in (await client.get("/valves")).json()["valves"]}
        assert listed["FV-101"] == health
        assert listed["FV-102"] is None
        asked = (await client.get("/valves", params={"ne107": "M"})).json()["valves"]
        assert [one["tag"] for one in asked] == ["FV-101"]
        assert (await client.get("/valves", params={"ne107": "M", "state": "completed"})).json()["valves"] == []
        assert 'breakaway_valve_ne107{state="M",valve="FV-101"} 1.0' in (await client.get("/metrics")).text
        assert "risen by 40 %" in (await client.get("/")).text
        assert "risen by 40 %" in (await client.get("/ui/valves/FV-101")).text


async def test_days_by_another_nameplate_are_not_held_against_those_by_this_one_and_that_is_said(plant: Plant) -> None:
    """A larger actuator raises every force that is computed; the pressures are as they were."""
    store, stale = Store(plant.service.store), Staleness(plant)
    days = WatchedDays(plant, store, stale, None, "breakaway 0")
    smaller = replace(JUDGED_BY, area_m2=0.04)
    for back, (friction_n, by) in enumerate([*[(1400.0, JUDGED_BY)] * 5, *[(1000.0, smaller)] * 4]):
        store.watched.add(said(DAY - timedelta(days=back), friction_n, by=by), "")
    days.note_states(DAY)
    assert stale.watched("FV-101", NOON) is None
    async with running_application(app_of(plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:
        body = (await client.get("/valves/FV-101/watched")).json()
        page = (await client.get("/ui/valves/FV-101")).text
    why = (
        "Friction is not compared with that of 4 days up to 2026-11-16: the nameplate was another (effective area "
        "400.0 cm², travel 101.6 mm; now effective area 645.2 cm², travel 101.6 mm). 6 days by the present one are "
        "needed."
    )
    assert body["notes"] == [why]
    assert page.count(why) == 1
    assert [one["area_m2"] for one in body["days"][4:6]] == [0.06452, 0.04]
    for back in range(5, 9):  # as the present nameplate would have judged them
        store.watched.add(said(DAY - timedelta(days=back), 1000.0), "")
    for ahead in range(3):  # read while the clock was ahead
        store.watched.add(said(date(2036, 1, 1 + ahead), 1000.0), "")
    days.note_states(DAY)
    changed = stale.watched("FV-101", NOON)
    assert changed is not None
    assert "risen by 40 %" in changed.sentence
    store.close()


@pytest.mark.parametrize(
    ("other", "is_like"),
    [
        (JudgedBy(0.1016, 0.06452), True),
        (JudgedBy(4.0 * 0.0254, 100.0062 * 0.0254**2), True),  # the same in inches
        (JudgedBy(0.1016, 0.0646), False),
        (JudgedBy(0.102, 0.06452), False),
        (JudgedBy(0.1016, None), False),
        (JudgedBy(), False),
    ],
)
def test_a_nameplate_is_like_another_if_travel_and_area_are(other: JudgedBy, is_like: bool) -> None:
    assert other.is_like(JUDGED_BY) is JUDGED_BY.is_like(other) is is_like


@pytest.mark.parametrize(("missing", "is_said"), [(6, False), (7, True)])
def test_a_week_without_a_day_is_said_once_between_the_days_that_there_are(missing: int, is_said: bool) -> None:
    backs = [0, 1, 2, *(3 + missing + back for back in range(3))]
    notes = notes_of([said(DAY - timedelta(days=back), 1000.0) for back in backs], JUDGED_BY)
    assert bool(notes) is is_said
    if is_said:
        assert notes[0].startswith("Nothing was kept from 2026-11-12 to 2026-11-18: the stem did not move, or ")
        assert len(notes) == 1


async def test_a_valve_that_cannot_be_read_is_shown_so_once_with_what_to_do(
    watched_plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = "bus plc-1: device 1 has no register 4123: correct the map"

    async def unread(_: Motion) -> dict[str, Unread]:
        return dict.fromkeys(("FV-101", "FV-102"), Unread(why, NOON))

    async def nobody(_: Motion) -> dict[str, Unread]:
        raise MotionLostError("it is not there")

    async with running_application(app_of(watched_plant, rig=FakeRig(), analyst=FakeAnalyst())) as client:
        assert (await client.get("/valves/FV-101/watched")).json()["unread"] is None
        monkeypatch.setattr(Motion, "unread", unread)
        body = (await client.get("/valves/FV-101/watched")).json()
        assert body["unread"] == {"since": "2026-11-22T12:00:00Z", "reason": why}
        page = " ".join((await client.get("/ui/valves/FV-101")).text.split())
        assert page.count(why) == 1
        assert "Not read since " in page
        assert (await client.get("/valves/FV-102/watched")).json()["unread"] is None  # it is not watched
        monkeypatch.setattr(Motion, "unread", nobody)
        assert (await client.get("/valves/FV-101/watched")).json()["unread"] is None
        assert (await client.get("/ui/valves/FV-101")).status_code == 200


def full(day: date, friction_n: float | None) -> WatchedDay:
    base = document(friction_n)
    unit = {"unit": "N/m", "value": 52_000.0, "ci95": [51_000.0, 53_000.0], "scatter": None, "count": 9, "note": ""}
    travel = {"unit": "m", "total": 0.5345, "cycles": 15}
    whole = {**base, "figures": {**base["figures"], "spring_rate": unit}, "travel": travel}
    return WatchedDay("FV-101", day, NOON - timedelta(hours=7), NOON, 10, NOON, "breakaway 0", whole)


async def test_the_page_shows_the_last_day_in_service_and_says_that_it_is_no_test(watched_plant: Plant) -> None:
    store = Store(watched_plant.service.store)
    async with running_application(app_of(watched_plant, store=store, rig=FakeRig(), analyst=FakeAnalyst())) as client:
        page = (await client.get("/ui/valves/FV-101")).text
        assert "No day in service has been judged yet." in page
        assert "Read from 22:00 to 05:00, every 0.1 s." in page
        assert "trend.svg" not in page
        assert 'id="in-service"' not in (await client.get("/ui/valves/FV-102")).text
        store.watched.add(full(DAY, 1100.0), "")
        page = (await client.get("/ui/valves/FV-101")).text
        assert "Watched while its controller moved it, not tested. 2026-11-21" in page
        assert "1100 ± 30 N" in page
        assert "534.5 mm, 12 moves, 15 turns" in page
        picture = (await client.get("/ui/figures/valves/FV-101/trend.svg")).text
        assert "Open circles: days in service, watched and not tested." in " ".join(picture.split())
        store.watched.add(full(DAY, None), "")
        assert "<dd>not known: few moves</dd>" in (await client.get("/ui/valves/FV-101")).text
        nothing = WatchedDay("FV-101", DAY, NOON, NOON, 0, NOON, "x", None, "FV-101: the stem made 0 moves")
        store.watched.add(nothing, "")
        assert "FV-101: the stem made 0 moves." in (await client.get("/ui/valves/FV-101")).text


def test_days_in_service_are_drawn_apart_from_tests_and_change_no_line_between_them() -> None:
    tests = tuple(TrendPoint(NOON - timedelta(days=back), 600.0 + back, (590.0, 610.0)) for back in (9, 5, 1))
    days = tuple(TrendPoint(NOON - timedelta(days=back), 640.0, (600.0, 680.0)) for back in (3, 2))
    bare = trends_picture([Trend("friction_mean_n", "friction, mean", "N", tests)], Reader(zone=UTC))
    both = trends_picture([Trend("friction_mean_n", "friction, mean", "N", tests, watched=days)], Reader(zone=UTC))
    alone = trends_picture([Trend("friction_mean_n", "friction, mean", "N", (), watched=days)], Reader(zone=UTC))
    assert bare is not None
    assert both is not None
    assert alone is not None
    assert "in service is 640 ± 40 N" in both.description
    assert "in service" not in bare.description
    lines = [line for line in both.figure.axes[0].lines if len(np.asarray(line.get_xdata())) == 3]
    assert [np.asarray(line.get_ydata()).tolist() for line in lines] == [[609.0, 605.0, 601.0]]
    hollow = [line for line in both.figure.axes[0].lines if line.get_markerfacecolor() == "none"]
    assert [np.asarray(line.get_ydata()).tolist() for line in hollow] == [[640.0], [640.0]]
