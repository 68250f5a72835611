"""The signature of one recording, measured on its branches, reversals and breakaways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.base import Estimate, Outcome, ParameterEstimate, Status, absent
from estimators.phases import Phases
from estimators.recorded_motion import RecordedMotion, read_motion
from estimators.samples import Samples, prepare
from estimators.signature.branches import Branches, fit_branches
from estimators.signature.curve import branch_curve, slip_curve
from estimators.signature.figures import FIELDS, Signature, Span, figure, percent_figure
from estimators.signature.passes import StartLine, passes_by_rate, start_line
from estimators.signature.reversals import dead_band, reversals, softness_n
from estimators.signature.scatter import Measured, combined
from estimators.signature.slips import SlipBranches, find_slips, fit_slips
from estimators.static_friction import breakaway_forces
from estimators.step_inputs import find_steps
from estimators.uniform_motion import UniformMotion
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

MEASURED: Final = "measured on the recording"
_LAG: Final = "the pressure was not measured: the I/P's lag times the ramp's rate is in it, and no interval holds that"
_NO_SPRING: Final = "no spring opposes the stem, so the input has no range in which it holds still"
_NO_COMMON_TRAVEL: Final = (
    "the two branches share too little travel in settled motion: repeat with a larger amplitude or a slower ramp"
)
_ONE_WAY: Final = (
    "steady motion was seen in one direction only, the way back is too short: "
    "repeat with a larger amplitude, or faster sampling"
)
_STEPS: Final = "the input goes in steps, and this needs ramps up and down: see the step test"
_FEWEST_STEPS: Final = 3
_UNFOLLOWED: Final = (
    "the stem moves from sample to sample by more than can be told from noise: sample faster, or test with slow ramps"
)
_SURELY_MOVED: Final = 0.05  # of rated travel
_UNVARIED: Final = "no variation over the travel beyond the noise"
_NO_REVERSAL: Final = "no reversal of a moving stem was seen on a ramp: repeat with ramps up and down"
_LARGEST_SHARE_OF_STROKE: Final = 0.3  # of the longest one among the rates: a shorter one is no central stroke
_MODEL_SHARE: Final = 1.0e-6  # of the friction: what is left of transients in the uniform motion
_FORCES: Final = ("friction_mean_n", "friction_min_n", "friction_max_n")
_LAGGING: Final = {*_FORCES, "dead_band_percent", "hysteresis_percent", "stick_band_percent"}

Parts = dict[str, ParameterEstimate]
Bench = tuple[ParameterEstimate, ParameterEstimate]


def measure_signature(recording: Recording, nameplate: Nameplate, estimates: Sequence[Estimate] = ()) -> Signature:
    """Return the signature of a recording; what it cannot give is absent with the reason.

    Spring rate, bench set and friction that cannot be measured directly come from the ``estimates`` where these
    have them (maximum likelihood first); ``sources`` says which. Raises nothing for an odd recording.
    """
    with np.errstate(all="ignore"):
        samples = prepare(recording, nameplate)
        motion = read_motion(recording, nameplate)
        found = _nothing(str(samples)) if isinstance(samples, Outcome) else _measured(samples, motion, nameplate)
    if recording.force_n is None and recording.pressure_pa is None:
        found = _with_lag(found)
    return _completed(found, estimates, nameplate)


def _nothing(reason: str, *, about: dict[str, Any] | None = None, span: Span | None = None) -> Signature:
    bench = (absent(reason), absent(reason))
    return Signature({name: absent(reason) for name in FIELDS}, bench, {}, span, {"curve": None, **(about or {})})


def _measured(samples: Samples, motion: RecordedMotion | Outcome, nameplate: Nameplate) -> Signature:
    spring = nameplate.actuator.action is not Action.DOUBLE
    if len(find_steps(samples.time_s, samples.force_n, samples.run_first)) >= _FEWEST_STEPS and _no_ramp(motion):
        return _nothing(_STEPS, span=_span(nameplate, None))
    if spring and (isinstance(motion, Outcome) or motion.uniform is None):
        slips = find_slips(samples)
        lines = None if slips is None else fit_slips(samples, slips)
        if lines is not None:
            return _stick_slip(lines, nameplate)
    if isinstance(motion, Outcome):
        swept_m = float(np.ptp(samples.position_m))
        unfollowed = motion is Outcome.NEVER_MOVED and swept_m > _SURELY_MOVED * nameplate.actuator.travel_m
        return _nothing(_UNFOLLOWED if unfollowed else str(motion), span=_span(nameplate, None))
    if motion.one_direction:
        return _nothing(str(Outcome.ONE_DIRECTION_ONLY), span=_span(nameplate, None))
    line = start_line(motion)
    if line is None:
        reason = _ONE_WAY if motion.uniform is not None else str(motion.uniform_outcome or Outcome.NO_UNIFORM_MOTION)
        return _dead_band_alone(motion, nameplate, reason)
    return _with_branches(motion, line, nameplate)


def _no_ramp(motion: RecordedMotion | Outcome) -> bool:
    """Whether no pass went along a ramp in settled motion."""
    if isinstance(motion, Outcome) or motion.one_direction:
        return True
    line = start_line(motion)
    return line is None or not passes_by_rate(motion, line)


def _span(nameplate: Nameplate, spring: Measured | None) -> Span | None:
    """The input's span: the signal's range, else the bench set, else the measured spring over the rated travel."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    named = (
        (None if nameplate.signal is None else nameplate.signal.range_pa, "signal.range_pa"),
        (nameplate.actuator.bench_set_pa, "actuator.bench_set_pa"),
    )
    for range_pa, source in named:
        if range_pa is not None and area_m2 is not None:
            return Span(area_m2 * (range_pa[1] - range_pa[0]), range_pa[0], range_pa[1], f"the nameplate's {source}")
    if spring is None or spring.value <= 0.0:
        return None
    return Span(spring.value * nameplate.actuator.travel_m, None, None, "the measured spring rate times rated travel")


def _with_branches(motion: RecordedMotion, line: StartLine, nameplate: Nameplate) -> Signature:
    """Signature of a stem that goes along with its ramps between its rests."""
    free = motion.action is not Action.DOUBLE
    spring_start = line.spring_n_per_m if free else 0.0
    fitted = [fit_branches(motion.samples, one, spring_start, free=free) for one in passes_by_rate(motion, line)]
    branches = [one for one in fitted if one is not None]
    longest_m = max((one.stroke_m[1] - one.stroke_m[0] for one in branches), default=0.0)
    branches = [one for one in branches if one.stroke_m[1] - one.stroke_m[0] >= _LARGEST_SHARE_OF_STROKE * longest_m]
    if not branches:
        if motion.uniform is None:
            return _dead_band_alone(motion, nameplate, _NO_COMMON_TRAVEL)
        return _without_common_travel(motion, motion.uniform, nameplate)
    slowest = branches[0]
    span = _span(nameplate, slowest.spring if free else None)
    unvaried = _UNVARIED if slowest.least is slowest.friction or slowest.least.value == slowest.greatest.value else ""
    figures: Parts = {
        "friction_mean_n": figure(slowest.friction),
        "friction_min_n": figure(slowest.least, scale=abs(slowest.friction.value), note=unvaried),
        "friction_max_n": figure(slowest.greatest, note=unvaried),
    }
    if free:
        figures["spring_rate_n_per_m"] = figure(slowest.spring, reason="the common travel of the branches is short")
        preload = slowest.mid_line(0.0)
        figures |= _bands(motion, slowest.friction, slowest.spring.value, preload.value, span)
    else:
        figures |= dict.fromkeys(FIELDS[6:8] + FIELDS[9:], absent(_NO_SPRING))
    figures["hysteresis_percent"] = percent_figure(figure(slowest.greatest.scaled(2.0)), span)
    bench = _bench(nameplate, slowest.mid_line(0.0), slowest.mid_line(nameplate.actuator.travel_m), span, free=free)
    about: dict[str, Any] = {
        "central_stroke_m": list(slowest.stroke_m),
        "speed_m_per_s": slowest.speed_m_per_s,
        "cycles": slowest.cycles,
        "stick_slip": False,
        "by_rate": [_rate_json(one, nameplate) for one in branches],
        "curve": branch_curve(motion, slowest.rate_n_per_s, nameplate),
    }
    return _signature(figures, bench, span, about)


def _without_common_travel(motion: RecordedMotion, uniform: UniformMotion, nameplate: Nameplate) -> Signature:
    """Signature where the branches lie beside each other: friction as if it were the same all over the travel."""
    if motion.action is Action.DOUBLE:
        return _nothing(_NO_COMMON_TRAVEL, span=_span(nameplate, None))
    errors = uniform.std_error
    spring = Measured(uniform.spring_n_per_m, float(errors[0]))
    model_n = _MODEL_SHARE * abs(uniform.friction_n)
    friction = Measured(uniform.friction_n, float(errors[1])).with_error(model_n)
    preload = Measured(uniform.preload_n or 0.0, float(errors[2])).with_error(model_n)
    span = _span(nameplate, spring)
    straight = f"{_NO_COMMON_TRAVEL.partition(':')[0]}: straight lines through each were used"
    figures: Parts = {
        "friction_mean_n": figure(friction, note=straight),
        "friction_min_n": absent(_NO_COMMON_TRAVEL),
        "friction_max_n": absent(_NO_COMMON_TRAVEL),
        "spring_rate_n_per_m": figure(spring, note=straight),
        "hysteresis_percent": absent(_NO_COMMON_TRAVEL),
        **_bands(motion, friction, spring.value, preload.value, span),
    }
    travel_m = nameplate.actuator.travel_m
    variance = np.array([travel_m, 0.0, 1.0]) @ uniform.covariance @ np.array([travel_m, 0.0, 1.0])
    full = Measured(preload.value + spring.value * travel_m, float(np.sqrt(max(0.0, variance))))
    about: dict[str, Any] = {
        "central_stroke_m": None,
        "speed_m_per_s": uniform.reference_speed,
        "cycles": 0,
        "stick_slip": False,
        "by_rate": [],
        "curve": branch_curve(motion, None, nameplate),
    }
    return _signature(figures, _bench(nameplate, preload, full, span), span, about)


def _bands(
    motion: RecordedMotion, friction: Measured, spring_n_per_m: float, preload_n: float, span: Span | None
) -> Parts:
    """Dead band from the reversals; S = F_b + F and J = F_b - F from the friction at breakaway F_b and in motion F.

    Two-parameter model of Choudhury, Thornhill and Shah (2005) with S = f_s + f_d, J = f_s - f_d (He, Wang, Pottmann
    and Qin 2007). For Karnopp's valve F_b is F_s and F is F_c + F_v v at the ramp's speed v.
    """
    figures: Parts = {"dead_band_percent": _dead_band(motion.samples, motion.phases, motion, span)}
    forces = breakaway_forces(motion.samples, motion.phases, spring_n_per_m, preload_n)
    if forces is None:
        none = absent(str(Outcome.NO_BREAKAWAY))
        return figures | {"stick_band_percent": none, "slip_jump_percent": none}
    breakaway = Measured(forces.value, max(forces.std_error, softness_n(motion.samples, motion.phases)))
    band = combined(breakaway.value + friction.value, (breakaway, 1.0), (friction, 1.0))
    jump = combined(breakaway.value - friction.value, (breakaway, 1.0), (friction, 1.0))
    return figures | _stiction(band, jump, span)


def _stiction(band: Measured, jump: Measured, span: Span | None) -> Parts:
    reason = "the breakaways scatter, or start too softly to be timed"
    unseen = "" if jump.value > jump.half_width else "no jump beyond its error"
    return {
        "stick_band_percent": percent_figure(figure(band, reason=reason), span),
        "slip_jump_percent": percent_figure(figure(jump, scale=abs(band.value), note=unseen, reason=reason), span),
    }


def _dead_band(samples: Samples, phases: Phases, motion: RecordedMotion, span: Span | None) -> ParameterEstimate:
    found = dead_band(reversals(samples, phases, motion.stops), softness_n(samples, phases))
    if found is None:
        return absent(_NO_REVERSAL)
    return percent_figure(figure(found, reason="the instants of breakaway are known too badly"), span)


def _dead_band_alone(motion: RecordedMotion, nameplate: Nameplate, reason: str) -> Signature:
    """Signature of a motion without a steady part: a short stroke or an uneven input."""
    span = _span(nameplate, None)
    nothing = _nothing(reason, span=span)
    if motion.action is Action.DOUBLE:
        return nothing
    band = _dead_band(motion.samples, motion.phases, motion, span)
    sources = {} if band.value is None else {"dead_band_percent": MEASURED}
    about = {**nothing.about, "curve": branch_curve(motion, None, nameplate)}
    return replace(nothing, figures={**nothing.figures, "dead_band_percent": band}, sources=sources, about=about)


def _stick_slip(lines: SlipBranches, nameplate: Nameplate) -> Signature:
    """Signature of a stem that only jumps: branches through the ends of its slips, dead band 2 F_s at the most."""
    span = _span(nameplate, lines.spring)
    ends = "the stem moves in jumps: this is the friction at the ends of its slips"
    each = "the stem moves in jumps: friction at each travel is not seen"
    band = combined(
        lines.static_friction.value + lines.end_friction.value, (lines.static_friction, 1.0), (lines.end_friction, 1.0)
    )
    jump = combined(
        lines.static_friction.value - lines.end_friction.value, (lines.static_friction, 1.0), (lines.end_friction, 1.0)
    )
    widest = figure(lines.static_friction.scaled(2.0))
    figures: Parts = {
        "friction_mean_n": figure(lines.end_friction, note=ends),
        "friction_min_n": absent(each),
        "friction_max_n": absent(each),
        "spring_rate_n_per_m": figure(lines.spring),
        "dead_band_percent": percent_figure(
            widest, span, "twice the friction at breakaway: the most that a reversal amid stick-slip takes"
        ),
        "hysteresis_percent": percent_figure(widest, span, "widest just before the slips, where it is 2 F_s"),
        **_stiction(band, jump, span),
    }
    full = lines.preload.value + lines.spring.value * nameplate.actuator.travel_m
    travel_m = nameplate.actuator.travel_m
    bench = _bench(nameplate, lines.preload, combined(full, (lines.preload, 1.0), (lines.spring, travel_m)), span)
    about: dict[str, Any] = {
        "central_stroke_m": None,
        "speed_m_per_s": None,
        "cycles": 0,
        "stick_slip": True,
        "slip_m": float(np.median(lines.slips.jump_m)),
        "by_rate": [],
        "curve": slip_curve(lines.slips, nameplate),
    }
    return _signature(figures, bench, span, about)


def _bench(nameplate: Nameplate, low: Measured, high: Measured, span: Span | None, *, free: bool = True) -> Bench:
    """Mid-line pressure at 0 and at rated travel, Pa."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    if not free or area_m2 is None:
        reason = _NO_SPRING if not free else "a bench set is a pressure: give actuator.diaphragm_area_m2"
        return absent(reason), absent(reason)
    scale = abs(high.value - low.value) / area_m2 if span is None else span.force_n / area_m2
    ends = [figure(one.scaled(1.0 / area_m2), scale=scale, reason="the stem moved too little") for one in (low, high)]
    missing = next((end for end in ends if end.value is None), None)
    return (ends[0], ends[1]) if missing is None else (missing, missing)


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


def _signature(figures: Parts, bench: Bench, span: Span | None, about: dict[str, Any]) -> Signature:
    shares = {f"{name[:-2]}_percent": percent_figure(figures[name], span) for name in _FORCES}
    whole = {name: {**figures, **shares}[name] for name in FIELDS}
    sources = {name: MEASURED for name, one in whole.items() if one.value is not None}
    if bench[0].value is not None:
        sources["bench_set_pa"] = MEASURED
    return Signature(whole, bench, sources, span, about)


def _with_lag(found: Signature) -> Signature:
    """Say of the frictions that the I/P's lag is in them, and take their intervals away."""
    lagging = _LAGGING | {f"{name[:-2]}_percent" for name in _FORCES}
    figures = {
        name: replace(one, std_error=None, ci95=None, note=_LAG) if name in lagging and one.value is not None else one
        for name, one in found.figures.items()
    }
    return replace(found, figures=figures)


def _completed(found: Signature, estimates: Sequence[Estimate], nameplate: Nameplate) -> Signature:
    """The signature with spring rate, bench set and friction from the parameters where none was measured."""
    usable = [one for one in estimates if one.status is not Status.FAILED and one.value("k") is not None]
    usable.sort(key=lambda one: one.method != "maximum_likelihood")
    if not usable:
        return found
    chosen = usable[0]
    source = f"the parameters by {chosen.method.replace('_', ' ')}"
    figures, sources, bench = dict(found.figures), dict(found.sources), found.bench_set
    for name, symbol in (("spring_rate_n_per_m", "k"), ("friction_mean_n", "F_c")):
        if figures[name].value is None and chosen.value(symbol) is not None:
            figures[name], sources[name] = chosen.parameters[symbol], source
            if name == "friction_mean_n":
                figures["friction_mean_percent"] = percent_figure(chosen.parameters[symbol], found.span)
                sources["friction_mean_percent"] = source
    area_m2 = nameplate.actuator.diaphragm_area_m2
    preload, spring = chosen.parameters["F_0"], chosen.parameters["k"]
    if bench[0].value is None and area_m2 is not None and preload.value is not None and spring.value:
        full_n = preload.value + spring.value * nameplate.actuator.travel_m
        note = "from F_0 and k of the parameters, without an interval"
        ends = [ParameterEstimate(force_n / area_m2, note=note) for force_n in (preload.value, full_n)]
        bench, sources["bench_set_pa"] = (ends[0], ends[1]), source
    return replace(found, figures=figures, sources=sources, bench_set=bench)
