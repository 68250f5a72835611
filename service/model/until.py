"""``until``: how well a test must know its figures to end before its sequence does, and whether it knows them so."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

from drivers.addresses import Mode
from service.model.family_rule import event_of_early, event_words
from valve.errors import RequestError
from valve.messages import joined, say

UNTIL_KEY: Final = "until"  # of a run's quality: what was asked for, in percent by symbol
#: What a test can be ended by: figures that are never 0, so that a share of them means something.
SYMBOLS: Final = ("F_s", "F_c", "k")
#: Own choice: with fewer an interval says little, whatever its width.
FEWEST_BREAKAWAYS: Final = 4
#: What ``POST /tests/run`` names to run what the last completed test of the valve left to be told apart.
SEPARATING: Final = "separating"
_LOW_PERCENT: Final = 0.5
_HIGH_PERCENT: Final = 50.0
_PERCENT: Final = re.compile(r"\s*(\d{1,6}(?:\.\d{1,6})?)\s*%\s*")
_REMEDY: Final = say("write_until", 'write it as {{"F_s": "5 %", "F_c": "2 %"}}')


def read_until(tag: str, asked: Mapping[str, Any] | None) -> dict[str, float] | None:
    """Return what is asked for, in percent by symbol; None where nothing is.

    Raises RequestError for an unknown symbol, for what is no percentage, and for one below 0.5 % or above 50 %.
    """
    if asked is None:
        return None
    if not asked:
        raise RequestError(
            say(
                "until_empty",
                "{tag}: until is empty, it needs at least 1 of {symbols:, }: {remedy}",
                tag=tag,
                symbols=SYMBOLS,
                remedy=_REMEDY,
            )
        )
    return {symbol: _percent(tag, symbol, value) for symbol, value in asked.items()}


def until_of(tag: str, mode: Mode, sequence: str | None, asked: Mapping[str, Any] | None) -> dict[str, str] | None:
    """Return what a test of a valve is to know to end early, as a request says it; None where nothing is asked for.

    Raises RequestError as ``read_until``, and where such a test cannot end so.
    """
    wish = read_until(tag, asked)
    if wish is None:
        return None
    if sequence == SEPARATING:
        raise RequestError(
            say(
                "separating_takes_no_until",
                "{tag}: sequence {sequence} takes no until, as causes are separated by all of it: drop it",
                tag=tag,
                sequence=SEPARATING,
            )
        )
    if mode is not Mode.POLLED:
        raise RequestError(
            say(
                "until_needs_polling",
                "{tag}: until needs a polled test, acquisition.mode is {mode} and its device plays to the end: "
                "say acquisition.mode = polled in plant.toml, or drop until",
                tag=tag,
                mode=mode.value,
            )
        )
    return as_asked(wish)


def _percent(tag: str, symbol: str, value: Any) -> float:
    if symbol not in SYMBOLS:
        raise RequestError(
            say(
                "until_symbol_unknown",
                "{tag}: until.{symbol} is unknown: choose one of {symbols:, }",
                tag=tag,
                symbol=symbol[:32],
                symbols=SYMBOLS,
            )
        )
    found = _PERCENT.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise RequestError(
            say(
                "until_no_percentage",
                "{tag}: until.{symbol} is {value}, it must be a percentage: {remedy}",
                tag=tag,
                symbol=symbol,
                value=repr(str(value)[:32]),
                remedy=_REMEDY,
            )
        )
    percent = float(found.group(1))
    if not _LOW_PERCENT <= percent <= _HIGH_PERCENT:
        limit = say("at_most_percent", "at most {percent:g} %", percent=_HIGH_PERCENT)
        if percent < _LOW_PERCENT:
            limit = say("at_least_percent", "at least {percent:g} %", percent=_LOW_PERCENT)
        raise RequestError(
            say(
                "until_outside",
                "{tag}: until.{symbol} is {percent:g} %, it must be {limit}: {remedy}",
                tag=tag,
                symbol=symbol,
                percent=percent,
                limit=limit,
                remedy=_REMEDY,
            )
        )
    return percent


def pairs_of(texts: Iterable[str]) -> dict[str, str] | None:
    """Return SYMBOL=PERCENT texts of a command line as the field of a request; None where there is none.

    Raises RequestError for a text of another form.
    """
    found: dict[str, str] = {}
    for text in texts:
        symbol, separator, percent = text.partition("=")
        if not separator:
            raise RequestError(say("until_pair", "--until {text}: write it as SYMBOL=PERCENT: F_s=5%", text=repr(text)))
        found[symbol.strip()] = percent.strip()
    return found or None


def half_width_percent(entry: Mapping[str, Any] | None) -> float:
    """Half of the 95 % interval in percent of the value; infinite where there is none."""
    if entry is None or not entry.get("value") or entry.get("ci95") is None:
        return math.inf
    low, high = entry["ci95"]
    return float(50.0 * (high - low) / abs(entry["value"]))


def as_asked(until: Mapping[str, float]) -> dict[str, str]:
    """Return what is asked for as a request says it."""
    return {symbol: f"{percent:g} %" for symbol, percent in until.items()}


def is_met(until: Mapping[str, float], estimate: Mapping[str, Any]) -> bool:
    """Whether an estimate so far knows all that was asked for: from at least 4 breakaways, and by no assumption."""
    if estimate["status"] != "ok" or estimate["breakaways"] < FEWEST_BREAKAWAYS:
        return False
    return all(half_width_percent(estimate["parameters"].get(symbol)) <= most for symbol, most in until.items())


def early_words(until: Mapping[str, str] | None, ended_early: Mapping[str, Any] | None) -> str:
    """Return how a test ended that was to end once it knew enough, or ended out of its family, as a sentence.

    "" of any other test.
    """
    event = event_of_early(ended_early)
    if ended_early is not None and event is not None:
        return say(
            "ended_out_of_family",
            "The test ended early by its limits: {event}. {saved:.0f s} were not played.",
            event=event_words(event),
            saved=float(ended_early["saved_s"]),
        )
    if until is None:
        return ""
    asked = _asked({symbol: str(percent) for symbol, percent in until.items()})
    if ended_early is None:
        return say(
            "not_ended_early",
            "The test was to end once it knew {asked}: it did not, and played its whole sequence.",
            asked=asked,
        )
    return say(
        "ended_early",
        "The test ended early, as it knew {asked}: {saved:.0f s} were saved.",
        asked=asked,
        saved=float(ended_early["saved_s"]),
    )


def until_words(until: Mapping[str, float]) -> str:
    """Return what was asked for in words: ``F_s to 5 % and F_c to 2 %``."""
    return _asked(as_asked(until))


def _asked(until: Mapping[str, str]) -> str:
    wishes = [
        say("known_to", "{symbol} to {percent}", symbol=symbol, percent=percent) for symbol, percent in until.items()
    ]
    return joined(" and ", wishes)
