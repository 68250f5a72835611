"""Before beside after: each figure of two tests of a valve, the change between them, and whether the later one passes.

A change is no failure by itself: a repair is meant to change a valve. What passes is judged on the later test alone, by
its acceptance and by the limits of its change against the baseline, as its health has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from service.health.changes import Change, ValveFacts, changes_between
from service.model.health_figures import FIGURE_KINDS, Figure, figures_of
from service.model.health_limits import HealthLimits
from service.words.reader import Reader
from service.words.sentences import as_heading, together
from valve.messages import say

#: The acceptance check that each figure is judged by.
_CHECK_OF: Final = {
    "friction_mean_n": "friction_share",
    "dead_band_percent": "dead_band",
    "response_t63_s": "response_time",
    "transducer_lag_s": "transducer_lag",
}
_ABOUT_ZERO: Final = "bench_low_pa"  # a share of it says nothing
_LEAST: Final = frozenset({"seat_load"})  # its limit is the least, of all others the most


@dataclass(frozen=True, slots=True)
class BeforeAfter:
    """One row of the table, as it is read; ``passed`` is None where nothing is asked or nothing is known.

    ``open_because`` says why a check was not made that somebody asked for.
    """

    name: str
    before: str
    after: str
    change: str
    limit: str
    passed: bool | None
    open_because: str = ""

    @property
    def verdict(self) -> str:
        """What the last column says."""
        if self.open_because:
            return say("not_assessed_in_brackets", "not assessed ({why})", why=self.open_because)
        return {True: say("check_passed", "pass"), False: say("check_failed", "FAIL"), None: "–"}[self.passed]


def before_after(
    before: Mapping[str, Any], after: Mapping[str, Any], limits: HealthLimits, valve: ValveFacts, reader: Reader
) -> list[BeforeAfter]:
    """Return the rows of two analyses of one valve, the earlier one first."""
    checks, checks_then = _checks(after), _checks(before)
    judged = {one["name"]: one for one in (after.get("health") or {}).get("changes") or ()}
    then, now = figures_of(before), figures_of(after)
    rows = [
        _row(one, (then.get(one.name), now.get(one.name)), checks.get(_CHECK_OF.get(one.name, "")), judged, reader)
        for one in changes_between(then, now, limits, valve)
    ]
    told = set(_CHECK_OF.values())
    rows += [_check_row(one, checks_then.get(name), reader) for name, one in checks.items() if name not in told]
    return [row for row in rows if row.before != "–" or row.after != "–" or row.open_because]


def _checks(analysis: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    acceptance = (analysis.get("health") or {}).get("acceptance") or {}
    return {str(one["name"]): one for one in acceptance.get("checks") or ()}


def _row(
    change: Change,
    ends: tuple[Figure | None, Figure | None],
    check: Mapping[str, Any] | None,
    judged: Mapping[str, Mapping[str, Any]],
    reader: Reader,
) -> BeforeAfter:
    kind, against = FIGURE_KINDS[change.name], judged.get(change.name)
    said: list[str] = []
    verdicts: list[bool | None] = []
    if check is not None and check["limit"] is not None:
        most = reader.quantity(check["limit"], check["unit"], 3)
        said.append(
            say("most_of_force", "at most {most} of the actuator's force", most=most)
            if check["name"] == "friction_share"
            else say("at_most", "at most {most}", most=most)
        )
        verdicts.append(check["met"])
    if against is not None and against.get("limit") is not None:
        limit = reader.quantity(against["limit"], kind.unit, 3)
        said.append(say("within_of_baseline", "within {limit} of the baseline", limit=limit))
        verdicts.append(bool(against.get("kept", True)))
    before, after = ("–" if one is None else reader.measured(one.value, one.ci95, kind.unit) for one in ends)
    return BeforeAfter(
        as_heading(kind.words),
        before,
        after,
        _moved(change, kind.unit, reader),
        together(said, "; "),
        _together(verdicts),
    )


def _moved(change: Change, unit: str, reader: Reader) -> str:
    if change.change is None:
        return "–"
    share: str = ""
    beside: str = ""
    if change.was and unit != "percent" and change.name != _ABOUT_ZERO:
        percent = f"{100.0 * change.change / abs(change.was):+.2g}".replace("-", "−")
        share = say("change_in_percent", " ({percent} %)", percent=percent)
    if change.ci95 is not None and change.ci95[0] <= 0.0 <= change.ci95[1]:
        beside = say("within_uncertainty", ", within the uncertainty")
    size = _signed(change.change, change.size_ci95, unit, reader)
    return say("change_told", "{size}{share}{beside}", size=size, share=share, beside=beside)


def _signed(change: float, ci95: tuple[float, float] | None, unit: str, reader: Reader) -> str:
    """Return a change with its sign; two digits where its interval is not known."""
    size = reader.quantity(abs(change), unit, 2) if ci95 is None else reader.measured(abs(change), ci95, unit)
    return f"{'−' if change < 0.0 else '+'}{size}"


def _check_row(check: Mapping[str, Any], then: Mapping[str, Any] | None, reader: Reader) -> BeforeAfter:
    was, now = (None if one is None else one["value"] for one in (then, check))
    moved = "–"
    if was is not None and now is not None:
        moved = _signed(now - was, None, str(check["unit"]), reader)
    limit: str = ""
    if check["limit"] is not None:
        shown = reader.quantity(check["limit"], check["unit"], 3)
        is_least = check["name"] in _LEAST
        limit = (
            say("at_least", "at least {least}", least=shown)
            if is_least
            else say("at_most", "at most {most}", most=shown)
        )
    return BeforeAfter(
        as_heading(check["meaning"]),
        reader.measured(was, None, check["unit"]),
        reader.measured(now, None, check["unit"]),
        moved,
        limit,
        check["met"],
        check.get("note") or "",
    )


def _together(verdicts: list[bool | None]) -> bool | None:
    if False in verdicts:
        return False
    return True if True in verdicts else None
