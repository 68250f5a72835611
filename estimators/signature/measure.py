"""The signature of one recording, measured on its branches, reversals and breakaways."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.base import Estimate, Outcome, ParameterEstimate, Status
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import Samples, prepare
from estimators.signature.figures import FORCES, Signature, nothing, percent_figure
from estimators.signature.loop import dead_band_alone, with_branches
from estimators.signature.passes import passes_by_rate, start_line
from estimators.signature.slips import find_slips, fit_slips
from estimators.signature.span import span_of
from estimators.signature.stairs import stick_slip_signature
from estimators.steps.inputs import find_steps
from valve.messages import say
from valve.nameplate import Action, Nameplate
from valve.recording import Recording

_LAG: Final = say(
    "lag_in_signature",
    "the pressure was not measured: the I/P's lag times the ramp's rate is in it, and no interval holds that",
)
_FROM_PARAMETERS: Final = say("bench_set_from_parameters", "from F_0 and k of the parameters, without an interval")
_ONE_WAY: Final = say(
    "steady_one_way",
    "steady motion was seen in one direction only, the way back is too short: "
    "repeat with a larger amplitude, or faster sampling",
)
_STEPS: Final = say("input_in_steps", "the input goes in steps, and this needs ramps up and down: see the step test")
_FEWEST_STEPS: Final = 3
_UNFOLLOWED: Final = say(
    "stem_not_followed",
    "the stem moves from sample to sample by more than can be told from noise: sample faster, or test with slow ramps",
)
_SURELY_MOVED: Final = 0.05  # of rated travel
_LAGGING: Final = {*FORCES, "dead_band_percent", "hysteresis_percent", "stick_band_percent"}


def measure_signature(
    recording: Recording,
    nameplate: Nameplate,
    estimates: Sequence[Estimate] = (),
    motion: RecordedMotion | Outcome | None = None,
) -> Signature:
    """Return the signature of a recording; what it cannot give is absent with the reason.

    Spring rate, bench set and friction that cannot be measured directly come from the ``estimates`` where these
    have them (maximum likelihood first); ``sources`` says which. ``motion`` is what ``read_motion`` returned, if it is
    there already. Raises nothing for an odd recording.
    """
    with np.errstate(all="ignore"):
        motion = read_motion(recording, nameplate) if motion is None else motion
        samples = prepare(recording, nameplate) if isinstance(motion, Outcome) else motion.samples
        found = nothing(samples.message) if isinstance(samples, Outcome) else _measured(samples, motion, nameplate)
    if recording.force_n is None and recording.pressure_pa is None:
        found = _with_lag(found)
    return _completed(found, estimates, nameplate)


def _measured(samples: Samples, motion: RecordedMotion | Outcome, nameplate: Nameplate) -> Signature:
    spring = nameplate.actuator.action is not Action.DOUBLE
    if len(find_steps(samples.time_s, samples.force_n, samples.run_first)) >= _FEWEST_STEPS and _no_ramp(motion):
        return nothing(_STEPS, span=span_of(nameplate, None))
    if spring and (isinstance(motion, Outcome) or motion.uniform is None):
        slips = find_slips(samples)
        lines = None if slips is None else fit_slips(samples, slips)
        if lines is not None:
            return stick_slip_signature(lines, nameplate)
    if isinstance(motion, Outcome):
        swept_m = float(np.ptp(samples.position_m))
        unfollowed = motion is Outcome.NEVER_MOVED and swept_m > _SURELY_MOVED * nameplate.actuator.travel_m
        return nothing(_UNFOLLOWED if unfollowed else motion.message, span=span_of(nameplate, None))
    if motion.one_direction:
        return nothing(motion.one_way_outcome.message, span=span_of(nameplate, None))
    line = start_line(motion)
    if line is None:
        uneven = (motion.uniform_outcome or Outcome.NO_UNIFORM_MOTION).message
        reason = _ONE_WAY if motion.uniform is not None else uneven
        return dead_band_alone(motion, nameplate, reason)
    return with_branches(motion, line, nameplate)


def _no_ramp(motion: RecordedMotion | Outcome) -> bool:
    """Whether no pass went along a ramp in settled motion."""
    if isinstance(motion, Outcome) or motion.one_direction:
        return True
    line = start_line(motion)
    return line is None or not passes_by_rate(motion, line)


def _with_lag(found: Signature) -> Signature:
    """Say of the frictions that the I/P's lag is in them, and take their intervals away."""
    lagging = _LAGGING | {f"{name[:-2]}_percent" for name in FORCES}
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
    source = say("parameters_by", "the parameters by {method}", method=chosen.method.replace("_", " "))
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
        ends = [ParameterEstimate(force_n / area_m2, note=_FROM_PARAMETERS) for force_n in (preload.value, full_n)]
        bench, sources["bench_set_pa"] = (ends[0], ends[1]), source
    return replace(found, figures=figures, sources=sources, bench_set=bench)
