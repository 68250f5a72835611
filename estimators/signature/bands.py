"""Dead band, stick band S and slip jump J from the breakaways and the reversals."""

from __future__ import annotations

from typing import Final

from estimators.base import Outcome, ParameterEstimate, absent
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.static_friction import breakaway_forces
from estimators.signature.figures import Parts, figure, percent_figure
from estimators.signature.reversals import dead_band, reversals, softness_n
from estimators.signature.scatter import Measured, combined
from estimators.signature.span import Span
from valve.messages import joined, say

_NO_REVERSAL: Final = say(
    "no_reversal", "no reversal of a moving stem was seen on a ramp: repeat with ramps up and down"
)
_SCATTER: Final = say("breakaways_badly_timed", "the breakaways scatter, or start too softly to be timed")
_NO_JUMP: Final = say("no_jump", "no jump: the stem breaks away at less than its friction in motion")
_JUMP_IN_ERROR: Final = say("jump_in_error", "no jump beyond its error")
_BADLY_KNOWN: Final = say("instants_badly_known", "the instants of breakaway are known too badly")
_SMALL_JUMP: Final = 1.0e-3  # own choice, of the span: a jump known so well is told even if it may be none
_LIMIT: Final = 0.3  # of a value, as the half width that ``figure`` allows


def bands(motion: RecordedMotion, friction: Measured, line: tuple[float, float], span: Span | None) -> Parts:
    """Dead band from the reversals; S = F_b + F and J = F_b - F from the friction at breakaway F_b and in motion F.

    Two-parameter model of Choudhury, Thornhill and Shah (2005) with S = f_s + f_d, J = f_s - f_d (He, Wang, Pottmann
    and Qin 2007). For Karnopp's valve F_b is F_s, with what the force gains while the stem creeps up to DV, and F is
    F_c + F_v v at this speed. ``line`` is spring rate and preload, N/m and N.
    """
    figures: Parts = {"dead_band_percent": dead_band_figure(motion, span)}
    forces = breakaway_forces(motion.samples, motion.phases, *line)
    if forces is None:
        none = absent(Outcome.NO_BREAKAWAY.message)
        return figures | {"stick_band_percent": none, "slip_jump_percent": none}
    breakaway = Measured(forces.value, max(forces.std_error, softness_n(motion.samples, motion.phases)))
    band = combined(breakaway.value + friction.value, (breakaway, 1.0), (friction, 1.0))
    jump = combined(breakaway.value - friction.value, (breakaway, 1.0), (friction, 1.0))
    return figures | stiction(band, jump, span)


def stiction(band: Measured, jump: Measured, span: Span | None) -> Parts:
    """S and J in percent of span; a J that is not known to 30 % of itself or 0.1 % of span is absent."""
    small_n = 0.0 if span is None else _SMALL_JUMP * span.force_n
    unseen: str = ""
    if jump.value < -jump.half_width:
        unseen = _NO_JUMP
    elif jump.value <= jump.half_width:
        unseen = _JUMP_IN_ERROR
    known = figure(jump, scale=small_n / _LIMIT, note=unseen)
    if known.value is None:
        reasons = [unseen, _SCATTER] if unseen else [_SCATTER]
        if span is not None:
            most = max(0.0, jump.value + jump.half_width) / span.force_n
            reasons.insert(0, say("at_most_of_span", "at most {share:.2g %} of span", share=most))
        known = absent(joined("; ", reasons))
    return {
        "stick_band_percent": percent_figure(figure(band, reason=_SCATTER), span),
        "slip_jump_percent": percent_figure(known, span),
    }


def dead_band_figure(motion: RecordedMotion, span: Span | None) -> ParameterEstimate:
    """Dead band in percent of span."""
    samples, phases = motion.samples, motion.phases
    found = dead_band(reversals(samples, phases, motion.stops), softness_n(samples, phases))
    if found is None:
        return absent(_NO_REVERSAL)
    return percent_figure(figure(found, reason=_BADLY_KNOWN), span)
