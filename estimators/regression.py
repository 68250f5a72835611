"""Method 1, linear regression (Ravanbod-Shirazi & Besancon-Voda 2003; Romano & Garcia 2007, section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np

from estimators.balance import Balance, viscous_bounds
from estimators.base import Estimate, Form, Outcome, ParameterEstimate, absent, failed, measured
from estimators.conclusion import conclude
from estimators.differences import backward_differences, noise_covariance
from estimators.friction_parameters import friction_parameters
from estimators.linear_fit import LinearFit, fit_trimmed
from estimators.misfit import Fallback
from estimators.recorded_motion import RecordedMotion, read_motion
from estimators.samples import BoolArray, FloatArray
from estimators.settling import viscous_from_settling
from estimators.simulated_static_friction import static_friction_by_simulation
from estimators.static_friction import BreakawayForces, breakaway_forces, published_breakaway_forces
from estimators.stops import rows_off_stops
from estimators.threshold_sweep import ThresholdSweep, sweep_thresholds
from estimators.transients import Setting, heaviest_mass_kg, judge_transients
from valve.errors import ParameterError
from valve.nameplate import Action, Nameplate
from valve.parameters import parameters_from_symbols
from valve.recording import Recording

_CLOSE_TO_ZERO: Final = 1.0e-3  # of F_c: what Eq. (8) calls close to zero


class StaticFriction(StrEnum):
    """How F_s is found."""

    BREAKAWAY = "breakaway"  # Eq. (2), last line, as the paper does
    SIMULATION = "simulation"  # Eq. (9), with the exact motion


@dataclass(frozen=True, slots=True, eq=False)
class _Regressors:
    """Columns (acceleration, velocity beyond the reference, direction, position, 1), force, and speed to sort by."""

    columns: FloatArray
    names: tuple[str, ...]
    force_n: FloatArray
    speed: FloatArray
    noise: FloatArray
    young: BoolArray

    def without_mass(self) -> _Regressors:
        """Return the regressors without the acceleration."""
        return _Regressors(
            self.columns[:, 1:], self.names[1:], self.force_n, self.speed, self.noise[1:, 1:], self.young
        )

    def sweep(self, steps: int, parts: int) -> ThresholdSweep:
        """Return Eq. (5) for every threshold of Eq. (7)."""
        return sweep_thresholds(self.columns, self.force_n, self.speed, self.noise, steps=steps, parts=parts)

    def fit(self, threshold: float) -> LinearFit | None:
        """Return Eq. (5) for the rows that are faster than ``threshold``."""
        return fit_trimmed(self.columns, self.force_n, self.speed > threshold, self.young, self.noise)


@dataclass(frozen=True, slots=True, eq=False)
class _FirstStep:
    """Eq. (5): the sweep, the thresholds chosen for (m and F_v, the rest), and the fits there."""

    sweep: ThresholdSweep
    chosen: tuple[int, int] | None
    full: LinearFit | None
    massless: LinearFit | None
    rest: LinearFit | None
    names: tuple[str, ...]
    clear: bool


@dataclass(frozen=True, slots=True)
class RegressionEstimator:
    """Method 1 in its three steps: F = m a + F_v v + F_c sgn v + k x by least squares above a threshold of speed.

    ``thresholds`` is S and ``parts`` Z of Eq. (7). ``threshold`` fixes s; without it the threshold is the one with
    the least expected error (scatter and noise bias), for the corrected form one for m and F_v and one for the rest.
    That cannot fall into a plateau of wrong values, as looking for constancy does at s = 2 to 3.
    ``preload`` adds a constant to Eq. (4): by default in the corrected form only.
    """

    form: Form = Form.CORRECTED
    thresholds: int = 1200
    parts: int = 1500
    threshold: int | None = None
    preload: bool | None = None
    static_friction: StaticFriction = StaticFriction.BREAKAWAY
    method: str = "regression"

    def __post_init__(self) -> None:
        if not 1 <= self.thresholds <= self.parts:
            raise ParameterError(
                f"regression: thresholds is {self.thresholds}, it must lie between 1 and parts ({self.parts}): "
                "correct it"
            )
        if self.threshold is not None and not 1 <= self.threshold <= self.thresholds:
            raise ParameterError(
                f"regression: threshold is {self.threshold}, it must lie between 1 and {self.thresholds}: correct it"
            )

    @property
    def _fits_preload(self) -> bool:
        return self.form is not Form.PUBLISHED if self.preload is None else self.preload

    def estimate(self, recording: Recording, nameplate: Nameplate) -> Estimate:
        """Return the estimate; odd recordings give a named outcome."""
        return self.estimate_motion(read_motion(recording, nameplate))

    def estimate_motion(self, motion: RecordedMotion | Outcome) -> Estimate:
        """Return the estimate from what ``read_motion`` returned."""
        if isinstance(motion, Outcome):
            return failed(self.method, motion)
        with np.errstate(all="ignore"):
            return self._estimate(motion)

    def _estimate(self, motion: RecordedMotion) -> Estimate:
        regressors = self._regressors(motion)
        first = self._first_step(regressors, heaviest_mass_kg(motion.moving_mass_kg))
        balance = self._balance(motion, first)
        if balance is None:
            return failed(self.method, motion.uniform_outcome or Outcome.NO_UNIFORM_MOTION)
        raw = _raw_values(balance, first)
        if (balance.spring[0] <= 0.0 and motion.action is Action.SPRING) or balance.friction[0] <= 0.0:
            return failed(self.method, Outcome.UNPHYSICAL, {"raw": raw})
        bounds = viscous_from_settling(motion.samples, motion.phases, balance) or viscous_bounds(balance)
        setting = Setting.of(motion, balance, bounds)
        transients = judge_transients(first.full, first.massless, None, setting)
        forces = self._breakaways(motion, balance)
        if forces is not None:
            raw["F_s"] = forces.value
        parameters, outcomes = friction_parameters(balance, transients, forces)
        parameters |= {"m": transients.mass, "F_v": transients.viscous}
        note, eq8 = _limit_velocity(first.sweep, raw, balance.speed)
        parameters["DV"] = absent(note)
        fallback = Fallback.of(motion, transients, balance)
        if self.static_friction is StaticFriction.SIMULATION:
            parameters["F_s"] = _by_simulation(motion, parameters, fallback)
        diagnostics: dict[str, Any] = {
            "form": str(self.form),
            "raw": raw,
            "thresholds": first.chosen,
            "threshold_step_m_per_s": first.sweep.step_m_per_s,
            "eq8": eq8,
        }
        return conclude(
            self.method,
            motion,
            parameters=parameters,
            outcomes=outcomes,
            transients=transients,
            diagnostics=diagnostics,
            fallback=fallback,
        )

    def _first_step(self, regressors: _Regressors, heaviest_kg: float) -> _FirstStep:
        """Eq. (5) at the chosen thresholds: with the mass, and without it where that shows m or F_v badly."""
        sweep = regressors.sweep(self.thresholds, self.parts)
        chosen = self._chosen(sweep, regressors.names)
        full = rest = massless = None
        names = regressors.names
        if chosen is not None:
            full = regressors.fit(chosen[0] * sweep.step_m_per_s)
            rest = full if chosen[0] == chosen[1] else regressors.fit(chosen[1] * sweep.step_m_per_s)
        clear = full is not None and _is_clear(full) and float(full.coefficients[0]) < heaviest_kg
        if not clear:
            light = regressors.without_mass()
            light_sweep = light.sweep(self.thresholds, self.parts)
            light_chosen = self._chosen(light_sweep, light.names)
            if light_chosen is not None:
                massless = light.fit(light_chosen[0] * light_sweep.step_m_per_s)
                if rest is None:
                    names, rest = light.names, light.fit(light_chosen[1] * light_sweep.step_m_per_s)
        return _FirstStep(sweep, chosen, full, massless, rest, names, clear)

    def _balance(self, motion: RecordedMotion, first: _FirstStep) -> Balance | None:
        """k, A and F_0: from the regression, or from settled rows alone where hidden transients would pull at k."""
        if self.form is not Form.PUBLISHED and not first.clear and motion.uniform is not None:
            return Balance.of(motion.uniform, self.form, motion.action)
        if first.rest is None:
            return None
        values = dict(zip(first.names, zip(first.rest.coefficients, first.rest.std_error, strict=True), strict=True))
        pairs = {name: (float(value), float(error)) for name, (value, error) in values.items()}
        return Balance(
            spring=pairs.get("k", (0.0, 0.0)),
            friction=pairs["A"],
            preload=pairs.get("F_0"),
            speed=motion.phases.moving_speed,
            one_direction=motion.one_direction,
            form=self.form,
            action=motion.action,
        )

    def _regressors(self, motion: RecordedMotion) -> _Regressors:
        samples, phases = motion.samples, motion.phases
        velocity, acceleration = backward_differences(samples)
        usable = np.isfinite(acceleration) & rows_off_stops(samples, motion.stops)
        if self.form is Form.PUBLISHED:
            speed = np.where(usable, np.abs(velocity), 0.0)
            sense = np.sign(np.where(usable, velocity, 0.0))
        else:
            usable &= phases.differenced_rows(samples.count)
            speed = np.where(usable, np.abs(phases.velocity), 0.0)
            sense = np.sign(phases.velocity)
        velocity, acceleration = np.where(usable, velocity, 0.0), np.where(usable, acceleration, 0.0)
        columns = [acceleration, velocity - phases.moving_speed * sense, sense]
        names = ["m", "F_v", "A"]
        if motion.action is Action.SPRING:
            columns.append(samples.position_m)
            names.append("k")
        moved_both_ways = len(np.unique(sense[speed > 0.0])) == 2
        if self._fits_preload and moved_both_ways and not motion.one_direction:
            columns.append(np.ones(samples.count))
            names.append("F_0")
        noise = np.zeros((len(names), len(names)))
        known = noise_covariance(samples.position_noise_m, samples.period_s)
        places = [names.index(name) for name in ("m", "F_v", "k") if name in names]
        noise[np.ix_(places, places)] = known[: len(places), : len(places)]
        young = np.zeros(samples.count, dtype=np.bool_)
        if self.form is not Form.PUBLISHED:
            young = phases.young_rows(samples.count)
        return _Regressors(np.stack(columns, axis=1), tuple(names), samples.force_n, speed, noise, young)

    def _chosen(self, sweep: ThresholdSweep, names: tuple[str, ...]) -> tuple[int, int] | None:
        """Threshold numbers for (m and F_v, the rest) by the least expected error; None where none is determined."""
        determined = np.asarray(np.isfinite(sweep.std_error).all(axis=1))
        if self.threshold is not None:
            return (self.threshold, self.threshold) if determined[self.threshold - 1] else None
        if not determined.any():
            return None
        with np.errstate(all="ignore"):
            relative = np.minimum(sweep.std_error / np.abs(sweep.coefficients), 1.0) ** 2
        relative[~determined] = np.inf
        moving = [names.index(name) for name in ("m", "F_v") if name in names]
        resting = [names.index(name) for name in ("A", "k") if name in names]
        if self.form is Form.PUBLISHED:
            moving = resting = moving + resting
        first = int(np.argmin(relative[:, moving].sum(axis=1))) + 1
        return first, int(np.argmin(relative[:, resting].sum(axis=1))) + 1

    def _breakaways(self, motion: RecordedMotion, balance: Balance) -> BreakawayForces | None:
        if self.form is Form.PUBLISHED and not self._fits_preload:
            return published_breakaway_forces(motion.samples, motion.phases, balance.spring[0])
        preload = 0.0 if balance.preload is None else balance.preload[0]
        return breakaway_forces(motion.samples, motion.phases, balance.spring[0], preload)


def _limit_velocity(sweep: ThresholdSweep, raw: dict[str, float], speed: float) -> tuple[str, dict[str, float] | None]:
    """Second step, Eq. (8): the least threshold at which the friction of the fit is that of its threshold."""
    tied = "on ramps of one speed DV cannot be told from F_s"
    if "F_v" not in raw:
        return f"Eq. (8) finds none; {tied}", None
    limits = sweep.thresholds_m_per_s
    viscous = sweep.coefficients[:, 1]
    coulomb = sweep.coefficients[:, 2] - viscous * speed
    error = np.abs((coulomb - raw["F_c"]) + (viscous - raw["F_v"]) * limits)
    close = np.flatnonzero((error <= _CLOSE_TO_ZERO * abs(raw["F_c"])) & np.isfinite(sweep.std_error[:, 0]))
    if close.size == 0:
        return f"Eq. (8) finds none; {tied}", None
    found = float(limits[close[0]])
    note = (
        f"Eq. (8) gives {found:.3g} m/s on a grid of {sweep.step_m_per_s:.2g} m/s, which is where differences "
        f"begin to hold and not where the stem comes to rest; {tied}"
    )
    return note, {"limit_velocity_m_per_s": found, "threshold": float(close[0] + 1)}


def _raw_values(balance: Balance, first: _FirstStep) -> dict[str, float]:
    """Values before any judgement, by symbol; m and F_v as fitted to differences."""
    raw = {"k": balance.spring[0], "A": balance.friction[0]}
    if balance.preload is not None:
        raw["F_0"] = balance.preload[0]
    if first.full is not None:
        raw |= {"m": float(first.full.coefficients[0]), "F_v": float(first.full.coefficients[1])}
        raw["F_c"] = raw["A"] - balance.speed * raw["F_v"]
    return raw


def _is_clear(fit: LinearFit) -> bool:
    """Whether m^ and F_v^ are known to 15 %, so that nothing simpler is needed."""
    return bool((fit.std_error[:2] < 0.15 * np.abs(fit.coefficients[:2])).all() and (fit.coefficients[:2] > 0.0).all())


def _by_simulation(
    motion: RecordedMotion, parameters: dict[str, ParameterEstimate], fallback: Fallback
) -> ParameterEstimate:
    """Third step, Eq. (9), around the value from the breakaways."""
    start = parameters["F_s"]
    values = {symbol: estimate.value for symbol, estimate in parameters.items()}
    complete = {
        symbol: value if value is not None else fallback.by_symbol().get(symbol) for symbol, value in values.items()
    }
    known = {symbol: value for symbol, value in complete.items() if value is not None}
    if start.value is None or len(known) < len(complete):
        return start
    known["F_s"] = max(known["F_s"], known["F_c"])
    try:
        valve = parameters_from_symbols(known)
    except ParameterError:
        return start
    found = static_friction_by_simulation(
        motion.samples, valve, start.std_error or 0.0, motion.first_moving_row, motion.stops
    )
    return start if found is None else measured(*found, note="by simulation, Eq. (9)")
