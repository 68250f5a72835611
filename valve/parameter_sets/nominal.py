"""The paper's nominal valve: Romano & Garcia (2007), Table 1."""

from valve.parameter_sets.base import paper_valve

SET = paper_valve("nominal", viscous_friction_n_s_per_m=612.944, coulomb_friction_n=1423.4, static_friction_n=1708.1)
