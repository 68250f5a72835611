"""A figure now beside what it was: the change, its interval, and whether it is within what the valve is allowed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from service.config.plant import PlantValve
from service.model.health_figures import FIGURE_KINDS, Figure, Figures
from service.model.health_limits import HealthLimits
from service.words.sentences import as_heading
from service.words.units import measured_said, quantity_said
from valve.messages import say

_WITHOUT_INTERVAL: Final = 2.0  # times the limit: what may be off by an unknown amount must change more to count


@dataclass(frozen=True, slots=True)
class Change:
    """One figure, SI, against the baseline; ``limit`` is the most that it may change this way, None where none is set.

    ``ci95`` is that of the change: the root of the squares of both halves about it; None where one has none.
    """

    name: str
    was: float | None
    now: float | None
    change: float | None = None
    ci95: tuple[float, float] | None = None
    limit: float | None = None
    kept: bool = True

    @property
    def words(self) -> str:
        """What people call the figure."""
        return FIGURE_KINDS[self.name].words

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``health.changes``."""
        kind = FIGURE_KINDS[self.name]
        return {
            "name": self.name,
            "meaning": kind.words,
            "unit": kind.unit,
            "was": self.was,
            "now": self.now,
            "change": self.change,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "limit": self.limit,
            "kept": self.kept,
        }

    def sentence(self) -> str:
        """Return what changed by how much against which limit."""
        assert self.was is not None
        assert self.change is not None
        unit = FIGURE_KINDS[self.name].unit
        moved: str = measured_said(abs(self.change), self.size_ci95, unit)
        if self.was != 0.0:
            share = 100.0 * abs(self.change / self.was)
            moved = say("moved_by_share", "{moved} ({share:.3g} %)", moved=moved, share=share)
        now, was = (measured_said(one, None, unit) for one in (self.now, self.was))
        figure, limit = as_heading(self.words), quantity_said(self.limit, unit, 3)
        if self.change > 0.0:
            return say(
                "above_baseline",
                "{figure}: {now} is {moved} above the baseline's {was}, {limit} is allowed",
                figure=figure,
                now=now,
                moved=moved,
                was=was,
                limit=limit,
            )
        return say(
            "below_baseline",
            "{figure}: {now} is {moved} below the baseline's {was}, {limit} is allowed",
            figure=figure,
            now=now,
            moved=moved,
            was=was,
            limit=limit,
        )

    @property
    def size_ci95(self) -> tuple[float, float] | None:
        """Interval of the change's size, whichever way it went."""
        if self.ci95 is None or self.change is None:
            return None
        ends = sorted(abs(self.change) + (end - self.change) for end in self.ci95)
        return ends[0], ends[1]


def change_of(
    name: str, was: Figure | None, now: Figure | None, limit_up: float | None, limit_down: float | None
) -> Change:
    """Return the change of a figure. It is not kept where it is beyond its interval and beyond the limit of its way.

    A change whose interval is unknown must be beyond twice the limit.
    """
    if was is None or now is None:
        return Change(name, None if was is None else was.value, None if now is None else now.value)
    moved = now.value - was.value
    limit = limit_up if moved > 0.0 else limit_down
    halves = (was.half_width, now.half_width)
    ci95 = None
    if halves[0] is not None and halves[1] is not None:
        half = math.hypot(halves[0], halves[1])
        ci95 = (moved - half, moved + half)
    if limit is None:
        return Change(name, was.value, now.value, moved, ci95)
    is_unsure = ci95 is not None and ci95[0] <= 0.0 <= ci95[1]
    kept = is_unsure or abs(moved) <= (limit if ci95 is not None else _WITHOUT_INTERVAL * limit)
    return Change(name, was.value, now.value, moved, ci95, limit, kept)


@dataclass(frozen=True, slots=True)
class ValveFacts:
    """What of a valve its limits are relative to; the pressures that there are, Pa."""

    rated_travel_m: float
    span_pa: float | None
    available_pa: float


def facts_of(valve: PlantValve) -> ValveFacts:
    """Return what of a valve its limits are relative to."""
    plate, allowed_pa = valve.nameplate, valve.wiring.limits.pressure_pa
    span = plate.actuator.bench_set_pa if plate.signal is None else plate.signal.range_pa
    return ValveFacts(
        plate.actuator.travel_m, None if span is None else span[1] - span[0], allowed_pa[1] - allowed_pa[0]
    )


def allowed(
    name: str, was: Figure | None, limits: HealthLimits, valve: ValveFacts
) -> tuple[float | None, float | None]:
    """Return how far a figure may rise and fall, SI; None where nothing is said."""
    size = None if was is None else abs(was.value)
    if name.startswith("friction"):
        up, down = limits.friction_up_percent, limits.friction_down_percent
        if size is None:
            return None, None
        return up / 100.0 * size, (None if name == "friction_max_n" else down / 100.0 * size)
    if name == "spring_rate_n_per_m" and size is not None:
        return (limits.spring_rate_percent / 100.0 * size,) * 2
    if name.startswith("bench") and valve.span_pa is not None:
        return (limits.bench_set_percent / 100.0 * valve.span_pa,) * 2
    if name == "travel_m":
        return None, limits.travel_lost_percent / 100.0 * valve.rated_travel_m
    if name in ("response_t63_s", "transducer_lag_s") and size is not None:
        return max(limits.response_slower_percent / 100.0 * size, limits.response_slower_s), None
    return None, None


def changes_between(was: Figures | None, now: Figures, limits: HealthLimits, valve: ValveFacts) -> list[Change]:
    """Return the change of every figure that either test has; without a baseline only what is now."""
    before = {} if was is None else was
    return [
        change_of(name, before.get(name), now.get(name), *allowed(name, before.get(name), limits, valve))
        for name in FIGURE_KINDS
        if name in before or name in now
    ]
