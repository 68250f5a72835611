"""The signature of a stem that goes along with its ramps between its rests."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.base import ParameterEstimate, absent
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.uniform_motion import UniformMotion
from estimators.signature.bands import bands, dead_band_figure
from estimators.signature.bench_set import NO_SPRING, bench_set
from estimators.signature.branches import Branches, fit_branches
from estimators.signature.curve import branch_curve
from estimators.signature.figures import (
    FIELDS,
    MEASURED,
    Parts,
    Signature,
    figure,
    nothing,
    percent_figure,
    signature_of,
)
from estimators.signature.passes import StartLine, lies_off, passes_by_rate
from estimators.signature.scatter import Measured
from estimators.signature.span import span_of
from valve.messages import say
from valve.nameplate import Action, Nameplate

_NO_COMMON_TRAVEL: Final = say(
    "no_common_travel",
    "the two branches share too little travel in settled motion: repeat with a larger amplitude or a slower ramp",
)
_STRAIGHT_LINES: Final = say(
    "straight_lines_used",
    "the two branches share too little travel in settled motion: straight lines through each were used",
)
_UNVARIED: Final = say("no_variation", "no variation over the travel beyond the noise")
_SHORT: Final = say("common_travel_short", "the common travel of the branches is short")
_NARROWER: Final = say(
    "loop_below_dead_band",
    "less than the dead band, and no contradiction: the loop is twice the friction of the moving stem, and a reversal "
    "takes the higher friction at breakaway as well",
)
_LARGEST_SHARE_OF_STROKE: Final = 0.3  # of the longest one among the rates: a shorter one is no central stroke
_BENT: Final = say(
    "branches_bent",
    "the two branches share too little travel in settled motion, and they are no straight lines: "
    "repeat with a larger amplitude, and see what the diagnosis says",
)
_STRAIGHT: Final = 3.0  # noises, that rows may lie off the lines
_STRAIGHT_SHARE: Final = 0.01  # own choice, of the friction: so far off the lines still tell it
_MODEL_SHARE: Final = 1.0e-6  # of the friction: what is left of transients in the uniform motion


def with_branches(motion: RecordedMotion, line: StartLine, nameplate: Nameplate) -> Signature:
    """Signature of a stem that goes along with its ramps between its rests."""
    free = motion.action is not Action.DOUBLE
    spring_start = line.spring_n_per_m if free else 0.0
    fitted = [fit_branches(motion.samples, one, spring_start, free=free) for one in passes_by_rate(motion, line)]
    branches = [one for one in fitted if one is not None]
    longest_m = max((one.stroke_m[1] - one.stroke_m[0] for one in branches), default=0.0)
    branches = [one for one in branches if one.stroke_m[1] - one.stroke_m[0] >= _LARGEST_SHARE_OF_STROKE * longest_m]
    if not branches:
        if motion.uniform is None:
            return dead_band_alone(motion, nameplate, _NO_COMMON_TRAVEL)
        return without_common_travel(motion, motion.uniform, nameplate)
    slowest = branches[0]
    span = span_of(nameplate, slowest.spring if free else None)
    unvaried = _UNVARIED if slowest.least is slowest.friction or slowest.least.value == slowest.greatest.value else ""
    figures: Parts = {
        "friction_mean_n": figure(slowest.friction),
        "friction_min_n": figure(slowest.least, scale=abs(slowest.friction.value), note=unvaried),
        "friction_max_n": figure(slowest.greatest, note=unvaried),
    }
    if free:
        figures["spring_rate_n_per_m"] = figure(slowest.spring, reason=_SHORT)
        preload = slowest.mid_line(0.0)
        figures |= bands(motion, slowest.friction, (slowest.spring.value, preload.value), span)
    else:
        figures |= dict.fromkeys(FIELDS[6:8] + FIELDS[9:], absent(NO_SPRING))
    widest = percent_figure(figure(slowest.greatest.scaled(2.0)), span)
    figures["hysteresis_percent"] = widest if widest.note else replace(widest, note=_below(widest, figures))
    bench = bench_set(nameplate, slowest.mid_line(0.0), slowest.mid_line(nameplate.actuator.travel_m), span, free=free)
    about: dict[str, Any] = {
        "central_stroke_m": list(slowest.stroke_m),
        "speed_m_per_s": slowest.speed_m_per_s,
        "cycles": slowest.cycles,
        "stick_slip": False,
        "by_rate": [_rate_json(one, nameplate) for one in branches],
        "curve": branch_curve(motion, slowest.rate_n_per_s, nameplate),
    }
    return signature_of(figures, bench, span, about)


def _below(widest: ParameterEstimate, figures: Parts) -> str:
    """Return why the loop is narrower than the dead band; "" where it is not."""
    dead_band = figures.get("dead_band_percent")
    if widest.value is None or dead_band is None or dead_band.value is None or widest.value >= dead_band.value:
        return ""
    return _NARROWER


def without_common_travel(motion: RecordedMotion, uniform: UniformMotion, nameplate: Nameplate) -> Signature:
    """Signature where the branches lie beside each other: friction as if it were the same all over the travel."""
    if motion.action is Action.DOUBLE:
        return nothing(_NO_COMMON_TRAVEL, span=span_of(nameplate, None))
    if lies_off(motion, uniform, _STRAIGHT, _STRAIGHT_SHARE):  # a slope through them is no spring rate
        return dead_band_alone(motion, nameplate, _BENT)
    spring, friction, preload, full = _straight_lines(uniform, nameplate.actuator.travel_m)
    span = span_of(nameplate, spring)
    figures: Parts = {
        "friction_mean_n": figure(friction, note=_STRAIGHT_LINES),
        "friction_min_n": absent(_NO_COMMON_TRAVEL),
        "friction_max_n": absent(_NO_COMMON_TRAVEL),
        "spring_rate_n_per_m": figure(spring, note=_STRAIGHT_LINES),
        "hysteresis_percent": absent(_NO_COMMON_TRAVEL),
        **bands(motion, friction, (spring.value, preload.value), span),
    }
    about: dict[str, Any] = {
        "central_stroke_m": None,
        "speed_m_per_s": uniform.reference_speed,
        "cycles": 0,
        "stick_slip": False,
        "by_rate": [],
        "curve": branch_curve(motion, None, nameplate),
    }
    return signature_of(figures, bench_set(nameplate, preload, full, span), span, about)


def _straight_lines(uniform: UniformMotion, travel_m: float) -> tuple[Measured, Measured, Measured, Measured]:
    """Spring rate, friction, and the mid-line at 0 and at this travel, by straight lines through the branches."""
    errors, model_n = uniform.std_error, _MODEL_SHARE * abs(uniform.friction_n)
    spring = Measured(uniform.spring_n_per_m, float(errors[0]))
    friction = Measured(uniform.friction_n, float(errors[1])).with_error(model_n)
    preload = Measured(uniform.preload_n or 0.0, float(errors[2])).with_error(model_n)
    weights = np.array([travel_m, 0.0, 1.0])
    error_n = math.sqrt(max(0.0, float(weights @ uniform.covariance @ weights)))
    return spring, friction, preload, Measured(preload.value + spring.value * travel_m, error_n)


def dead_band_alone(motion: RecordedMotion, nameplate: Nameplate, reason: str) -> Signature:
    """Signature of a motion without a steady part: a short stroke or an uneven input."""
    span = span_of(nameplate, None)
    absent_all = nothing(reason, span=span)
    if motion.action is Action.DOUBLE:
        return absent_all
    band = dead_band_figure(motion, span)
    sources = {} if band.value is None else {"dead_band_percent": MEASURED}
    about = {**absent_all.about, "curve": branch_curve(motion, None, nameplate)}
    return replace(absent_all, figures={**absent_all.figures, "dead_band_percent": band}, sources=sources, about=about)


def _rate_json(one: Branches, nameplate: Nameplate) -> dict[str, Any]:
    area_m2 = nameplate.actuator.diaphragm_area_m2
    return {
        "rate_n_per_s": one.rate_n_per_s,
        "rate_pa_per_s": None if area_m2 is None else one.rate_n_per_s / area_m2,
        "speed_m_per_s": one.speed_m_per_s,
        "cycles": one.cycles,
        "friction_mean_n": one.friction.value,
        "friction_min_n": one.least.value,
        "friction_max_n": one.greatest.value,
        "std_error_n": one.friction.std_error,
    }
