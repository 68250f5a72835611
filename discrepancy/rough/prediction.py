"""What a cause gains: the mean law simulated on data that had no part in the fit, and the whole model's band there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.causes.base import Cause, Shape
from discrepancy.rough.causes.seen import Seen
from discrepancy.rough.evidence import Problem, Solved, of_rows, problem_of, solved
from discrepancy.rough.observations import Observations, as_measured, observations
from discrepancy.rough.selection import column_of
from discrepancy.rough.setting import Setting
from discrepancy.rough.simulation import parameters_of, simulated, with_effects
from estimators.base import NORMAL_95, Estimate, Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading
from estimators.engine.roughness import ROUGH, field_covariance, roughness_of
from valve.effects.base import Effect
from valve.errors import ValveError
from valve.extended_valve import ExtendedValve
from valve.messages import say
from valve.nameplate import Nameplate
from valve.parameters import ValveParameters, parameters_from_symbols
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

LEFT_OUT: Final = say("last_third_left_out", "the last third of the recording, which was left out of the fit")
_KEPT: Final = 0.66
_ANOTHER_DAY_S: Final = 1.0e7  # the wander of another recording is another one
_WORSE: Final = 1.1  # times the error before: by chance a right cause predicts this much worse
_FAR_WORSE: Final = 2.0
_MOSTLY: Final = 0.75  # of the rows
_FEWEST_ROWS: Final = 20

Law = tuple[Cause, Shape]


@dataclass(frozen=True, slots=True)
class MapGain:
    """The whole model's errors, m, and the share of rows inside its 95 % band."""

    rmse_before_m: float
    rmse_after_m: float
    inside_band_before: float
    inside_band_after: float


@dataclass(frozen=True, slots=True)
class Gain:
    """Root mean square errors of the mean law, m, on data that was held out; beside it those of the whole model.

    ``nearer`` is the share of the rows at which the model with the causes is the nearer one.
    """

    held_out: str
    rmse_before_m: float
    rmse_after_m: float
    noise_floor_m: float
    nearer: float
    with_map: MapGain | None

    @property
    def is_worse(self) -> bool:
        """Whether the model with the causes predicts worse than the one without.

        One breakaway that was harder than usual puts the simulated stem off by millimetres, whatever the model. So it
        counts, too, at how many of the rows it is nearer to what was measured.
        """
        return self.rmse_after_m > _WORSE * self.rmse_before_m and self.nearer < _MOSTLY

    @property
    def is_far_worse(self) -> bool:
        """Whether it predicts so much worse that not even what the recording shows directly can be the cause."""
        return self.rmse_after_m > _FAR_WORSE * max(self.rmse_before_m, self.noise_floor_m)

    def to_json(self) -> dict[str, Any]:
        """Return the gain as in the analysis object."""
        whole = self.with_map
        return {
            "held_out": self.held_out,
            "rmse_before_m": self.rmse_before_m,
            "rmse_after_m": self.rmse_after_m,
            "noise_floor_m": self.noise_floor_m,
            "with_map": None
            if whole is None
            else {
                "rmse_before_m": whole.rmse_before_m,
                "rmse_after_m": whole.rmse_after_m,
                "inside_band_before": whole.inside_band_before,
                "inside_band_after": whole.inside_band_after,
            },
        }


def effect_percent(parameters: ValveParameters, effect: Effect, reading: Reading, travel_m: float) -> float | None:
    """Largest change of the stem's position that an effect makes in this test, in percent of the travel."""
    try:
        _, without_m = simulated(ExtendedValve(parameters), reading)
        _, with_m = simulated(with_effects(parameters, [effect]), reading)
    except ValveError:
        return None
    return 100.0 * float(np.abs(with_m - without_m).max()) / travel_m


def _simulated_errors(valve: ExtendedValve, reading: Reading, from_s: float) -> FloatArray | None:
    """How far off the simulated position is at the instants from then on, m, shape (n,)."""
    try:
        time_s, shown_m = simulated(valve, reading)
    except ValveError:
        return None
    there = time_s >= from_s
    return np.asarray(np.abs(shown_m[there] - np.interp(time_s[there], reading.time_s, reading.position_m)))


def _rmse(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """The models before and after, and what it takes to ask them elsewhere.

    ``accepted`` are the laws of the model that was accepted for the valve and ``usual`` what was seen of it: both
    models have them. ``laws`` and ``seen`` are those of the model after alone.
    """

    before: Solved
    after: Solved
    accepted: tuple[Law, ...]
    laws: tuple[Law, ...]
    usual: tuple[Seen, ...]
    seen: tuple[Seen, ...]
    setting: Setting
    estimate: Estimate | None
    nameplate: Nameplate

    def valves(self) -> tuple[ExtendedValve, ExtendedValve]:
        """Return the plain valve, and the one with all causes."""
        return self._valves(self.before, self.after)

    def _valves(self, before: Solved, after: Solved) -> tuple[ExtendedValve, ExtendedValve]:
        # without a cause that is known beside the nameplate's preload the valve has that one
        is_offset = any(cause.is_offset for cause, _ in self.laws)
        preload_n = self.setting.preload_n if is_offset else None
        return self._valve(before, self.accepted, self.usual, preload_n), self._valve(
            after, self.accepted + self.laws, self.usual + self.seen
        )

    def _valve(
        self, model: Solved, laws: Sequence[Law], seen: Sequence[Seen], preload_n: float | None = None
    ) -> ExtendedValve:
        parameters = parameters_of(model, self.estimate, self.nameplate)
        parameters = parameters if preload_n is None else replace(parameters, preload_n=preload_n)
        short_n = max(parameters.static_friction_n - model.known("F_s").value, 0.0)
        # a law that changed since it was accepted is there twice
        numbers: dict[str, list[int]] = {}
        for number, (cause, _) in enumerate(laws):
            numbers.setdefault(cause.name, []).append(number)
        effects = []
        for of_law in numbers.values():
            cause, shape = laws[of_law[0]]
            effects.append(cause.effect(cause.values(model.total(of_law).value, shape), short_n))
        for one in seen:
            effects += [] if one.effect is None else [one.effect]
            if one.stem:
                parameters = parameters_from_symbols({**parameters.by_symbol(), **one.stem})
        return with_effects(parameters, effects)

    def elsewhere(self, name: str, recording: Recording) -> Gain | None:
        """Return the gain on another recording, None where it cannot be read."""
        reading = as_measured(recording, self.nameplate)
        if isinstance(reading, Outcome):
            return None
        lag = lag_after_corners(reading)
        rows = observations(reading, lag, slips=bool(self.before.problem.rows.way_m.any()))
        whole = None
        if int(rows.is_slide.sum()) >= _FEWEST_ROWS:
            later = _shifted(rows, _ANOTHER_DAY_S)
            whole = self._with_map(self.before, self.after, later, rows, lag)
        return self._gain(name, reading, self._valves(self.before, self.after), 0.0, whole)

    def left_out(self, reading: Reading) -> Gain | None:
        """Return the gain on the last part of the recording, both models fitted to what comes before."""
        rows = self.before.problem.rows
        from_s = float(rows.time_s.min()) + _KEPT * float(np.ptp(rows.time_s))
        kept = rows.time_s < from_s
        rest = rows.rows(~kept)
        if int((kept & rows.is_slide).sum()) < _FEWEST_ROWS or int(rest.is_slide.sum()) < 3:
            return None
        if np.unique(rows.direction[kept & rows.is_slide]).size < 2:
            return None
        before, after = self._part(self.before, kept), self._part(self.after, kept)
        whole = self._with_map(before, after, rest, rest, Known(self.before.known("lag").value, 1.0))
        return self._gain(LEFT_OUT, reading, self._valves(before, after), from_s, whole)

    def _part(self, model: Solved, kept: npt.NDArray[np.bool_]) -> Solved:
        columns = replace(model.columns, values=model.columns.values[kept])
        return solved(of_rows(model.problem, kept), columns, model.logarithms)

    def _gain(
        self,
        name: str,
        reading: Reading,
        valves: tuple[ExtendedValve, ExtendedValve],
        from_s: float,
        whole: MapGain | None,
    ) -> Gain | None:
        before_m, after_m = (_simulated_errors(valve, reading, from_s) for valve in valves)
        if before_m is None or after_m is None:
            return None
        nearer = float(np.mean(after_m < before_m))
        return Gain(name, _rmse(before_m), _rmse(after_m), reading.noise_m, nearer, whole)

    def _with_map(self, before: Solved, after: Solved, rows: Observations, here: Observations, lag: Known) -> MapGain:
        problem = problem_of(here, self.setting, lag)
        of_before = _predicted(before, rows, problem, self.accepted)
        of_after = _predicted(after, rows, problem, self.accepted + self.laws)
        return MapGain(of_before[0], of_after[0], of_before[1], of_after[1])


def _shifted(rows: Observations, by_s: float) -> Observations:
    return replace(rows, time_s=rows.time_s + by_s)


def _predicted(model: Solved, rows: Observations, problem: Problem, laws: Sequence[Law]) -> tuple[float, float]:
    """Error of the position in driven motion by the whole model, m, and the share inside its 95 % band."""
    old = model.problem.rows
    sizes = [model.size(number).value for number in range(len(laws))]
    columns = [column_of(cause, shape, problem, size) for (cause, shape), size in zip(laws, sizes, strict=True)]
    design = np.column_stack([problem.design, *columns])
    everywhere = field_covariance(
        np.concatenate([old.travel_m, rows.travel_m]),
        np.concatenate([old.time_s, rows.time_s]),
        np.concatenate([old.direction, rows.direction]),
        roughness_of(model.logarithms[:6]),
        ROUGH,
    )
    share = np.where(old.is_slide, 1.0, model.problem.share)
    across = everywhere[old.count :, : old.count] * share
    mean_n = design @ model.values + across @ model.weighted
    own = np.diag(everywhere[old.count :, old.count :]).copy()
    # the field's own, then the mean law's: what of its columns the field takes up is counted once
    error_n2 = own - np.sum((across @ model.projection) * across, axis=1)
    taken = across @ np.linalg.solve(model.whole, np.hstack([model.problem.design, model.columns.values]))
    for columns_n, sign in ((design - taken, 1.0), (taken, -1.0)):
        error_n2 += sign * np.sum((columns_n @ model.covariance) * columns_n, axis=1)
    error_n2 += rows.variance_n2 + model.hyperparameter("error") ** 2
    slide = rows.is_slide
    off_n = (rows.force_n - mean_n)[slide]
    inside = np.abs(off_n) < NORMAL_95 * np.sqrt(np.maximum(error_n2[slide], 1.0e-12))
    weight = rows.duration_s[slide]
    rmse_n = math.sqrt(float(weight @ off_n**2 / weight.sum()))
    return rmse_n / model.known("k").value, min(1.0, float(weight @ inside / weight.sum()))
