"""What the signature consists of: each figure with its interval or the reason why it is missing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from estimators.base import LARGEST_RELATIVE_HALF_WIDTH, UNDETERMINED, ParameterEstimate, absent, known_badly
from estimators.signature.scatter import Measured
from estimators.signature.span import Span
from valve.messages import joined, say

Parts = dict[str, ParameterEstimate]
Bench = tuple[ParameterEstimate, ParameterEstimate]

# In the order of the analysis object; each is a number there, or null with its reason under ``notes``.
FIELDS: Final = (
    "friction_mean_n",
    "friction_min_n",
    "friction_max_n",
    "friction_mean_percent",
    "friction_min_percent",
    "friction_max_percent",
    "spring_rate_n_per_m",
    "dead_band_percent",
    "hysteresis_percent",
    "stick_band_percent",
    "slip_jump_percent",
)
MEASURED: Final = say("measured_on_recording", "measured on the recording")
FORCES: Final = ("friction_mean_n", "friction_min_n", "friction_max_n")
_NO_SPAN: Final = say(
    "span_unknown", "the span is unknown: give signal.range_pa or actuator.bench_set_pa on the nameplate"
)
_MORE_CYCLES: Final = say("repeat_with_more_cycles", "repeat with more cycles")


@dataclass(frozen=True, slots=True)
class Signature:
    """The figures by name (FIELDS and both ends of the bench set), and what belongs to them.

    ``about`` holds what a picture or a person may want beside the figures: stroke, speed, other rates, curve.
    """

    figures: dict[str, ParameterEstimate]
    bench_set: tuple[ParameterEstimate, ParameterEstimate]
    sources: Mapping[str, str]
    span: Span | None
    about: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the signature as in the analysis object: plain numbers, ``intervals`` and ``notes`` by figure."""
        low, high = self.bench_set
        numbers: dict[str, Any] = {name: self.figures[name].value for name in FIELDS}
        known = low.value is not None and high.value is not None
        numbers["bench_set_pa"] = [low.value, high.value] if known else None
        intervals: dict[str, Any] = {
            name: _interval(one, self.sources.get(name)) for name, one in self.figures.items() if one.value is not None
        }
        if known:
            ends = [_interval(one, None) for one in self.bench_set]
            intervals["bench_set_pa"] = {
                "std_error": [end["std_error"] for end in ends],
                "ci95": [end["ci95"] for end in ends],
                "from": self.sources.get("bench_set_pa"),
            }
        notes = {name: one.note for name, one in {**self.figures, "bench_set_pa": low}.items() if one.note}
        sources = list(dict.fromkeys(self.sources.values()))
        return {
            "from": joined("; ", sources) or None,
            **numbers,
            "span": None if self.span is None else self.span.to_json(),
            "intervals": intervals,
            "notes": notes,
            **self.about,
        }


def _interval(one: ParameterEstimate, source: str | None) -> dict[str, Any]:
    ci95 = None if one.ci95 is None else list(one.ci95)
    return {"std_error": one.std_error, "ci95": ci95, "from": source}


def figure(found: Measured, *, scale: float = 0.0, note: str = "", reason: str = "") -> ParameterEstimate:
    """Return the figure with its 95 % interval, or its absence where that is wider than +-30 % of it.

    ``scale`` takes the value's place in that rule for what may be zero.
    """
    if not (math.isfinite(found.value) and math.isfinite(found.std_error)):
        return absent(reason or UNDETERMINED)
    half = found.half_width
    size = max(abs(found.value), scale)
    if half > LARGEST_RELATIVE_HALF_WIDTH * size:
        why = reason or _MORE_CYCLES
        if size > 0.0:
            return absent(known_badly(size, half, why))
        return absent(
            say(
                "not_told_from_nothing",
                "not told from nothing, the limit is {limit:g %}: {why}",
                limit=LARGEST_RELATIVE_HALF_WIDTH,
                why=why,
            )
        )
    return ParameterEstimate(found.value, found.std_error, (found.value - half, found.value + half), True, note)


def percent_figure(one: ParameterEstimate, span: Span | None, note: str = "") -> ParameterEstimate:
    """Return a figure in N as percent of the span."""
    if one.value is None:
        return one
    if span is None:
        return absent(_NO_SPAN)
    to = 100.0 / span.force_n
    return ParameterEstimate(
        one.value * to,
        None if one.std_error is None else one.std_error * to,
        None if one.ci95 is None else (one.ci95[0] * to, one.ci95[1] * to),
        True,
        note or one.note,
    )


def signature_of(figures: Parts, bench: Bench, span: Span | None, about: dict[str, Any]) -> Signature:
    """Return the signature of measured figures, with the frictions in percent of span."""
    shares = {f"{name[:-2]}_percent": percent_figure(figures[name], span) for name in FORCES}
    whole = {name: {**figures, **shares}[name] for name in FIELDS}
    sources = {name: MEASURED for name, one in whole.items() if one.value is not None}
    if bench[0].value is not None:
        sources["bench_set_pa"] = MEASURED
    return Signature(whole, bench, sources, span, about)


def nothing(reason: str, *, span: Span | None = None) -> Signature:
    """Return a signature of which every figure is absent for this reason."""
    bench = (absent(reason), absent(reason))
    return Signature({name: absent(reason) for name in FIELDS}, bench, {}, span, {"curve": None})
