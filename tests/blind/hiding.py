"""What physics hides: by how much the true valve explains a recording better than the best plain one does."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from discrepancy.baseline import fit_baseline
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.line_errors import with_line_errors
from discrepancy.observed import Observed, observe
from discrepancy.refining import refined
from discrepancy.registry import CAUSES
from discrepancy.running_on import followed_freely
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import gain
from discrepancy.sills import over_sills
from estimators.exact_motion import ExactMotionEstimator
from tests.blind.cases import BlindCase

_STEPS: Final = 15
_MORE_STEPS: Final = 30
# What the recording adds to the valve: the position channel's zero moves F_0, and the rest is its start.
_OF_THE_RECORDING: Final = frozenset({"F_0", "x_0", "delay_s", "F_c", "k"})


def seen_by(case: BlindCase) -> float | None:
    """Return the fall of the cost from the best plain valve to the true one, each led to its lowest; None if unread.

    The true one begins at the true values, so that no search decides it. Below 16 (four standard deviations) a cause
    is barely told apart from a plain valve by anybody, whoever looks.
    """
    observed = observe(case.recordings, case.nameplate)
    exact = ExactMotionEstimator().estimate(case.recordings[0], case.nameplate)
    plain = fit_baseline(observed, exact) if isinstance(observed, Observed) else None
    if plain is None:
        return None
    plain = over_sills(refined(with_line_errors(plain)), most_steps=_MORE_STEPS)
    lowest = over_sills(_true_fit(case, plain), most_steps=_MORE_STEPS)
    # measured rests are wrong by their own noise: of both what costs less, with them or without
    plain, lowest = (min(one, followed_freely(one), key=lambda fit: fit.cost) for one in (plain, lowest))
    return gain(plain, lowest) if lowest.is_followed else None


def _true_fit(case: BlindCase, plain: Fit) -> Fit:
    """Return the true model from the true values, its recording's own unknowns found."""
    own, setting, model = case.truth.parameters, setting_of(plain), plain.model
    values = dict(plain.values) | {
        "m": own.mass_kg,
        "k": own.spring_rate_n_per_m,
        "F_v": own.viscous_friction_n_s_per_m,
        "F_c": own.coulomb_friction_n,
        "d": own.static_friction_n / own.coulomb_friction_n - 1.0,
        "DV": own.limit_velocity_m_per_s,
        "F_0": own.preload_n,
        "first_rise": case.truth.friction.first_rise_n,
    }
    for hidden in case.hidden:
        cause = CAUSES[hidden.cause]
        model = extended_model(model, cause, setting)
        values |= cause.full(hidden.parameters)
    model = replace(model, held={name: values.get(name, value) for name, value in model.held.items()})
    start = start_fit(model, model.unknowns.point(values))
    return descend(start, most_steps=_STEPS, held=frozenset(model.unknowns.names) - _OF_THE_RECORDING)
