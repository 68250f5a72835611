"""The paper's rough valve: Romano & Garcia (2007), Table 1."""

from valve.parameter_sets.base import paper_valve

SET = paper_valve("rough", viscous_friction_n_s_per_m=1225.9, coulomb_friction_n=2241.1, static_friction_n=2668.9)
