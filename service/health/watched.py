"""What days in service add to the state of a valve: friction that changed is a reason to test it, never a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date, timedelta
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.data_faults.changed_unit import LIKE_RATIO, UNIT_RATIOS
from service.config.plant import PlantValve
from service.health.changes import ValveFacts, allowed, change_of
from service.model.health_figures import Figure
from service.model.health_limits import HealthLimits
from service.model.watched_day import ChangedInService, FrictionInService, JudgedBy, WatchedDay
from service.words.units import measured_said, quantity_said
from valve.messages import joined, say

#: Days whose median stands for what friction was, and for what it is.
DAYS: Final = 3
OLDEST_DAYS: Final = 10  # that the newest day may be old
HISTORY_DAYS: Final = 400
_LONGEST_PAUSE: Final = timedelta(days=7)  # as that of a record that is watched
_DAY: Final = timedelta(days=1)
_FIGURE: Final = "friction_mean_n"


def friction_changed(
    days: Sequence[FrictionInService], today: date, limits: HealthLimits, valve: ValveFacts
) -> ChangedInService | None:
    """Return how friction in service has changed beyond its limit, and since when; None where it has not.

    ``days`` are those since the valve's baseline, oldest first. The first three are held against the last three by
    their medians. A change counts as that of a test does: beyond its 95 % interval and its limit. Days that were
    judged by another signal than the last one are left out: behind a command, friction holds the I/P's lag. The caller
    leaves out those that were judged by another nameplate than the present one, and those that have not come: the clock
    was ahead.
    """
    days = [one for one in days if one.driven_by == days[-1].driven_by]
    sentence, first = _sentence(days, today, limits, valve), len(days)
    if not sentence:
        return None
    while _sentence(days[: first - 1], days[first - 2].day, limits, valve):
        first -= 1
    return ChangedInService(sentence, days[first - 1].judged_at)


def present_nameplate(valve: PlantValve) -> JudgedBy:
    """Return by which nameplate a day of a valve would be judged now."""
    actuator = valve.nameplate.actuator
    return JudgedBy(actuator.travel_m, actuator.diaphragm_area_m2)


def notes_of(newest_first: Sequence[WatchedDay], present: JudgedBy) -> tuple[str, ...]:
    """Return what a list of days does not show by itself, a sentence each: what is not compared, what is missing."""
    return tuple(note for note in (_not_compared(newest_first, present), _missing(newest_first)) if note)


def _missing(newest_first: Sequence[WatchedDay]) -> str:
    """Return when nothing was kept for more than a week between two days."""
    pauses = [
        say("from_to", "from {first} to {last}", first=str(before.day + _DAY), last=str(after.day - _DAY))
        for after, before in pairwise(newest_first)
        if after.day - before.day > _LONGEST_PAUSE
    ]
    if not pauses:
        return ""
    return say(
        "nothing_was_kept",
        "Nothing was kept {pauses:, }: the stem did not move, or the valve was not read. The log of the "
        "motion process says which; look at the transmitter and the bus if it was not read.",
        pauses=tuple(pauses),
    )


def _not_compared(newest_first: Sequence[WatchedDay], present: JudgedBy) -> str:
    """Return why friction of some days is not held against that of others; "" where it is."""
    others = [one for one in newest_first if one.figure("friction") is not None and not one.judged_by.is_like(present)]
    if not others:
        return ""
    days = say("one_day", "1 day") if len(others) == 1 else say("n_days", "{n} days", n=len(others))
    return say(
        "friction_not_compared",
        "Friction is not compared with that of {days} up to {last}: the nameplate was another ({was}; now {now}). {n} "
        "days by the present one are needed.",
        days=days,
        last=str(others[0].day),
        was=_plate(others[0].judged_by),
        now=_plate(present),
        n=2 * DAYS,
    )


def _plate(one: JudgedBy) -> str:
    area = say("effective_area_unknown", "effective area not known")
    if one.area_m2 is not None:
        area = say("effective_area", "effective area {area}", area=quantity_said(one.area_m2, "m2"))
    travel = say("travel_unknown", "travel not known")
    if one.travel_m is not None:
        travel = say("plate_travel", "travel {travel}", travel=quantity_said(one.travel_m, "m"))
    return joined(", ", (area, travel))


def _sentence(days: Sequence[FrictionInService], today: date, limits: HealthLimits, valve: ValveFacts) -> str:
    """Return the change in a sentence; "" where there is none that counts."""
    if len(days) < 2 * DAYS or (today - days[-1].day).days > OLDEST_DAYS:
        return ""
    was, now = _median(days[:DAYS]), _median(days[-DAYS:])
    change = change_of(_FIGURE, was, now, *allowed(_FIGURE, was, limits, valve))
    if change.kept or change.change is None or change.limit is None:
        return ""
    from_n, to_n = (measured_said(one.value, None, "N") for one in (was, now))
    moved, limit = (100.0 * abs(part) / was.value for part in (change.change, change.limit))
    since, remedy = str(days[0].day), _remedy(was.value, now.value)
    if change.change > 0.0:
        return say(
            "friction_in_service_risen",
            "Friction in service has risen by {moved:.2g} % since {since}, from {was} to {now} "
            "(watched, not tested; {limit:.3g} % are allowed): {remedy}.",
            moved=moved,
            since=since,
            was=from_n,
            now=to_n,
            limit=limit,
            remedy=remedy,
        )
    return say(
        "friction_in_service_fallen",
        "Friction in service has fallen by {moved:.2g} % since {since}, from {was} to {now} "
        "(watched, not tested; {limit:.3g} % are allowed): {remedy}.",
        moved=moved,
        since=since,
        was=from_n,
        now=to_n,
        limit=limit,
        remedy=remedy,
    )


def _remedy(was_n: float, now_n: float) -> str:
    """Return what to do: a pressure in another unit changes friction by one factor, which is more than packings do."""
    ratio = max(was_n / now_n, now_n / was_n) if min(was_n, now_n) > 0.0 else 0.0
    units = [known for known in UNIT_RATIOS if abs(ratio / known - 1.0) <= LIKE_RATIO]
    if not units:
        return say("test_this_valve", "test this valve")
    return say(
        "factor_between_units",
        "that is a factor of {factor:.4g} between units of pressure: compare the transmitter's unit with the map's, "
        "and test this valve if they are the same",
        factor=units[0],
    )


def _median(days: Sequence[FrictionInService]) -> Figure:
    value = float(np.median([one.friction.value for one in days]))
    ends = [one.friction.ci95 for one in days if one.friction.ci95 is not None]
    if not ends:
        return Figure(value)
    half = float(np.median([0.5 * (high - low) for low, high in ends]))
    return Figure(value, (value - half, value + half))
