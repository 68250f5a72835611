"""The valve of a fit as one that can be simulated, and its stem under the force of a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.evidence import Solved
from estimators.base import Estimate
from estimators.engine.dynamic import Dynamic
from estimators.engine.reading import Reading
from valve.effects.base import Effect
from valve.errors import ParameterError
from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve
from valve.nameplate import Nameplate
from valve.parameters import ValveParameters
from valve.stem import StemState

FloatArray = npt.NDArray[np.float64]

_ROW_S: Final = 0.01
_MASS_KG: Final = 2.0
_LIMIT_M_PER_S: Final = 2.0e-4
_LEAST_DAMPING: Final = 1.0
_RESTED_S: Final = 3600.0  # before a test


def parameters_of(model: Solved, estimate: Estimate | None, nameplate: Nameplate) -> ValveParameters:
    """Return the valve of a fit; mass, damping and limit velocity are the estimate's where it knows them."""

    def known(symbol: str) -> float | None:
        return None if estimate is None else estimate.parameters[symbol].value

    damping = known("F_v") or max(_damping(model, estimate), _LEAST_DAMPING)
    if model.problem.rows.has_spring and model.known("k").value > 0.0:
        # at one speed what is less viscous is more of the dry friction
        model = model.given("lag", damping / model.known("k").value)
    spring = max(model.known("k").value, 0.0)
    coulomb_n = max(model.known("F_c").value, 1.0e-6)
    return ValveParameters(
        known("m") or nameplate.actuator.moving_mass_kg or _MASS_KG,
        spring,
        damping,
        coulomb_n,
        max(model.known("F_s").value, coulomb_n),
        known("DV") or _LIMIT_M_PER_S,
        model.known("F_0").value,
    )


def _damping(model: Solved, estimate: Estimate | None) -> float:
    """F_v by how late the stem follows, which one speed hardly shows, and by its transients: each as well as it knows.

    It is expected above zero: without damping a simulated stem slips in steps where the real one slides.
    """
    spring, lag = model.known("k").value, model.known("lag")
    sources = [(spring * lag.value, spring * lag.std_error)]
    whole = None if estimate is None else estimate.diagnostics.get("dynamic")
    if isinstance(whole, Dynamic) and "F_v" in whole.quantities:
        sources.append((whole.quantities["F_v"].value, whole.quantities["F_v"].std_error))
    values, errors = np.array(sources).T
    weights = np.maximum(errors, _LEAST_DAMPING) ** -2.0
    mean, error = float(weights @ values / weights.sum()), 1.0 / math.sqrt(weights.sum())
    above = math.erfc(-mean / error / math.sqrt(2.0)) / 2.0
    return mean + error * math.exp(-0.5 * (mean / error) ** 2) / math.sqrt(2.0 * math.pi) / max(above, 1.0e-3)


def simulated(valve: ExtendedValve, reading: Reading) -> tuple[FloatArray, FloatArray]:
    """Return instants (s) and the position that the valve shows there (m), under the force of this reading.

    After a gap, as between two recordings, the stem begins where it was measured. There, and at first, it has long been
    at rest.
    """
    step = max(1, round(_ROW_S / reading.samples.period_s))
    stem, times_s, shown_m = ExtendedStem(valve), [], []
    for first in np.unique(reading.samples.run_first).tolist():
        last = int(reading.samples.run_last[first])
        run = slice(first, last + 1, step)
        time_s = reading.time_s[run]
        place = StemState(float(reading.position_m[first : min(first + step, last + 1)].mean()), 0.0)
        start = ExtendedState(place, rest_since_s=float(reading.time_s[0]) - _RESTED_S)
        times_s.append(time_s)
        shown_m.append(stem.motion(start, time_s, reading.path.force_n[run], time_s).sensed_m)
    return np.concatenate(times_s), np.concatenate(shown_m)


def with_effects(parameters: ValveParameters, effects: Sequence[Effect]) -> ExtendedValve:
    """Return the valve with these effects; of two that fill the same place the first stays."""
    valve = ExtendedValve(parameters)
    for effect in effects:
        try:
            valve = effect.apply(valve)
        except ParameterError:
            continue
    return valve
