"""What stands between a command and the pressure that was measured: lag, dead time, supply limit and leak."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np
from scipy.optimize import minimize

from discrepancy.causes.base import Fitted
from discrepancy.commanded_rows import FEWEST_ROWS, CommandedRows, written
from estimators.samples import FloatArray, channel_noise
from valve.recording import Acquisition, Recording

# Own choices: what no I/P and no gauge is better than, and what is beyond a usual one (docs/diagnosis.md).
_LEAST_LAG_S: Final = 0.03
_LEAST_DEAD_TIME_S: Final = 0.018
_LEAST_LEAK: Final = 0.003
_LEAST_CUT: Final = 0.004  # of the pressure's range, that a limit must cut off
_GAUGE: Final = 1.0e-4  # of the range: no gauge agrees better with a model
_LEAST_SHARE: Final = 0.25  # of the mean square misfit, that a further cause must take
_SURE: Final = 1.5  # times the noise, below which nothing is missed
_MOST_CAUSES: Final = 3
_SEVERAL: Final = 2
_LONGEST_S: Final = 5.0
_LAG_STARTS_S: Final = (0.03, 0.3)
_DELAY_STARTS_S: Final = (0.02, 0.15, 0.6)
_LIMIT_STARTS: Final = (0.002, 0.03, 0.1)  # of the range, below the highest pressure that is asked for
_SIGMAS: Final = 4.0
_FAR: Final = 1.0e6  # mean squares of the range: what no fit leaves
_ROWS_THAT_COUNT_AS_ONE: Final = 100.0
CAUSES: Final = ("transducer_lag", "transducer_dead_time", "supply_saturation", "actuator_leak")


@dataclass(frozen=True, slots=True)
class PressurePath:
    """T P' = (1 - leak) min(u(t - dead time), limit) + offset - P, fitted to pressures; ``limit_pa`` may be infinite.

    ``causes`` are those that stand out, each with its value; ``rms_before_pa`` and ``rms_after_pa`` what is missed.
    """

    causes: tuple[tuple[str, Fitted], ...]
    lag_s: float
    dead_time_s: float
    limit_pa: float
    leak: float
    offset_pa: float
    rms_before_pa: float
    rms_after_pa: float

    @property
    def share(self) -> float:
        """Share of the pressure's misfit that the causes take."""
        return 1.0 - (self.rms_after_pa / max(self.rms_before_pa, 1.0e-300)) ** 2

    def answered(self, recording: Recording) -> FloatArray:
        """Return the pressure that this path makes of a recording's command, Pa, shape (n,)."""
        return CommandedRows.of(recording).answer(self.lag_s, self.dead_time_s, self.limit_pa) * (1.0 - self.leak) + (
            self.offset_pa
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Values by cause (0 or infinite where it is not in the fit), the offset, and the mean square that is left."""

    causes: tuple[str, ...]
    lag_s: float
    dead_time_s: float
    limit_pa: float
    leak: float
    offset_pa: float
    mean_square: float

    def value(self, cause: str) -> float:
        """Value of a cause in its effect's unit, the limit's in Pa."""
        values = (self.lag_s, self.dead_time_s, self.limit_pa, self.leak)
        return dict(zip(CAUSES, values, strict=True))[cause]


def read_pressure_path(recordings: Sequence[Recording]) -> PressurePath | None:
    """Return what stands between command and pressure in these recordings; None where either was not recorded."""
    if not recordings or any(one.command_pa is None or one.pressure_pa is None for one in recordings):
        return None
    rows = [CommandedRows.of(recording) for recording in recordings]
    finite = [np.isfinite(one.pressure_pa) for one in rows]
    if min(int(np.count_nonzero(known)) for known in finite) < FEWEST_ROWS:
        return None
    pressures = np.concatenate([one.pressure_pa[known] for one, known in zip(rows, finite, strict=True)])
    range_pa = float(np.ptp(pressures))
    run_first = np.zeros(rows[0].time_s[finite[0]].size, dtype=np.int64)
    noise_pa = channel_noise(rows[0].time_s[finite[0]], rows[0].pressure_pa[finite[0]], run_first)
    floor = max(noise_pa, _GAUGE * range_pa) ** 2
    fitting = _Fitting(rows, finite, range_pa)
    before = fitting.fitted((), ())
    best = _chosen(fitting, before, floor)
    if best.causes and best.mean_square > floor:
        # the first alone may stand for two others: a lag rounds the corners that a limit cuts off
        pair = _lowest_pair(fitting, before)
        best = _chosen(fitting, pair, floor) if _is_worth(best, pair, floor) else best
    best = _exchanged(fitting, best)
    spread = math.sqrt(max(best.mean_square, floor) / max(pressures.size / _ROWS_THAT_COUNT_AS_ONE, 1.0))
    named = tuple(
        (cause, _fitted(best, cause, spread, range_pa))
        for cause in best.causes
        if _stands_out(best, cause, recordings, range_pa, fitting.highest_pa)
    )
    return PressurePath(
        named,
        best.lag_s,
        best.dead_time_s,
        best.limit_pa,
        best.leak,
        best.offset_pa,
        math.sqrt(before.mean_square),
        math.sqrt(max(best.mean_square, 0.0)),
    )


def _chosen(fitting: _Fitting, best: _Fit, floor: float) -> _Fit:
    """Return the fit with further causes, the one that leaves least first, for as long as one is worth it."""
    while len(best.causes) < _MOST_CAUSES and best.mean_square >= _SURE**2 * floor:
        tried = [fitting.with_cause(best, cause) for cause in CAUSES if cause not in best.causes]
        found = min((one for one in tried if one is not None), key=lambda one: one.mean_square, default=None)
        if found is None or not _is_worth(best, found, floor):
            break
        best = found
    return best


def _lowest_pair(fitting: _Fitting, before: _Fit) -> _Fit:
    """Return the lowest fit of two causes, each from where the better of them is alone."""
    alone = [one for cause in CAUSES if (one := fitting.with_cause(before, cause)) is not None]
    alone.sort(key=lambda one: one.mean_square)
    tried = [fitting.with_cause(first, second.causes[0]) for first, second in combinations(alone, 2)]
    return min((one for one in tried if one is not None), key=lambda one: one.mean_square, default=before)


def _exchanged(fitting: _Fitting, best: _Fit) -> _Fit:
    """Return the fit with each of several causes in place of which another leaves less: the first was chosen alone."""
    if len(best.causes) < _SEVERAL:
        return best
    for cause in best.causes:
        others = [one for one in CAUSES if one not in best.causes]
        tried = [one for other in others if (one := fitting.with_other(best, cause, other)) is not None]
        best = min([best, *tried], key=lambda one: one.mean_square)
    return best


def _is_worth(best: _Fit, found: _Fit, floor: float) -> bool:
    """Whether a fit leaves so much less than another that no gauge makes the difference."""
    return best.mean_square - found.mean_square >= max(_LEAST_SHARE * best.mean_square, floor)


def without_pressure(recording: Recording, path: PressurePath | None) -> Recording:
    """Return the recording with the pressure that its command would give: through the path, or at once.

    Where no writes were recorded the command goes: a polled pressure that follows it to the digit would be read as one
    that is held from row to row.
    """
    pressure_pa = recording.command_pa if path is None else path.answered(recording)
    command_pa = None if written(recording) is None else recording.command_pa
    return replace(recording, pressure_pa=pressure_pa, command_pa=command_pa)


def _stands_out(fit: _Fit, cause: str, recordings: Sequence[Recording], range_pa: float, highest_pa: float) -> bool:
    """Whether a value is beyond what a usual I/P and the way of recording have."""
    late_s = max(
        2.0 * one.sample_period_s if one.provenance.acquisition is Acquisition.POLLED else one.sample_period_s
        for one in recordings
    )
    if cause == "supply_saturation":
        return fit.limit_pa < highest_pa - _LEAST_CUT * range_pa
    least = {
        "transducer_lag": _LEAST_LAG_S,
        "transducer_dead_time": max(_LEAST_DEAD_TIME_S, 0.5 * late_s),
        "actuator_leak": _LEAST_LEAK,
    }
    return fit.value(cause) > least[cause]


def _fitted(fit: _Fit, cause: str, spread_pa: float, range_pa: float) -> Fitted:
    value = fit.value(cause)
    share = _SIGMAS * spread_pa / range_pa
    if cause == "supply_saturation":
        half, unit = _SIGMAS * spread_pa, "Pa"
    elif cause == "actuator_leak":
        half, unit = share, "1"
    else:
        half, unit = max(0.02 * value, 1.0e-3), "s"
    return Fitted(value, value - half, value + half, unit)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitting:
    rows: list[CommandedRows]
    finite: list[np.ndarray[tuple[int], np.dtype[np.bool_]]]
    range_pa: float

    @property
    def highest_pa(self) -> float:
        """The highest pressure that was asked for, Pa."""
        return max(float(one.command[1].max()) for one in self.rows)

    def with_cause(self, fit: _Fit, cause: str) -> _Fit | None:
        """Return the fit with one cause more, from several starts."""
        causes = (*fit.causes, cause)
        starts: list[float] = [0.0]
        if cause == "transducer_lag":
            starts = list(_LAG_STARTS_S)
        elif cause == "transducer_dead_time":
            starts = list(_DELAY_STARTS_S)
        elif cause == "supply_saturation":
            starts = [self.highest_pa - share * self.range_pa for share in _LIMIT_STARTS]
        fits = [self.fitted(causes, (*(fit.value(one) for one in fit.causes), start)) for start in starts]
        return min(fits, key=lambda one: one.mean_square, default=None)

    def with_other(self, fit: _Fit, cause: str, other: str) -> _Fit | None:
        """Return the fit with another cause in place of one, from where the rest are."""
        kept = tuple(one for one in fit.causes if one != cause)
        return self.with_cause(replace(fit, causes=kept), other)

    def fitted(self, causes: tuple[str, ...], start: tuple[float, ...]) -> _Fit:
        """Return the fit of these causes from a start; leak and offset are linear."""
        shapes = [one for one in causes if one != "actuator_leak"]
        scales = np.array([0.05 if one != "supply_saturation" else 0.02 * self.range_pa for one in shapes])
        at = np.array([value for one, value in zip(causes, start, strict=True) if one != "actuator_leak"])
        if not shapes:
            return self._solved(causes, {})

        def cost(moved: FloatArray) -> float:
            values = dict(zip(shapes, (at + scales * moved).tolist(), strict=True))
            if any(not 0.0 <= values.get(one, 0.0) <= _LONGEST_S for one in CAUSES[:2]):
                return _FAR * self.range_pa**2
            return self._solved(causes, values).mean_square

        found = minimize(
            cost, np.zeros(len(shapes)), method="Nelder-Mead", options={"xatol": 1.0e-3, "fatol": 0.0, "maxfev": 120}
        )
        return self._solved(causes, dict(zip(shapes, (at + scales * found.x).tolist(), strict=True)))

    def _solved(self, causes: tuple[str, ...], values: dict[str, float]) -> _Fit:
        lag_s, dead_time_s = values.get("transducer_lag", 0.0), values.get("transducer_dead_time", 0.0)
        limit_pa = values.get("supply_saturation", math.inf)
        pairs = [
            (one.answer(lag_s, dead_time_s, limit_pa)[known], one.pressure_pa[known])
            for one, known in zip(self.rows, self.finite, strict=True)
        ]
        answer, pressure_pa = (np.concatenate([pair[place] for pair in pairs]) for place in (0, 1))
        rate = 1.0
        if "actuator_leak" in causes:
            centred = answer - answer.mean()
            rate = float(centred @ (pressure_pa - pressure_pa.mean())) / max(float(centred @ centred), 1.0e-300)
        offset_pa = float(np.mean(pressure_pa - rate * answer))
        left = pressure_pa - rate * answer - offset_pa
        return _Fit(causes, lag_s, dead_time_s, limit_pa, 1.0 - rate, offset_pa, float(np.mean(left**2)))
