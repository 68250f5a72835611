"""A real valve with graphite packing, as identified from measurements by F. G. Marques (thesis, USP 2020)."""

from valve.nameplate import Actuator, Nameplate, Signal
from valve.parameter_sets.base import ParameterSet
from valve.parameters import ValveParameters

SET = ParameterSet(
    name="graphite",
    parameters=ValveParameters(
        mass_kg=1.6,
        spring_rate_n_per_m=206941.0,
        viscous_friction_n_s_per_m=70501.0,
        coulomb_friction_n=665.4,
        static_friction_n=942.4,
        limit_velocity_m_per_s=3.258e-3,
        preload_n=2571.4,
    ),
    # bench set from the a-priori spring: F_init 2619 N at 0 m, 204671 N/m over 28.58 mm, on 0.0445 m2
    nameplate=Nameplate(
        tag="GRAPHITE",
        actuator=Actuator(
            travel_m=0.02858, diaphragm_area_m2=0.0445, moving_mass_kg=1.6, bench_set_pa=(58854.0, 190303.0)
        ),
        signal=Signal(range_ma=(4.0, 20.0), range_pa=(42231.0, 206322.0)),
    ),
    source=(
        "F. G. Marques, thesis, Universidade de Sao Paulo (tde-12022020-100441): Karnopp model identified from "
        "measurements on a valve with graphite packing; I/P time constant 0.933 s"
    ),
)
