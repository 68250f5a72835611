"""The paper's vendor valve: Romano & Garcia (2007), Table 1."""

from valve.parameter_sets.base import paper_valve

SET = paper_valve("vendor", viscous_friction_n_s_per_m=612.944, coulomb_friction_n=44.4822, static_friction_n=44.4822)
