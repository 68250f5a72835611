"""What every estimator gives: one estimate, with each parameter's value, interval and honesty."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from typing import Any, Final, Protocol

from scipy.special import stdtrit

from valve.messages import Message, joined, say
from valve.nameplate import Nameplate
from valve.parameters import PARAMETER_SYMBOLS, ValveParameters, parameters_from_symbols
from valve.recording import Recording

_FEWEST_DIGITS: Final = 3
_MOST_DIGITS: Final = 7
NORMAL_95: Final = 1.959964  # two-sided 95 % of the normal distribution
_AS_NORMAL: Final = 1.0e6  # degrees of freedom
# A 95 % interval wider than +-30 % of the value is no knowledge of it (the contract's limit of identifiability).
LARGEST_RELATIVE_HALF_WIDTH: Final = 0.30
# F_s above the friction in motion, as a share: less shows no jump. What creeping valves with a wrong F_c showed.
NO_JUMP: Final = 0.06
_BELOW_STATIC: Final = 0.35  # of F_s: by so much F_c is less at most, in valves like the published ones
# Own choices: the fewest complete rows that can hold a cycle, and that a noise can be told by.
FEWEST_SAMPLES: Final = 40
FEWEST_TOGETHER: Final = 8


def student_95(freedom: float) -> float:
    """Two-sided 95 % of Student's t with that many degrees of freedom, of one where there are fewer."""
    return NORMAL_95 if freedom > _AS_NORMAL else float(stdtrit(max(freedom, 1.0), 0.975))


UNDETERMINED: Final = say("undetermined", "the data do not determine it")
NOT_BETTER: Final = say("not_determined_better", "the data do not determine it better")
NOT_GIVEN: Final = say("method_gives_none", "the method does not give it")
NO_SPRING: Final = say("no_spring", "taken as 0: the nameplate says that no spring opposes the stem")
MOVED_TOO_LITTLE: Final = say("moved_too_little", "the stem moved too little")


class Status(StrEnum):
    """How far an estimate may be trusted as a whole."""

    OK = "ok"  # k, F_c and F_s are given, and every interval that is given is meant to hold
    POOR = "poor"  # one of k, F_c and F_s is missing, or rests on an assumption that the message names
    FAILED = "failed"  # nothing can be told of the friction; the message says why


class Form(StrEnum):
    """Which form of a method is used."""

    PUBLISHED = "published"  # Romano & Garcia (2007), step by step
    CORRECTED = "corrected"  # preload fitted, the bias of backward differences taken out, many points
    ROBUST = "robust"  # the equation of motion integrated over the slips: no differences; corrected without noise


class Outcome(Enum):
    """What a recording can be instead of a source of numbers; each value is a message with the remedy."""

    NEVER_MOVED = say("never_moved", "The stem never moved: repeat with a larger amplitude, or look for a stuck stem.")
    ONE_DIRECTION_ONLY = say(
        "one_direction_only",
        "The stem moved in one direction only, so friction and preload cannot be told apart: "
        "repeat with a full cycle, up and down.",
    )
    HELD_ON_THE_WAY_BACK = say(
        "held_on_the_way_back",
        "The stem moved in one direction only: the force turned back as well, by less than twice the static friction "
        "that held the stem, so that friction and preload cannot be told apart: repeat over a larger range.",
    )
    STOP_INSIDE_SWEEP = say(
        "stop_inside_sweep",
        "The stem ran into a travel stop inside the sweep; what was measured on the stop is left out.",
    )
    TOO_FEW_SAMPLES = say(
        "too_few_samples",
        "The recording has too few complete samples, at least {fewest} are needed and {together} of them without a gap "
        "between: repeat with a longer test or a higher rate.",
        fewest=FEWEST_SAMPLES,
        together=FEWEST_TOGETHER,
    )
    RATE_TOO_LOW = say(
        "rate_too_low", "The sampling rate is too low to follow the stem: sample faster, or capture in the device."
    )
    TRANSIENTS_NOT_RESOLVED = say(
        "transients_not_resolved",
        "The sampling rate is too low to follow the stem from breakaway to steady motion: "
        "capture in the device at 1 ms for m and F_v.",
    )
    NOISE_TOO_HIGH = say(
        "noise_too_high",
        "The noise of the position swamps its differences: "
        "use a quieter position sensor, or an estimator that does without differences.",
    )
    MASS_HIDDEN = say("mass_hidden", "The stem is damped so strongly that its mass does not show in its motion.")
    NO_BREAKAWAY = say(
        "no_breakaway_seen",
        "No breakaway from rest was seen: repeat with a slower sequence that lets the stem come to rest.",
    )
    NO_UNIFORM_MOTION = say(
        "no_uniform_motion",
        "The stem never moved uniformly, it slipped or was forced unevenly: repeat with a triangular wave, faster.",
    )
    TOO_FEW_STEPS = say(
        "too_few_steps",
        "The force moved in steps, and the stem slid to rest after too few of them, both ways, for a balance: "
        "repeat with more steps, or with a triangular wave.",
    )
    PRELOAD_IGNORED = say(
        "preload_ignored",
        "The stem has a preload, and the published form of the methods assumes none: use the corrected form.",
    )
    COMMAND_ONLY = say(
        "command_only",
        "The pressure was not measured and the command stands in for it: the transducer's lag, times the ramp's force "
        "rate, adds to F_c and F_s. Measure the pressure at the actuator.",
    )
    ONE_SPEED = say(
        "one_speed",
        "The drive moved at one speed, so that F_c holds what of the friction grows with speed: "
        "repeat at several speeds.",
    )
    MAY_CREEP = say(
        "may_creep",
        "No slip jump is seen, and a stem that creeps below DV feels F_s alone: F_c rests on its having moved faster "
        "than that. Repeat with faster ramps.",
    )
    OVERSHOOT_ASSUMED = say(
        "overshoot_assumed",
        "The stem only stuck and slipped, and F_c rests on how far a jump may overshoot: repeat with a faster ramp.",
    )
    NO_FORCE_CHANGE = say(
        "no_force_change", "The actuator's force did not change: check the pressure channel and repeat the test."
    )
    ONE_CHAMBER = say(
        "one_chamber",
        "The actuator has no spring and its pressure does not take both signs: give pressure_pa as the difference of "
        'both chambers\' pressures, or force_n (an actuator with a spring has action = "spring").',
    )
    NO_DIAPHRAGM_AREA = say(
        "no_diaphragm_area",
        "The recording has a pressure and the nameplate no diaphragm area: add actuator.diaphragm_area_m2.",
    )
    NOT_EXPLAINED = say(
        "not_explained",
        "The motion of a valve with these values misses what was recorded by more than the noise: "
        "look for what else moves or holds the stem, or let maximum likelihood search further.",
    )
    UNPHYSICAL = say(
        "unphysical",
        "What was fitted is no valve (spring rate or friction below 0): "
        "check the channels' signs and units, the diaphragm area and the action.",
    )
    NOT_COMPUTABLE = say(
        "not_computable",
        "The recording's numbers lead the fit beyond what can be computed: check the channels' units and ranges.",
    )

    @property
    def message(self) -> Message:
        """What it is, with the remedy."""
        return self.value

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One parameter in its SI unit: a value with its interval, or None with the reason in ``note``.

    ``std_error`` holds the known errors, also systematic ones; ``ci95`` may be None where a method has none.
    ``scatter`` is how much the quantity itself varies in the test, as a standard deviation: F_s from breakaway to
    breakaway, F_c along the travel and in time; None where none is seen.
    """

    value: float | None
    std_error: float | None = None
    ci95: tuple[float, float] | None = None
    identifiable: bool = True
    note: str = ""
    scatter: float | None = None

    def __post_init__(self) -> None:
        numbers = [self.value, self.std_error, self.scatter, *(self.ci95 or ())]
        if any(number is not None and not math.isfinite(number) for number in numbers):
            raise ValueError(f"parameter estimate {numbers}: every number must be finite, give None instead")
        if (self.value is not None) != self.identifiable:
            raise ValueError("parameter estimate: a value is given if and only if it is identifiable")
        if self.value is None and not self.note:
            raise ValueError("parameter estimate: a missing value needs a note that says why")

    def to_json(self, unit: str) -> dict[str, Any]:
        """Return the parameter as in the analysis object."""
        return {
            "value": self.value,
            "unit": unit,
            "std_error": self.std_error,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "identifiable": self.identifiable,
            "note": self.note,
            "scatter": self.scatter,
        }


def digits_within(error: float, product: float) -> int:
    """Significant digits of a factor, 3 to 7, that leave less than ``error`` of its ``product`` open, in its unit."""
    if product == 0.0:
        return _FEWEST_DIGITS
    share = error / abs(product)
    needed = -math.log10(share / 5.0) if share > 0.0 else math.inf
    return math.ceil(min(max(_FEWEST_DIGITS, needed), _MOST_DIGITS))


def known_badly(value: float, half_width: float, why: str) -> Message:
    """Return that an interval is wider than the limit, and why."""
    if value == 0.0:
        return say(
            "known_about_zero", "known to +-{half:.3g} about 0 only, the limit is 30 %: {why}", half=half_width, why=why
        )
    return say(
        "known_badly",
        "known to +-{share:.0f %} only, the limit is {limit:.0f %}: {why}",
        share=half_width / abs(value),
        limit=LARGEST_RELATIVE_HALF_WIDTH,
        why=why,
    )


def absent(note: str) -> ParameterEstimate:
    """Return a parameter that the data cannot give, and why."""
    return ParameterEstimate(None, identifiable=False, note=note)


def measured(value: float, std_error: float, *, note: str = "", reason: str = "") -> ParameterEstimate:
    """Return a parameter with its 95 % interval, or its absence where the interval is wider than +-30 %.

    ``reason`` says where the width comes from; ``note`` stays with a value that is given.
    """
    if not (math.isfinite(value) and math.isfinite(std_error)):
        return absent(reason or UNDETERMINED)
    half_width = NORMAL_95 * std_error
    if half_width > LARGEST_RELATIVE_HALF_WIDTH * abs(value):
        return absent(known_badly(value, half_width, reason or NOT_BETTER))
    return ParameterEstimate(value, std_error, (value - half_width, value + half_width), True, note)


def of_creep(parameter: ParameterEstimate) -> ParameterEstimate:
    """Return the F_c of a stem that may creep: what was felt is at most F_s, so F_c may be less by a packing's jump."""
    if parameter.value is None or parameter.ci95 is None:
        return parameter
    low, high = parameter.ci95
    low = min(low, (1.0 - _BELOW_STATIC) * parameter.value)
    half_width = 0.5 * (high - low)
    if half_width > LARGEST_RELATIVE_HALF_WIDTH * parameter.value:
        return absent(known_badly(parameter.value, half_width, Outcome.MAY_CREEP.message))
    return replace(parameter, std_error=half_width / NORMAL_95, ci95=(low, high))


def offset_estimate(value: float, std_error: float, scale: float, *, reason: str = "") -> ParameterEstimate:
    """As ``measured`` for a quantity that may be zero: its interval is judged against ``scale``."""
    if not (math.isfinite(value) and math.isfinite(std_error)):
        return absent(reason or UNDETERMINED)
    half_width = NORMAL_95 * std_error
    if half_width > LARGEST_RELATIVE_HALF_WIDTH * max(abs(value), scale):
        return absent(
            say("known_to_only", "known to +-{half:.3g} only: {why}", half=half_width, why=reason or NOT_BETTER)
        )
    return ParameterEstimate(value, std_error, (value - half_width, value + half_width))


@dataclass(frozen=True, slots=True)
class Estimate:
    """One method's answer to one recording; ``parameters`` has every symbol of PARAMETER_SYMBOLS.

    ``residual_rms_m`` is the root mean square of measured minus simulated position with these parameters (exact
    motion), or None where they do not suffice. ``diagnostics`` holds what a person or a picture may want beside
    that (thresholds, raw values, counts) and is no part of the contract.
    """

    method: str
    status: Status
    message: str
    residual_rms_m: float | None
    parameters: dict[str, ParameterEstimate]
    diagnostics: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if list(self.parameters) != list(PARAMETER_SYMBOLS):
            raise ValueError(f"{self.method}: parameters are {list(self.parameters)}, not {list(PARAMETER_SYMBOLS)}")
        if self.status is not Status.OK and not self.message:
            raise ValueError(f"{self.method}: status {self.status} needs a message")

    def to_json(self) -> dict[str, Any]:
        """Return the estimate as in the analysis object."""
        return {
            "method": self.method,
            "status": str(self.status),
            "message": self.message,
            "residual_rms_m": self.residual_rms_m,
            "parameters": {
                symbol: self.parameters[symbol].to_json(entry.unit) for symbol, entry in PARAMETER_SYMBOLS.items()
            },
        }

    def value(self, symbol: str) -> float | None:
        """Return the value of this parameter, or None."""
        return self.parameters[symbol].value

    def valve_parameters(self, fallback: dict[str, float] | None = None) -> ValveParameters | None:
        """Return all values as a valve; missing ones come from ``fallback`` (by symbol), None where some are left.

        F_s is raised to F_c where the estimates cross within their errors.
        """
        values = {symbol: self.parameters[symbol].value for symbol in PARAMETER_SYMBOLS}
        complete: dict[str, float] = {}
        for symbol, value in values.items():
            given = value if value is not None else (fallback or {}).get(symbol)
            if given is None:
                return None
            complete[symbol] = given
        complete["F_s"] = max(complete["F_s"], complete["F_c"])
        return parameters_from_symbols(complete)


def failed(method: str, outcome: Outcome, diagnostics: dict[str, Any] | None = None) -> Estimate:
    """Return the estimate of a recording that tells nothing, by its outcome."""
    parameters = {symbol: absent(outcome.message) for symbol in PARAMETER_SYMBOLS}
    return Estimate(
        method, Status.FAILED, outcome.message, None, parameters, {"outcomes": [outcome.name], **(diagnostics or {})}
    )


def in_order(parameters: dict[str, ParameterEstimate]) -> dict[str, ParameterEstimate]:
    """Return the parameters in the contract's order; one that is not there is marked as not given by the method."""
    return {symbol: parameters.get(symbol, absent(NOT_GIVEN)) for symbol in PARAMETER_SYMBOLS}


def not_given(missing: Iterable[str]) -> Message:
    """Return which symbols are not given."""
    return say("not_given", "Not given: {symbols:, }.", symbols=tuple(missing))


def sentences(outcomes: Iterable[Outcome]) -> str:
    """Return the outcomes' sentences, each once, in order."""
    return joined(" ", dict.fromkeys(outcome.message for outcome in outcomes))


ONE_WAY: Final = frozenset({Outcome.ONE_DIRECTION_ONLY, Outcome.HELD_ON_THE_WAY_BACK})


class Estimator(Protocol):
    """Anything that turns a recording into an estimate; its settings are frozen fields of the object."""

    @property
    def method(self) -> str:
        """Name in the analysis object."""
        ...

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate. Raises nothing for an odd recording: its status and message say what is wrong."""
        ...
