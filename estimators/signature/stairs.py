"""The signature of a stem that only jumps from rest to rest."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from estimators.base import absent
from estimators.signature.bands import stiction
from estimators.signature.bench_set import bench_set
from estimators.signature.curve import slip_curve
from estimators.signature.figures import Parts, Signature, figure, percent_figure, signature_of
from estimators.signature.scatter import combined
from estimators.signature.slips import SlipBranches
from estimators.signature.span import span_of
from valve.messages import say
from valve.nameplate import Nameplate

_ENDS: Final = say("friction_at_slips_ends", "the stem moves in jumps: this is the friction at the ends of its slips")
_EACH: Final = say("friction_not_along_travel", "the stem moves in jumps: friction at each travel is not seen")
_TWICE: Final = say(
    "twice_breakaway", "twice the friction at breakaway: the most that a reversal amid stick-slip takes"
)
_WIDEST: Final = say("widest_before_slips", "widest just before the slips, where it is 2 F_s")


def stick_slip_signature(lines: SlipBranches, nameplate: Nameplate) -> Signature:
    """Signature of a stem that only jumps: branches through the ends of its slips, dead band 2 F_s at the most."""
    span = span_of(nameplate, lines.spring)
    band = combined(
        lines.static_friction.value + lines.end_friction.value, (lines.static_friction, 1.0), (lines.end_friction, 1.0)
    )
    jump = combined(
        lines.static_friction.value - lines.end_friction.value, (lines.static_friction, 1.0), (lines.end_friction, 1.0)
    )
    widest = figure(lines.static_friction.scaled(2.0))
    figures: Parts = {
        "friction_mean_n": figure(lines.end_friction, note=_ENDS),
        "friction_min_n": absent(_EACH),
        "friction_max_n": absent(_EACH),
        "spring_rate_n_per_m": figure(lines.spring),
        "dead_band_percent": percent_figure(widest, span, _TWICE),
        "hysteresis_percent": percent_figure(widest, span, _WIDEST),
        **stiction(band, jump, span),
    }
    full = lines.preload.value + lines.spring.value * nameplate.actuator.travel_m
    travel_m = nameplate.actuator.travel_m
    bench = bench_set(nameplate, lines.preload, combined(full, (lines.preload, 1.0), (lines.spring, travel_m)), span)
    about: dict[str, Any] = {
        "central_stroke_m": None,
        "speed_m_per_s": None,
        "cycles": 0,
        "stick_slip": True,
        "slip_m": float(np.median(lines.slips.jump_m)),
        "by_rate": [],
        "curve": slip_curve(lines.slips, nameplate),
    }
    return signature_of(figures, bench, span, about)
