"""How strong a hidden effect is: the misfit of the best mean law beside that of healthy draws of the same valve."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import minimize

from tests.bench.judge.effects import Effect
from tests.bench.judge.recordings import Run, Setting, mean_position, run
from tests.bench.judge.valves import ROW_S, FloatArray, Valve

_COARSE: Final = 5  # steps of 0.2 ms: right to a few um
_EACH: Final = 10  # rows
_STEPS: Final = np.array([0.02, 0.002, 0.01, 0.01, 0.05])  # of F_0 / F_c and of the logarithms of k, F_c, F_s, F_v
_BENCH_SET: Final = 0.005  # of the full force: as far as F_0 may be from the nameplate's
_ROUNDS: Final = 6
_POLISH: Final = 90
_HEALTHY_DRAWS: Final = 2
_CHANGES: Final = 4  # of the size until the strength is as asked


def best_mean_law(made: Run, start: Valve, *, by_command: bool) -> tuple[Valve, float]:
    """Return the mean law that follows the measured position best, and its misfit, m rms.

    Damped Gauss-Newton steps, then a simplex. For what lies between command and pressure: the misfit of the law
    itself, which the pressure shows, under the command behind a healthy path.
    """
    drive_pa = made.path_pa if by_command else made.true_pa
    measured_m = made.position_m[::_EACH]
    start_m = float(np.median(made.position_m[:100]))
    if by_command:
        off_m = mean_position(start, drive_pa, start_m, _COARSE)[::_EACH] - measured_m
        return start, float(np.sqrt(np.mean(off_m**2)))

    def law(values: FloatArray) -> Valve:
        k, F_c, F_s, F_v = np.array([start.k, start.F_c, start.F_s, start.F_v]) * np.exp(np.clip(values[1:], -2, 2))
        room_n = _BENCH_SET * start.full_force_n
        F_0 = start.F_0 + float(np.clip(values[0] * start.F_c, -room_n, room_n))
        return replace(start, F_0=F_0, k=float(k), F_c=float(F_c), F_s=float(max(F_s, F_c)), F_v=float(F_v))

    def misses(values: FloatArray) -> FloatArray:
        return np.asarray(mean_position(law(values), drive_pa, start_m, _COARSE)[::_EACH] - measured_m)

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(misses(values) ** 2)))

    best = min(np.zeros(5), _by_balance(made, start), key=rms)
    missed = misses(best)
    damping = 1.0e-2
    for _ in range(_ROUNDS):
        columns = np.stack([(misses(best + step) - missed) / step.sum() for step in np.diag(_STEPS)], axis=1)
        scaled = columns * _STEPS
        normal = scaled.T @ scaled
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-30), scaled.T @ missed) * _STEPS
        trial = best + np.clip(step, -20 * _STEPS, 20 * _STEPS)
        tried = misses(trial)
        if tried @ tried < missed @ missed:
            best, missed, damping = trial, tried, 0.2 * damping
        else:
            damping *= 20.0
    simplex = np.vstack([best, best + np.diag(_STEPS)])
    found = minimize(rms, best, method="Nelder-Mead", options={"maxfev": _POLISH, "initial_simplex": simplex})
    return law(found.x), float(found.fun)


def _by_balance(made: Run, start: Valve) -> FloatArray:
    """Return where to begin the fit: the balance of forces of the rows in steady motion."""
    position_m = np.convolve(made.position_m, np.full(51, 1.0 / 51.0), "same")
    speed = np.gradient(position_m, ROW_S)
    ramp = start.area_m2 * np.gradient(made.true_pa, ROW_S) / start.k
    moving = (np.abs(speed - ramp) < 0.3 * np.abs(ramp)) & (np.abs(ramp) > 0.02 * start.travel_m / 10.0)
    moving[:100] = moving[-100:] = False
    if moving.sum() < 1000:
        return np.zeros(5)
    columns = np.stack([np.ones(moving.sum()), position_m[moving], np.sign(speed[moving])], axis=1)
    force_n = start.area_m2 * made.true_pa[moving] - start.F_v * speed[moving]
    F_0, k, F_c = np.linalg.lstsq(columns, force_n, rcond=None)[0]
    if k <= 0.0 or F_c <= 0.0:
        return np.zeros(5)
    return np.array([(F_0 - start.F_0) / start.F_c, np.log(k / start.k), np.log(F_c / start.F_c), 0.0, 0.0])


def healthy_misfit(setting: Setting, *, by_command: bool) -> float:
    """Return the misfit of healthy draws of the same valve and grade, m rms, by the median."""
    draws = []
    for number in range(_HEALTHY_DRAWS):
        other = replace(setting, seed=setting.seed + 7919 * (number + 1))
        draws.append(best_mean_law(run(other), setting.valve, by_command=by_command)[1])
    return float(np.median(draws))


def sized(
    setting: Setting, effect: Effect, band: tuple[float, float], healthy_m: float, target: float
) -> tuple[float, float, Run]:
    """Return a size that makes the effect as strong as the band asks, its strength, and the run with it.

    A size stays in its natural range: then the strength is what it is.
    """
    size = float(np.sqrt(effect.smallest * effect.largest))
    strength, made = 0.0, run(setting, ((effect, size),))
    for _ in range(_CHANGES):
        strength = best_mean_law(made, setting.valve, by_command=effect.path)[1] / healthy_m
        if band[0] <= strength <= band[1]:
            break
        factor = np.sqrt((target**2 - 1.0) / max(strength**2 - 1.0, 0.15))
        other = float(np.clip(size * np.clip(factor, 0.1, 8.0), effect.smallest, effect.largest))
        if other == size:
            break
        size = other
        made = run(setting, ((effect, size),))
    else:
        strength = best_mean_law(made, setting.valve, by_command=effect.path)[1] / healthy_m
    return size, strength, made
