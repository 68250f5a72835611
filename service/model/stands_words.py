"""Where a valve stands, as one text for every edge: its signal first, then its stem. SI, with kPa and mm."""

from __future__ import annotations

from textwrap import shorten
from typing import Final

from drivers.stands_at import StandsAt, StemVerdict
from service.model.requester import person_of
from service.model.run import Run
from service.words.sentences import as_sentence

NOT_CONFIRMED: Final = "SAFE STATE NOT CONFIRMED: go and look at the valve"
#: Of the travel from either end: a stem that should be there is closed, or open.
_AN_END: Final = 0.05
_SMALL_TRAVEL_M: Final = 0.02  # below it a tenth of a millimetre is half a percent
_LONGEST_NOTE: Final = 120
_LATE_S: Final = 5.0  # after the set time; then the text says when it was read


def where_it_stands(run: Run) -> str:
    """Return where the motion of a test left its valve; "" while that is open."""
    if run.stands is not None:
        return stands_sentence(run.stands) + _seen_since(run)
    if run.safe_confirmed is not None:  # kept before stems were looked at
        signal = "Signal at its safe value, read back." if run.safe_confirmed else f"{NOT_CONFIRMED}."
        return f"{signal} Stem not looked at."
    if not run.state.finished:
        return ""
    if run.commanded is False:
        return "This test commanded nothing: the valve stands where it stood before."
    return "Where the valve stands is not known: look at it."


def _seen_since(run: Run) -> str:
    """Return what somebody found who looked at the valve after an alarm."""
    is_alarm = run.safe_confirmed is False or (run.stands is not None and run.stands.verdict.is_alarm)
    if not is_alarm or run.acknowledged_at is None:
        return ""
    note = shorten(run.acknowledgement or "", _LONGEST_NOTE, placeholder=" …")
    who = person_of(run.acknowledged_by or "") or "Somebody"
    return f" {who} looked at it since: “{note}”."


def stands_sentence(stands: StandsAt) -> str:
    """Return signal and stem in words.

    ``Signal 0 kPa, read back. Stem 42.7 mm: 42 % OPEN: it has not closed.``
    """
    return f"{_signal(stands)} {_stem(stands)}{_late(stands)}"


def _signal(stands: StandsAt) -> str:
    safe = "its safe value" if stands.safe_pa is None else f"its safe value of {_kpa(stands.safe_pa)}"
    if stands.signal_pa is None:
        unread = f"Signal not read{_because(stands.signal_unread)}"
        if stands.signal_confirmed:
            return f"Signal was read back at {safe} when the motion ended. {unread}"
        return unread if stands.signal_confirmed is None else f"{NOT_CONFIRMED}. {unread}"
    shown = _kpa(stands.signal_pa)
    if stands.signal_confirmed is None:
        return f"Signal {shown}; this test commanded nothing."
    if not stands.signal_confirmed and stands.signal_is_safe:
        return f"{NOT_CONFIRMED}. Signal {shown} now; that was not read back when the motion ended."
    if not stands.signal_confirmed:
        return f"{NOT_CONFIRMED}. Signal {shown}, and {safe} was not read back after the motion."
    if stands.signal_is_safe is False:
        return f"Signal was read back at {safe} and is {shown} now: something else commands the valve."
    return f"Signal {shown}, read back."


def _stem(stands: StandsAt) -> str:
    if stands.verdict is StemVerdict.MOVING:
        return _moving(stands)
    if stands.stem_m is None:
        unread = f"Stem not read{_because(stands.stem_unread)}"
        return f"{unread} Nobody knows where it stands." if stands.verdict is StemVerdict.UNKNOWN else unread
    shown, percent = f"Stem {_mm(stands.stem_m, stands)}", stands.stem_percent
    if percent is None:
        return f"{shown}."
    if stands.verdict is StemVerdict.NOT_JUDGED or stands.safe_position_m is None:
        return f"{shown}: {percent + 0.0:.0f} % open, not judged."
    end = _end(stands)
    if stands.verdict is StemVerdict.THERE:
        return f"{shown}: {end or f'{_percent(percent)} open'}, as it should be."
    missed = f"it is not at its safe position of {_mm(stands.safe_position_m, stands)}"
    if stands.stem_m > stands.safe_position_m and end == "closed":
        missed = "it has not closed"
    elif stands.stem_m < stands.safe_position_m and end == "open":
        missed = "it has not opened"
    return f"{shown}: {_percent(percent)} OPEN: {missed}."


def _moving(stands: StandsAt) -> str:
    """Return what is true until the stem is looked at."""
    percent = stands.stem_percent
    seen = "" if stands.stem_m is None else f" {_mm(stands.stem_m, stands)}"
    seen += "" if percent is None else f": {_percent(percent)} open"
    stem = f"Stem{seen}," if seen else "Stem"
    when = f"it is looked at {stands.due_s:g} s after the motion"
    if stands.safe_position_m is None:
        return f"{stem} may still move: {when}."
    end = _end(stands)
    target = _mm(stands.safe_position_m, stands) + (f" ({end})" if end else "")
    return f"{stem} moving to {target}: {when}."


def _end(stands: StandsAt) -> str:
    """Return ``closed`` or ``open`` where the safe position is an end of the travel."""
    if stands.safe_position_m is None or stands.travel_m is None:
        return ""
    share = stands.safe_position_m / stands.travel_m
    return "closed" if share <= _AN_END else "open" if share >= 1.0 - _AN_END else ""


def _late(stands: StandsAt) -> str:
    if stands.verdict is StemVerdict.MOVING or stands.after_s <= stands.due_s + _LATE_S:
        return ""
    since = "the motion" if stands.signal_confirmed is not None else "the test was asked for"
    return f" Read {_span(stands.after_s)} after {since}."


def _span(span_s: float) -> str:
    for unit, seconds in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if span_s >= 2.0 * seconds:
            return f"{span_s / seconds:.0f} {unit}"
    return f"{span_s:.0f} s"


def _because(reason: str) -> str:
    return f": {as_sentence(reason)}" if reason else "."


def _percent(percent: float) -> str:
    return f"{round(percent) + 0:d} %"


def _kpa(pressure_pa: float) -> str:
    return f"{round(1.0e-3 * pressure_pa, 1) + 0.0:g} kPa"


def _mm(length_m: float, stands: StandsAt) -> str:
    places = 1 if stands.travel_m is None or stands.travel_m >= _SMALL_TRAVEL_M else 2
    return f"{round(1.0e3 * length_m, places) + 0.0:g} mm"
