"""What a parameter set is, and what the paper's three valves share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from valve.nameplate import Actuator, Nameplate, Signal
from valve.parameters import ValveParameters

PAPER: Final = (
    "R. A. Romano, C. Garcia: Comparison between two friction model parameter estimation methods applied to "
    "control valves, IFAC 2007"
)


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A valve whose parameters somebody published: the values, its nameplate and the source."""

    name: str
    parameters: ValveParameters
    nameplate: Nameplate
    source: str


def paper_valve(
    name: str, viscous_friction_n_s_per_m: float, coulomb_friction_n: float, static_friction_n: float
) -> ParameterSet:
    """One of the paper's valves: section 4 for what they share, Table 1 for their friction."""
    return ParameterSet(
        name=name,
        parameters=ValveParameters(
            mass_kg=1.3608,
            spring_rate_n_per_m=52538.0,
            viscous_friction_n_s_per_m=viscous_friction_n_s_per_m,
            coulomb_friction_n=coulomb_friction_n,
            static_friction_n=static_friction_n,
            limit_velocity_m_per_s=1.524e-4,
        ),
        # 82737 Pa (12 psi) on 0.06452 m2 against 52538 N/m: 0.1016 m (4 inch) of travel
        nameplate=Nameplate(
            tag=name.upper(),
            actuator=Actuator(
                travel_m=0.1016, diaphragm_area_m2=0.06452, moving_mass_kg=1.3608, bench_set_pa=(0.0, 82737.0)
            ),
            signal=Signal(range_ma=(4.0, 20.0), range_pa=(0.0, 82737.0)),
        ),
        source=f"{PAPER}, section 4 and Table 1",
    )
