"""What pages and reports call things: states, NE 107, verdicts, figures and sequences in a technician's words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from service.model.acknowledgement import is_moving, needs_acknowledgement, stem_astray
from service.model.run import Run, RunState
from service.words.sentences import NO_FAULT
from valve.messages import Message, say


@dataclass(frozen=True, slots=True)
class Condition:
    """How a valve stands: the NE 107 letter or a mark of ours, its words, and how early it is listed."""

    code: str
    words: str
    rank: int


class Change(StrEnum):
    """What became of a valve, in the order in which it is told."""

    WORSE = "worse"
    NOT_TESTED = "not tested"
    BETTER = "better"
    FIRST = "tested for the first time"
    UNCHANGED = "unchanged"

    @property
    def words(self) -> Message:
        """What a person reads."""
        return _CHANGES[self]


_CHANGES: Final = {
    Change.WORSE: say("change_worse", "worse"),
    Change.NOT_TESTED: say("change_not_tested", "not tested"),
    Change.BETTER: say("change_better", "better"),
    Change.FIRST: say("change_first", "tested for the first time"),
    Change.UNCHANGED: say("change_unchanged", "unchanged"),
}

ALARM: Final = Condition("alarm", say("state_not_confirmed", "Safe state not confirmed"), 0)
STEM_ASTRAY: Final = Condition("alarm", say("state_stem_astray", "Stem not at its safe position"), 0)
NE107: Final = {
    "F": Condition("F", say("state_failure", "Failure"), 1),
    "S": Condition("S", say("state_out_of_specification", "Out of specification"), 3),
    "M": Condition("M", say("state_maintenance", "Maintenance required"), 4),
    "C": Condition("C", say("state_function_check", "Function check"), 5),
    "N": Condition("N", say("state_normal", "Normal"), 8),
}
BAD_END: Final = Condition("bad", say("state_ended_badly", "Last test ended badly"), 2)
UNDER_TEST: Final = Condition("C", say("state_under_test", "Function check: under test"), 5)
AFTER_TEST: Final = Condition("C", say("state_after_test", "Function check: its stem may still move"), 5)
NOT_ASSESSED: Final = Condition("none", say("state_not_assessed", "Not assessed"), 6)
NEVER_TESTED: Final = Condition("none", say("state_never_tested", "Never tested"), 7)

STATES: Final = {
    RunState.QUEUED: say("test_queued", "Waiting for its turn"),
    RunState.RUNNING: say("test_running", "Running"),
    RunState.ANALYZING: say("test_analyzing", "Analysing"),
    RunState.COMPLETED: say("test_completed", "Completed"),
    RunState.FAILED: say("test_ended_failed", "Failed"),
    RunState.STOPPED: say("test_stopped", "Stopped"),
    RunState.INTERRUPTED: say("test_interrupted", "Interrupted"),
}

VERDICTS: Final = {
    "none": NO_FAULT,
    "named": say("cause_found", "Cause found."),
    "likely": say("cause_is_probable", "A cause is probable, not proven."),
    "ambiguous": say("causes_fit", "More than one cause fits."),
    "unexplained": say("unexplained_by_causes", "Something is wrong that no known cause explains."),
    "not_assessed": say("causes_not_looked_for", "Causes were not looked for."),
}

SEQUENCES: Final = {
    "triangle": say("sequence_triangle", "Full stroke up and down at one speed. The plain signature."),
    "multi_rate": say("sequence_multi_rate", "Strokes at many speeds. Tells the most in the time; the usual choice."),
    "sine": say("sequence_sine", "Smooth strokes up and down. Checks a model that was found before."),
    "steps": say("sequence_steps", "Small and large steps. Dead band, resolution and speed of response."),
    "dwell": say("sequence_dwell", "Strokes with rests. Friction that grows while the valve stands."),
    "small_loops": say(
        "sequence_small_loops", "A stroke, then small ones about the middle. Lost motion in the linkage."
    ),
    "diagnostic": say("sequence_diagnostic", "Slow and fast strokes, rests and small loops. Tells most causes apart."),
    "separating": say("sequence_separating", "Chosen to tell the causes apart that the last test could not."),
}

#: Figures of the signature: key, what a person calls it, SI unit, what it tells.
FIGURES: Final = (
    (
        "friction_mean_n",
        say("figure_friction_mean", "Friction, mean"),
        "N",
        say("tells_friction_mean", "packing: tightened, dried out, or loose"),
    ),
    (
        "friction_max_n",
        say("figure_friction_max", "Friction, highest"),
        "N",
        say("tells_friction_max", "a tight place: bent stem, scored plug, guide"),
    ),
    ("friction_min_n", say("figure_friction_min", "Friction, lowest"), "N", ""),
    (
        "spring_rate_n_per_m",
        say("figure_spring_rate", "Spring rate"),
        "N/m",
        say("tells_spring_rate", "a broken or a wrong spring"),
    ),
    (
        "dead_band_percent",
        say("figure_dead_band", "Dead band"),
        "percent",
        say("tells_dead_band", "how far the input turns back before the stem answers"),
    ),
    ("hysteresis_percent", say("figure_hysteresis", "Hysteresis and dead band"), "percent", ""),
    ("stick_band_percent", say("figure_stick_band", "Stick band"), "percent", ""),
    (
        "slip_jump_percent",
        say("figure_slip_jump", "Slip jump"),
        "percent",
        say("tells_slip_jump", "how far the stem jumps when it breaks away"),
    ),
)
#: What facts about a recording are called.
SAMPLES: Final = say("sampling_samples", "Samples")
POSITION_NOISE: Final = say("sampling_noise", "Position noise")


def alarm_condition(run: Run) -> Condition | None:
    """Return how a test left its valve where that is an alarm, also one that was acknowledged; else None."""
    if run.safe_confirmed is False:
        return ALARM
    return STEM_ASTRAY if stem_astray(run) else None


def condition_of(last: Run | None, ne107: str | None, *, is_busy: bool, is_tested: bool) -> Condition:
    """Return how a valve stands, the worst first: a valve that may not be safe, a bad end, NE 107, nothing known.

    ``last`` is its last test, or None where that cannot have ended badly.
    """
    if last is not None and needs_acknowledgement(last):
        return alarm_condition(last) or BAD_END
    if last is not None and is_moving(last):
        return AFTER_TEST
    if is_busy:
        return UNDER_TEST
    if ne107 in NE107:
        return NE107[ne107]
    return NOT_ASSESSED if is_tested else NEVER_TESTED
