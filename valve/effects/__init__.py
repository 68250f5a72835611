"""The effects that a valve can have beside the Karnopp model, by the name of their cause.

One file an effect and one line in EFFECTS: the contract tests then check it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Final

from valve.effects.actuator_leak import ActuatorLeak
from valve.effects.base import Effect, EffectParameter, Per, ValveScale
from valve.effects.diaphragm_area_change import DiaphragmAreaChange
from valve.effects.dual_rate_spring import DualRateSpring
from valve.effects.dwell_dependent_breakaway import DwellDependentBreakaway
from valve.effects.flow_force import FlowForce
from valve.effects.friction_asymmetry import FrictionAsymmetry
from valve.effects.friction_drift import FrictionDrift
from valve.effects.friction_gradient import FrictionGradient
from valve.effects.local_friction import LocalFriction
from valve.effects.position_backlash import PositionBacklash
from valve.effects.position_gain import PositionGain
from valve.effects.position_lag import PositionLag
from valve.effects.position_nonlinearity import PositionNonlinearity
from valve.effects.presliding import Presliding
from valve.effects.pressure_dependent_friction import PressureDependentFriction
from valve.effects.spring_hardening import SpringHardening
from valve.effects.spring_preload import SpringPreload
from valve.effects.stribeck_friction import StribeckFriction
from valve.effects.supply_saturation import SupplySaturation
from valve.effects.transducer_dead_time import TransducerDeadTime
from valve.effects.transducer_lag import TransducerLag
from valve.effects.travel_stop_high import TravelStopHigh
from valve.effects.travel_stop_low import TravelStopLow
from valve.effects.vibration import PeriodicForce
from valve.errors import NotFoundError, ParameterError
from valve.extended_valve import ExtendedValve
from valve.messages import say

EFFECTS: Final[dict[str, type[Effect]]] = {
    entry.cause: entry
    for entry in (
        FrictionAsymmetry,
        StribeckFriction,
        LocalFriction,
        FrictionGradient,
        FrictionDrift,
        PressureDependentFriction,
        DwellDependentBreakaway,
        Presliding,
        SpringPreload,
        SpringHardening,
        DualRateSpring,
        DiaphragmAreaChange,
        TravelStopLow,
        TravelStopHigh,
        FlowForce,
        TransducerLag,
        TransducerDeadTime,
        SupplySaturation,
        ActuatorLeak,
        PositionBacklash,
        PositionGain,
        PositionNonlinearity,
        PositionLag,
        PeriodicForce,
    )
}


def effect_from_values(cause: str, values: Mapping[str, float]) -> Effect:
    """Return the effect of this cause with these parameters.

    Raises NotFoundError for another cause, ParameterError for a name that it has not, one that is missing and a
    value that is not a finite number.
    """
    if cause not in EFFECTS:
        raise NotFoundError(
            say(
                "cause_unknown",
                "cause {cause} is unknown: choose one of {choices:, }",
                cause=repr(cause),
                choices=tuple(EFFECTS),
            )
        )
    kind = EFFECTS[cause]
    known = [entry.name for entry in kind.parameters]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise ParameterError(
            say(
                "effect_parameter_unknown",
                "{cause}: {parameter}: no such parameter; there are {known:, }",
                cause=cause,
                parameter=unknown[0],
                known=tuple(known),
            )
        )
    try:
        return kind(**values)
    except TypeError:
        needed = {entry.name for entry in fields(kind) if entry.default is MISSING}
        missing = [name for name in known if name in needed - set(values)]
        raise ParameterError(
            say(
                "effect_parameter_missing",
                "{cause}: {missing:, }: missing, or given by a strength: add it",
                cause=cause,
                missing=tuple(missing),
            )
        ) from None


def with_effects(valve: ExtendedValve, effects: Sequence[Effect]) -> ExtendedValve:
    """Return the valve with all these effects in it. Raises ParameterError where two fill the same slot."""
    for effect in effects:
        valve = effect.apply(valve)
    return valve


__all__ = [
    "EFFECTS",
    "Effect",
    "EffectParameter",
    "Per",
    "ValveScale",
    "effect_from_values",
    "with_effects",
]
