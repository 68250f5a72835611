"""Where a valve stands, as one text for every edge: its signal first, then its stem. SI, with kPa and mm."""

from __future__ import annotations

from textwrap import shorten
from typing import Final

from drivers.stands_at import StandsAt, StemVerdict
from service.model.requester import person_of
from service.model.run import Run
from service.words.sentences import as_sentence
from valve.messages import Message, joined, say

NOT_CONFIRMED: Final = say("safe_state_not_confirmed", "SAFE STATE NOT CONFIRMED: go and look at the valve")
_CLOSED: Final = "closed"
_OPEN: Final = "open"
_MINUTE_S: Final = 60.0
_HOUR_S: Final = 3600.0
_DAY_S: Final = 86400.0
#: Of the travel from either end: a stem that should be there is closed, or open.
_AN_END: Final = 0.05
_SMALL_TRAVEL_M: Final = 0.02  # below it a tenth of a millimetre is half a percent
_LONGEST_NOTE: Final = 120
_LATE_S: Final = 5.0  # after the set time; then the text says when it was read


def where_it_stands(run: Run) -> str:
    """Return where the motion of a test left its valve; "" while that is open."""
    if run.stands is not None:
        return joined(" ", filter(None, (*_said(run.stands), _seen_since(run))))
    if run.safe_confirmed is not None:  # kept before stems were looked at
        if run.safe_confirmed:
            return say("safe_read_back", "Signal at its safe value, read back. Stem not looked at.")
        return say("safe_not_read_back_then", "{alarm}. Stem not looked at.", alarm=NOT_CONFIRMED)
    if not run.state.finished:
        return ""
    if run.commanded is False:
        return say("stands_where_it_stood", "This test commanded nothing: the valve stands where it stood before.")
    return say("stands_unknown", "Where the valve stands is not known: look at it.")


def _seen_since(run: Run) -> str:
    """Return what somebody found who looked at the valve after an alarm."""
    is_alarm = run.safe_confirmed is False or (run.stands is not None and run.stands.verdict.is_alarm)
    if not is_alarm or run.acknowledged_at is None:
        return ""
    note = shorten(run.acknowledgement or "", _LONGEST_NOTE, placeholder=" …")
    who = person_of(run.acknowledged_by or "")
    if not who:
        return say("somebody_looked", "Somebody looked at it since: “{note}”.", note=note)
    return say("looked_at_since", "{who} looked at it since: “{note}”.", who=who, note=note)


def stands_sentence(stands: StandsAt) -> str:
    """Return signal and stem in words.

    ``Signal 0 kPa, read back. Stem 42.7 mm: 42 % OPEN: it has not closed.``
    """
    return joined(" ", _said(stands))


def _said(stands: StandsAt) -> list[str]:
    return [one for one in (_signal(stands), _stem(stands), _late(stands)) if one]


def _signal(stands: StandsAt) -> Message:
    safe = say("its_safe_value", "its safe value")
    if stands.safe_pa is not None:
        safe = say("its_safe_value_of", "its safe value of {safe:g kPa}", safe=_tenth_of_kpa(stands.safe_pa))
    if stands.signal_pa is None:
        unread = _signal_unread(stands.signal_unread)
        if stands.signal_confirmed:
            return say(
                "signal_read_back_before",
                "Signal was read back at {safe} when the motion ended. {unread}",
                safe=safe,
                unread=unread,
            )
        if stands.signal_confirmed is None:
            return unread
        return say("signal_never_read", "{alarm}. {unread}", alarm=NOT_CONFIRMED, unread=unread)
    shown_pa = _tenth_of_kpa(stands.signal_pa)
    if stands.signal_confirmed is None:
        return say("signal_commanded_nothing", "Signal {shown:g kPa}; this test commanded nothing.", shown=shown_pa)
    if not stands.signal_confirmed and stands.signal_is_safe:
        return say(
            "signal_safe_too_late",
            "{alarm}. Signal {shown:g kPa} now; that was not read back when the motion ended.",
            alarm=NOT_CONFIRMED,
            shown=shown_pa,
        )
    if not stands.signal_confirmed:
        return say(
            "signal_not_safe",
            "{alarm}. Signal {shown:g kPa}, and {safe} was not read back after the motion.",
            alarm=NOT_CONFIRMED,
            shown=shown_pa,
            safe=safe,
        )
    if stands.signal_is_safe is False:
        return say(
            "signal_commanded_elsewhere",
            "Signal was read back at {safe} and is {shown:g kPa} now: something else commands the valve.",
            safe=safe,
            shown=shown_pa,
        )
    return say("signal_read_back", "Signal {shown:g kPa}, read back.", shown=shown_pa)


def _signal_unread(reason: str) -> Message:
    if not reason:
        return say("signal_unread", "Signal not read.")
    return say("signal_unread_because", "Signal not read: {why}", why=as_sentence(reason))


def _stem_unread(reason: str) -> Message:
    if not reason:
        return say("stem_unread", "Stem not read.")
    return say("stem_unread_because", "Stem not read: {why}", why=as_sentence(reason))


def _stem(stands: StandsAt) -> Message:
    if stands.verdict is StemVerdict.MOVING:
        return _moving(stands)
    if stands.stem_m is None:
        unread = _stem_unread(stands.stem_unread)
        if stands.verdict is not StemVerdict.UNKNOWN:
            return unread
        return say("stem_unknown", "{unread} Nobody knows where it stands.", unread=unread)
    shown, percent = _rounded_m(stands.stem_m, stands), stands.stem_percent
    if percent is None:
        return say("stem_at", "Stem {stem:g mm}.", stem=shown)
    if stands.verdict is StemVerdict.NOT_JUDGED or stands.safe_position_m is None:
        return say("stem_not_judged", "Stem {stem:g mm}: {open} % open, not judged.", stem=shown, open=_whole(percent))
    end = _end(stands)
    if stands.verdict is StemVerdict.THERE:
        if not end:
            there = say("open_so_far", "{open} % open", open=_whole(percent))
        else:
            there = say("closed", "closed") if end == _CLOSED else say("open", "open")
        return say("stem_there", "Stem {stem:g mm}: {there}, as it should be.", stem=shown, there=there)
    if stands.stem_m > stands.safe_position_m and end == _CLOSED:
        missed = say("has_not_closed", "it has not closed")
    elif stands.stem_m < stands.safe_position_m and end == _OPEN:
        missed = say("has_not_opened", "it has not opened")
    else:
        target = _rounded_m(stands.safe_position_m, stands)
        missed = say("not_at_safe_position", "it is not at its safe position of {target:g mm}", target=target)
    return say(
        "stem_astray", "Stem {stem:g mm}: {open} % OPEN: {missed}.", stem=shown, open=_whole(percent), missed=missed
    )


def _moving(stands: StandsAt) -> Message:
    """Return what is true until the stem is looked at."""
    percent, due_s = stands.stem_percent, stands.due_s
    stem = say("stem_then", "Stem")
    if stands.stem_m is not None:
        shown = _rounded_m(stands.stem_m, stands)
        stem = say("stem_seen_at", "Stem {stem:g mm},", stem=shown)
        if percent is not None:
            stem = say("stem_seen_open", "Stem {stem:g mm}: {open} % open,", stem=shown, open=_whole(percent))
    if stands.safe_position_m is None:
        return say(
            "stem_may_move", "{stem} may still move: it is looked at {due:g s} after the motion.", stem=stem, due=due_s
        )
    target = say("target", "{target:g mm}", target=_rounded_m(stands.safe_position_m, stands))
    end = _end(stands)
    if end == _CLOSED:
        target = say("target_closed", "{target} (closed)", target=target)
    elif end == _OPEN:
        target = say("target_open", "{target} (open)", target=target)
    return say(
        "stem_moves",
        "{stem} moving to {target}: it is looked at {due:g s} after the motion.",
        stem=stem,
        target=target,
        due=due_s,
    )


def _end(stands: StandsAt) -> str:
    """Return ``closed`` or ``open`` where the safe position is an end of the travel."""
    if stands.safe_position_m is None or stands.travel_m is None:
        return ""
    share = stands.safe_position_m / stands.travel_m
    return _CLOSED if share <= _AN_END else _OPEN if share >= 1.0 - _AN_END else ""


def _late(stands: StandsAt) -> str:
    if stands.verdict is StemVerdict.MOVING or stands.after_s <= stands.due_s + _LATE_S:
        return ""
    if stands.signal_confirmed is None:
        return say("read_after_request", "Read {time} after the test was asked for.", time=_span(stands.after_s))
    return say("read_after_motion", "Read {time} after the motion.", time=_span(stands.after_s))


def _span(span_s: float) -> Message:
    if span_s >= 2.0 * _DAY_S:
        return say("days", "{n:.0f} days", n=span_s / _DAY_S)
    if span_s >= 2.0 * _HOUR_S:
        return say("hours", "{n:.0f} h", n=span_s / _HOUR_S)
    if span_s >= 2.0 * _MINUTE_S:
        return say("minutes", "{n:.0f} min", n=span_s / _MINUTE_S)
    return say("seconds", "{n:.0f} s", n=span_s)


def _whole(percent: float) -> int:
    return round(percent)


def _tenth_of_kpa(pressure_pa: float) -> float:
    return 1.0e3 * (round(1.0e-3 * pressure_pa, 1) + 0.0)  # + 0.0: no minus before a zero


def _rounded_m(length_m: float, stands: StandsAt) -> float:
    places = 1 if stands.travel_m is None or stands.travel_m >= _SMALL_TRAVEL_M else 2
    return 1.0e-3 * (round(1.0e3 * length_m, places) + 0.0)
