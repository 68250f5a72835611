"""What pages and reports call things: states, NE 107, verdicts, figures and sequences in a technician's words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from service.model.acknowledgement import is_moving, needs_acknowledgement, stem_astray
from service.model.run import Run, RunState
from service.words.sentences import NO_FAULT


@dataclass(frozen=True, slots=True)
class Condition:
    """How a valve stands: the NE 107 letter or a mark of ours, its words, and how early it is listed."""

    code: str
    words: str
    rank: int


ALARM: Final = Condition("alarm", "Safe state not confirmed", 0)
STEM_ASTRAY: Final = Condition("alarm", "Stem not at its safe position", 0)
NE107: Final = {
    "F": Condition("F", "Failure", 1),
    "S": Condition("S", "Out of specification", 3),
    "M": Condition("M", "Maintenance required", 4),
    "C": Condition("C", "Function check", 5),
    "N": Condition("N", "Normal", 8),
}
BAD_END: Final = Condition("bad", "Last test ended badly", 2)
UNDER_TEST: Final = Condition("C", "Function check: under test", 5)
AFTER_TEST: Final = Condition("C", "Function check: its stem may still move", 5)
NOT_ASSESSED: Final = Condition("none", "Not assessed", 6)
NEVER_TESTED: Final = Condition("none", "Never tested", 7)

STATES: Final = {
    RunState.QUEUED: "Waiting for its turn",
    RunState.RUNNING: "Running",
    RunState.ANALYZING: "Analysing",
    RunState.COMPLETED: "Completed",
    RunState.FAILED: "Failed",
    RunState.STOPPED: "Stopped",
    RunState.INTERRUPTED: "Interrupted",
}

VERDICTS: Final = {
    "none": NO_FAULT,
    "named": "Cause found.",
    "likely": "A cause is probable, not proven.",
    "ambiguous": "More than one cause fits.",
    "unexplained": "Something is wrong that no known cause explains.",
    "not_assessed": "Causes were not looked for.",
}

SEQUENCES: Final = {
    "triangle": "Full stroke up and down at one speed. The plain signature.",
    "multi_rate": "Strokes at many speeds. Tells the most in the time; the usual choice.",
    "sine": "Smooth strokes up and down. Checks a model that was found before.",
    "steps": "Small and large steps. Dead band, resolution and speed of response.",
    "dwell": "Strokes with rests. Friction that grows while the valve stands.",
    "small_loops": "A stroke, then small ones about the middle. Lost motion in the linkage.",
    "diagnostic": "Slow and fast strokes, rests and small loops. Tells most causes apart.",
    "separating": "Chosen to tell the causes apart that the last test could not.",
}

#: Figures of the signature: key, what a person calls it, SI unit, what it tells.
FIGURES: Final = (
    ("friction_mean_n", "Friction, mean", "N", "packing: tightened, dried out, or loose"),
    ("friction_max_n", "Friction, highest", "N", "a tight place: bent stem, scored plug, guide"),
    ("friction_min_n", "Friction, lowest", "N", ""),
    ("spring_rate_n_per_m", "Spring rate", "N/m", "a broken or a wrong spring"),
    ("dead_band_percent", "Dead band", "percent", "how far the input turns back before the stem answers"),
    ("hysteresis_percent", "Hysteresis and dead band", "percent", ""),
    ("stick_band_percent", "Stick band", "percent", ""),
    ("slip_jump_percent", "Slip jump", "percent", "how far the stem jumps when it breaks away"),
)


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
