"""What each sequence would tell of a valve, before it is run: expected intervals, ties, time and rates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from drivers.addresses import Mode
from drivers.waveform_check import check_waveform
from estimators.base import LARGEST_RELATIVE_HALF_WIDTH, NORMAL_95
from estimators.identifiability.bound import Knowledge
from estimators.motion.channels import ONE_INSTANT
from estimators.planned_scatter import packing_half_widths
from estimators.planned_test import HALF_A_PERIOD, PlannedTest, planned_knowledge
from service.config.plant import PlantValve
from service.model.sequences import build_waveform, default_of
from service.planning.expected_valve import ExpectedValve
from valve.errors import InternalError, WaveformError
from valve.messages import message_of, say
from valve.nameplate import Nameplate
from valve.parameters import PARAMETER_SYMBOLS, TravelStops, ValveParameters
from valve.waveform import Waveform

SCHEMA: Final = "breakaway/plan/1"
_HIDDEN_BY_SCATTER: Final = say("hidden_by_scatter", "friction that varies hides it, whatever the sensor")
_STOP_MARGIN: Final = 0.01  # of the travel, beyond its ends: seats and stops give a little


@dataclass(frozen=True, slots=True, eq=False)
class SequencePlan:
    """One sequence on one valve: its waveform and what it tells, or (``problem``) why it cannot be run or planned.

    ``knowledge`` is what sensor and sampling allow; ``packing`` is half of the 95 % interval that the friction's own
    scatter leaves besides, SI, by symbol.
    """

    sequence: str
    waveform: Waveform | None
    knowledge: Knowledge | None
    problem: str = ""
    packing: Mapping[str, float] = field(default_factory=dict)

    def half_width(self, symbol: str) -> float:
        """Return half of the 95 % interval to be expected, SI; infinite where nothing is known."""
        known = self.knowledge
        return math.inf if known is None else math.hypot(NORMAL_95 * known.std_error(symbol), self.packing[symbol])

    def relative(self, symbol: str) -> float:
        """Return this half width as a share of the value, of F_0 as a share of F_c where that is larger."""
        known = self.knowledge
        if known is None:
            return math.inf
        size = abs(known.value(symbol))
        size = max(size, abs(known.value("F_c"))) if symbol == "F_0" else size
        return self.half_width(symbol) / size if size > 0.0 else math.inf

    @property
    def identifiable(self) -> tuple[str, ...]:
        """The valve's parameters that the test would give within +-30 %."""
        return tuple(symbol for symbol in PARAMETER_SYMBOLS if self.relative(symbol) <= LARGEST_RELATIVE_HALF_WIDTH)

    @property
    def score(self) -> tuple[int, float]:
        """Number of parameters that it tells, then how narrowly for its time: the greater, the more.

        An interval falls with the root of the time spent, so a longer test must do better than that.
        """
        if self.knowledge is None or self.waveform is None:
            return -1, 0.0
        root_s = math.sqrt(self.waveform.duration_s)
        widths = [min(max(self.relative(symbol), 1.0e-9), 1.0e3) for symbol in PARAMETER_SYMBOLS]
        return len(self.identifiable), -sum(math.log(width * root_s) for width in widths)


def plan_sequence(valve: PlantValve, expected: ExpectedValve, name: str, overrides: Mapping[str, Any]) -> SequencePlan:
    """Return what this sequence tells. Raises RequestError for an unknown sequence or override."""
    limits, actuator = valve.wiring.limits, valve.nameplate.actuator
    waveform: Waveform | None = None
    try:
        waveform = build_waveform(name, overrides, valve.nameplate, limits)
        check_waveform(valve.nameplate.tag, waveform, limits)
        assert actuator.diaphragm_area_m2 is not None, "an expected valve has one"
        margin_m = _STOP_MARGIN * actuator.travel_m
        test = PlannedTest(
            waveform,
            actuator.diaphragm_area_m2,
            expected.sample_period_s,
            expected.noise_m,
            expected.lag_s,
            expected.pressure_measured,
            TravelStops(-margin_m, actuator.travel_m + margin_m),
            ONE_INSTANT if valve.wiring.acquisition.mode is Mode.CAPTURED else HALF_A_PERIOD,
        )
        start_m = _rest_m(expected.parameters, valve.nameplate, float(waveform.pressure_pa[0]))
        known = planned_knowledge(expected.parameters, test, start_m=start_m)
        packing = packing_half_widths(expected.parameters, waveform, actuator, expected.scatter, start_m=start_m)
        return SequencePlan(name, waveform, known, packing=packing)
    except WaveformError as error:
        return SequencePlan(name, waveform, None, message_of(error))
    except InternalError as error:  # a motion that cannot be followed, such as creep in micro-steps
        return SequencePlan(
            name,
            waveform,
            None,
            say(
                "cannot_be_planned",
                "{tag}: {sequence} cannot be planned: {why}",
                tag=valve.nameplate.tag,
                sequence=name,
                why=message_of(error),
            ),
        )


def _rest_m(parameters: ValveParameters, nameplate: Nameplate, pressure_pa: float) -> float:
    """Where the stem rests when it has come down to this pressure, m."""
    area_m2 = nameplate.actuator.diaphragm_area_m2 or 0.0
    balance_n = area_m2 * pressure_pa - parameters.preload_n + parameters.coulomb_friction_n
    return min(max(balance_n / parameters.spring_rate_n_per_m, 0.0), nameplate.actuator.travel_m)


def plan_document(valve: PlantValve, expected: ExpectedValve, plans: list[SequencePlan]) -> dict[str, Any]:
    """Return the plans as one JSON object."""
    default, reason = default_of(valve.nameplate, valve.wiring.limits)
    return {
        "schema": SCHEMA,
        "valve": valve.nameplate.tag,
        "parameters": {
            "values": expected.parameters.by_symbol(),
            "assumed": list(expected.assumed),
            "source": expected.parameters_from,
        },
        "friction_scatter": {
            "breakaway": expected.scatter.breakaway,
            "roughness": expected.scatter.roughness,
            "wander": expected.scatter.wander,
            "source": expected.scatter.source,
        },
        "sampling": {
            "mode": valve.wiring.acquisition.mode.value,
            "sample_period_s": expected.sample_period_s,
            "sample_period_source": expected.sample_period_from,
            "position_noise_m": expected.noise_m,
            "position_noise_source": expected.noise_from,
            "pressure_measured": expected.pressure_measured,
            "transducer_lag_s": expected.lag_s,
        },
        "default_sequence": default,
        "default_sequence_reason": reason,
        "best_sequence": max(plans, key=lambda plan: plan.score).sequence if any(p.knowledge for p in plans) else None,
        "sequences": [_sequence_document(valve, plan) for plan in plans],
    }


def _sequence_document(valve: PlantValve, plan: SequencePlan) -> dict[str, Any]:
    waveform, known = plan.waveform, plan.knowledge
    rate = None if waveform is None else waveform.fastest_rate_pa_per_s
    return {
        "sequence": plan.sequence,
        "possible": known is not None,
        "message": plan.problem,
        "duration_s": None if waveform is None else waveform.duration_s,
        # of steps there is none
        "fastest_rate_pa_per_s": rate if rate is not None and math.isfinite(rate) else None,
        "rate_limit_pa_per_s": valve.wiring.limits.pressure_rate_pa_per_s,
        "parameters": None
        if known is None
        else {symbol: _parameter(plan, known, symbol) for symbol in PARAMETER_SYMBOLS},
    }


def _parameter(plan: SequencePlan, known: Knowledge, symbol: str) -> dict[str, Any]:
    half_width, is_told = plan.half_width(symbol), symbol in plan.identifiable
    hides = plan.packing[symbol] > LARGEST_RELATIVE_HALF_WIDTH * abs(known.value(symbol)) and symbol != "F_0"
    tie = None if hides or is_told else known.ties(symbol)
    if not is_told and not hides and known.identifiable(symbol):
        hides = True  # sensor and friction together
    return {
        "value": known.value(symbol),
        "unit": PARAMETER_SYMBOLS[symbol].unit,
        "half_width_95": half_width if math.isfinite(half_width) else None,
        "half_width_percent": 100.0 * plan.relative(symbol) if math.isfinite(plan.relative(symbol)) else None,
        "identifiable": is_told,
        "note": _HIDDEN_BY_SCATTER if hides else "" if is_told else known.note(symbol),
        "tied_to": None if tie is None else list(tie.symbols[1:]),
        "known_instead": None
        if tie is None
        else {
            "combination": tie.combination,
            "meaning": tie.meaning,
            "value": tie.value,
            "half_width_95": math.hypot(NORMAL_95 * tie.std_error, plan.packing["F_c"]),
            "unit": tie.unit,
            "separated_by": tie.separated_by,
        },
    }
