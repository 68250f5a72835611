"""The catalogue: one file a cause, one line here."""

from __future__ import annotations

from typing import Final

from discrepancy.rough.causes.actuator_leak import ActuatorLeak
from discrepancy.rough.causes.base import Cause
from discrepancy.rough.causes.breakaway_scatter import BreakawayScatter
from discrepancy.rough.causes.diaphragm_area_change import DiaphragmAreaChange
from discrepancy.rough.causes.dual_rate_spring import DualRateSpring
from discrepancy.rough.causes.dwell_dependent_breakaway import DwellDependentBreakaway
from discrepancy.rough.causes.flow_force import FlowForce
from discrepancy.rough.causes.friction_asymmetry import FrictionAsymmetry
from discrepancy.rough.causes.friction_drift import FrictionDrift
from discrepancy.rough.causes.friction_gradient import FrictionGradient
from discrepancy.rough.causes.local_friction import LocalFriction
from discrepancy.rough.causes.position_backlash import PositionBacklash
from discrepancy.rough.causes.position_lag import PositionLag
from discrepancy.rough.causes.position_nonlinearity import PositionNonlinearity
from discrepancy.rough.causes.positioner_dead_band import PositionerDeadBand
from discrepancy.rough.causes.presliding import Presliding
from discrepancy.rough.causes.pressure_dependent_friction import PressureDependentFriction
from discrepancy.rough.causes.seat_friction import SeatFriction
from discrepancy.rough.causes.seen import InputCause, SeenCause
from discrepancy.rough.causes.spring_hardening import SpringHardening
from discrepancy.rough.causes.spring_preload import SpringPreload
from discrepancy.rough.causes.stribeck_friction import SticksAgain, StribeckFriction
from discrepancy.rough.causes.supply_saturation import SupplySaturation
from discrepancy.rough.causes.transducer_delay import TransducerDeadTime, TransducerLag
from discrepancy.rough.causes.transducer_hysteresis import TransducerHysteresis
from discrepancy.rough.causes.travel_stop import TravelStopHigh, TravelStopLow
from discrepancy.rough.causes.vibration import Vibration

CAUSES: Final[tuple[type[Cause], ...]] = (
    FrictionAsymmetry,
    StribeckFriction,
    LocalFriction,
    SeatFriction,
    FrictionGradient,
    FrictionDrift,
    PressureDependentFriction,
    DwellDependentBreakaway,
    SpringPreload,
    SpringHardening,
    DualRateSpring,
    DiaphragmAreaChange,
    FlowForce,
    PositionNonlinearity,
    PositionBacklash,
)

# Causes that command and pressure show, whatever the stem does.
INPUT_CAUSES: Final[tuple[InputCause, ...]] = (
    SupplySaturation(),
    ActuatorLeak(),
    PositionerDeadBand(),
    TransducerHysteresis(),
    TransducerLag(),
    TransducerDeadTime(),
)

# Causes that are looked for first: beside them the forces of a stem tell nothing else.
HIDING_CAUSES: Final[tuple[SeenCause, ...]] = (Vibration(),)

# Causes that the recording shows without a fit.
SEEN_CAUSES: Final[tuple[SeenCause, ...]] = (
    TravelStopLow(),
    TravelStopHigh(),
    Presliding(),
    *INPUT_CAUSES,
    PositionLag(),
    SticksAgain(),
    BreakawayScatter(),
)
