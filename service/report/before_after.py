"""Before beside after: each figure of two tests of a valve, the change between them, and whether the later one passes.

A change is no failure by itself: a repair is meant to change a valve. What passes is judged on the later test alone, by
its acceptance and by the limits of its change against the baseline, as its health has them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from service.health.changes import Change, ValveFacts, changes_between
from service.model.health_figures import FIGURE_KINDS, Figure, figures_of
from service.model.health_limits import HealthLimits
from service.words.units import UnitSystem, measured, quantity

#: The acceptance check that each figure is judged by.
_CHECK_OF: Final = {
    "friction_mean_n": "friction_share",
    "dead_band_percent": "dead_band",
    "response_t63_s": "response_time",
    "transducer_lag_s": "transducer_lag",
}
_ABOUT_ZERO: Final = "bench_low_pa"  # a share of it says nothing
_LEAST: Final = frozenset({"seat_load"})  # its limit is the least, of all others the most
_OF_FORCE: Final = "of the actuator's force"


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
            return f"not assessed ({self.open_because})"
        return {True: "pass", False: "FAIL", None: "–"}[self.passed]


def before_after(
    before: Mapping[str, Any], after: Mapping[str, Any], limits: HealthLimits, valve: ValveFacts, system: UnitSystem
) -> list[BeforeAfter]:
    """Return the rows of two analyses of one valve, the earlier one first."""
    checks, checks_then = _checks(after), _checks(before)
    judged = {one["name"]: one for one in (after.get("health") or {}).get("changes") or ()}
    then, now = figures_of(before), figures_of(after)
    rows = [
        _row(one, (then.get(one.name), now.get(one.name)), checks.get(_CHECK_OF.get(one.name, "")), judged, system)
        for one in changes_between(then, now, limits, valve)
    ]
    told = set(_CHECK_OF.values())
    rows += [_check_row(one, checks_then.get(name), system) for name, one in checks.items() if name not in told]
    return [row for row in rows if row.before != "–" or row.after != "–" or row.open_because]


def _checks(analysis: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    acceptance = (analysis.get("health") or {}).get("acceptance") or {}
    return {str(one["name"]): one for one in acceptance.get("checks") or ()}


def _row(
    change: Change,
    ends: tuple[Figure | None, Figure | None],
    check: Mapping[str, Any] | None,
    judged: Mapping[str, Mapping[str, Any]],
    system: UnitSystem,
) -> BeforeAfter:
    kind, against = FIGURE_KINDS[change.name], judged.get(change.name)
    said: list[str] = []
    verdicts: list[bool | None] = []
    if check is not None and check["limit"] is not None:
        share = f" {_OF_FORCE}" if check["name"] == "friction_share" else ""
        said.append(f"at most {quantity(check['limit'], check['unit'], system, 3)}{share}")
        verdicts.append(check["met"])
    if against is not None and against.get("limit") is not None:
        said.append(f"within {quantity(against['limit'], kind.unit, system, 3)} of the baseline")
        verdicts.append(bool(against.get("kept", True)))
    before, after = ("–" if one is None else measured(one.value, one.ci95, kind.unit, system) for one in ends)
    return BeforeAfter(
        _capital(kind.words),
        before,
        after,
        "".join(_moved(change, kind.unit, system)) or "–",
        "; ".join(said),
        _together(verdicts),
    )


def _moved(change: Change, unit: str, system: UnitSystem) -> Iterator[str]:
    if change.change is None:
        return
    yield _signed(change.change, change.size_ci95, unit, system)
    if change.was and unit != "percent" and change.name != _ABOUT_ZERO:
        yield f" ({100.0 * change.change / abs(change.was):+.2g} %)".replace("-", "−")
    if change.ci95 is not None and change.ci95[0] <= 0.0 <= change.ci95[1]:
        yield ", within the uncertainty"


def _signed(change: float, ci95: tuple[float, float] | None, unit: str, system: UnitSystem) -> str:
    """Return a change with its sign; two digits where its interval is not known."""
    size = quantity(abs(change), unit, system, 2) if ci95 is None else measured(abs(change), ci95, unit, system)
    return f"{'−' if change < 0.0 else '+'}{size}"


def _check_row(check: Mapping[str, Any], then: Mapping[str, Any] | None, system: UnitSystem) -> BeforeAfter:
    was, now = (None if one is None else one["value"] for one in (then, check))
    moved = "–"
    if was is not None and now is not None:
        moved = _signed(now - was, None, str(check["unit"]), system)
    most = "at least" if check["name"] in _LEAST else "at most"
    return BeforeAfter(
        _capital(str(check["meaning"])),
        measured(was, None, check["unit"], system),
        measured(now, None, check["unit"], system),
        moved,
        "" if check["limit"] is None else f"{most} {quantity(check['limit'], check['unit'], system, 3)}",
        check["met"],
        str(check.get("note") or ""),
    )


def _together(verdicts: list[bool | None]) -> bool | None:
    if False in verdicts:
        return False
    return True if True in verdicts else None


def _capital(words: str) -> str:
    return words[0].upper() + words[1:]
