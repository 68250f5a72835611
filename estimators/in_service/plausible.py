"""Figures that no valve can have, or that contradict the nameplate: a wrong channel, unit or clock."""

from __future__ import annotations

from typing import Final

from estimators.in_service.figure import Figure, not_known
from estimators.in_service.result import Scale
from valve.messages import Message, say

_LIKE_BENCH_SET: Final = 1.4  # four times what bench sets are off
_WIDEST_SCATTER: Final = 1.0  # of the value, from move to move
_WIDEST_OF_BREAKAWAY: Final = 0.5  # the same: packings scatter by some percent
_SUFFIXES: Final = ("", "_signal", "_percent")  # a friction in N, in the signal's unit and of the span
_CHANNELS: Final = say(
    "channels_contradict",
    "the channels contradict each other: check that they are not exchanged, are of this valve and share one clock",
)


def plausible(
    figures: dict[str, Figure], prior: tuple[float, float] | None, unit: str, scale: Scale
) -> tuple[dict[str, Figure], list[Message]]:
    """Return the figures without those that cannot be, and what the nameplate contradicts.

    ``prior``: spring rate of the nameplate in signal by position, and its standard deviation.
    """
    out = {
        name
        for name, one in figures.items()
        if _cannot_be(one, _WIDEST_OF_BREAKAWAY if name.startswith("breakaway") else _WIDEST_SCATTER)
    }
    friction, breakaway = figures["friction_signal"].ci95, figures["breakaway_signal"].ci95
    is_above = friction is not None and breakaway is not None and friction[0] > breakaway[1]
    rate = figures["spring_rate"]
    falls = rate.value is not None and rate.value < 0.0
    if is_above or falls or any(name.startswith(("friction", "breakaway")) for name in out):
        names = ("friction", "breakaway", "breakaway_up", "breakaway_down")
        out |= {name + suffix for name in names for suffix in _SUFFIXES}
    if falls:
        out |= {name + suffix for name in ("dead_band", "stick_band", "slip_jump") for suffix in _SUFFIXES}
    figures = {
        name: not_known(one.unit, _CHANNELS, one.count) if name in out and one.value is not None else one
        for name, one in figures.items()
    }
    return figures, _contradicts(rate, prior, unit, scale)


def _cannot_be(one: Figure, scatter: float) -> bool:
    if one.value is None:
        return False
    return one.value < 0.0 or (one.scatter or 0.0) > scatter * abs(one.value)


def _contradicts(rate: Figure, prior: tuple[float, float] | None, unit: str, scale: Scale) -> list[Message]:
    """One sentence where the spring rate surely differs from the nameplate's bench set, by a factor."""
    factor = 1.0 if unit == "N" else scale.area_m2
    if rate.value is None or rate.ci95 is None or prior is None or factor is None:
        return []
    named = prior[0] * factor
    if rate.ci95[0] <= _LIKE_BENCH_SET * named and rate.ci95[1] >= named / _LIKE_BENCH_SET:
        return []
    return [
        say(
            "spring_contradicts_nameplate",
            "The spring rate is {rate:.4g N/mm} by the moves and {named:.4g N/mm} by the nameplate's bench set, they "
            "may differ by a factor of {factor:g}: check the channels' units and clocks, and the nameplate.",
            rate=rate.value,
            named=named,
            factor=_LIKE_BENCH_SET,
        )
    ]
