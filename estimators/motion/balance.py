"""The force balance of uniform motion: what either method knows before it turns to the transients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from estimators.base import Form
from estimators.motion.uniform_motion import UniformMotion
from valve.nameplate import Action

# Moving parts of control valves weigh some kg; the heaviest that is thought of where the nameplate says nothing.
_HEAVIEST_KG: Final = 100.0
_NAMEPLATE_MASS: Final = 1.25  # how far the nameplate's mass may be exceeded


@dataclass(frozen=True, slots=True)
class Balance:
    """k (N/m), A = F_c + F_v v (N) at the speed v (m/s), and F_0 (N), each with its standard error.

    ``preload`` is None where the method assumes none, or where one direction leaves it tied to A.
    """

    spring: tuple[float, float]
    friction: tuple[float, float]
    preload: tuple[float, float] | None
    speed: float
    one_direction: bool
    form: Form
    action: Action

    @property
    def is_physical(self) -> bool:
        """Whether friction and, where there is one, the spring are above 0."""
        return self.friction[0] > 0.0 and (self.spring[0] > 0.0 or self.action is Action.DOUBLE)

    @classmethod
    def of(cls, uniform: UniformMotion, form: Form, action: Action) -> Balance:
        """The balance that uniform motion gives."""
        error = uniform.std_error
        return cls(
            spring=(uniform.spring_n_per_m, float(error[0])),
            friction=(uniform.friction_n, float(error[1])),
            preload=None if uniform.preload_n is None else (uniform.preload_n, float(error[2])),
            speed=uniform.reference_speed,
            one_direction=len(uniform.directions) < 2,
            form=form,
            action=action,
        )


def viscous_bounds(balance: Balance) -> tuple[float, float]:
    """What F_v may be where nothing shows it, N s/m: F_c is not negative, so it lies between 0 and A/v."""
    if balance.speed <= 0.0:
        return 0.0, 0.0  # no ramp: F_v has no part in A
    most = balance.friction[0] / balance.speed
    return 0.5 * most, most / math.sqrt(12.0)


def heaviest_mass_kg(moving_mass_kg: float | None) -> float:
    """Mass that the moving parts surely do not exceed, kg, by the nameplate's where it says one."""
    return _HEAVIEST_KG if moving_mass_kg is None else _NAMEPLATE_MASS * moving_mass_kg
