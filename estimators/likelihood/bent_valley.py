"""A descent along the bent valley of a stem that jumps: in unknowns that straighten it, with what still bends led back.

A straight step in m, F_v, F_c and F_s leaves the valley before it has gained anything, and a damped one gains so little
that it looks like the bottom. What a step changed beyond what its slopes told is the bend, and the slopes tell which
step takes it back: the second-order correction (Transtrum & Sethna, arXiv:1201.5885).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.likelihood.descent import Descent
from estimators.likelihood.jump_chart import JumpChart
from estimators.likelihood.model import StemModel
from estimators.likelihood.step_kernel import bounded_step
from estimators.samples import BoolArray, FloatArray

# Own choices, from random valves that stick and slip.
_FIRST_DAMPING: Final = 1.0e-3
_MOST_DAMPING: Final = 1.0e4
_LEAST_DAMPING: Final = 1.0e-12
_UNDAMPED: Final = 1.0e-9
_GROWTH: Final = 20.0
_SHRINKING: Final = 0.1
_BENT: Final = 0.2  # of the expected gain: less is led back
_CORRECTIONS: Final = 2
_FARTHEST_BACK: Final = 0.75  # of the step's longest part
_LONGEST: Final = 1.0  # of a logarithm, or of the unit of what is linear
_LEVEL_STEPS: Final = 6  # that together gain less than what counts as arrived


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A charted point (p,), its point (p,), the simulated position (n,), the residuals (n,) and the cost."""

    own: FloatArray
    point: FloatArray
    position_m: FloatArray
    residual: FloatArray
    cost: float


def descend_bent(
    model: StemModel, start: FloatArray, *, most_simulations: float, arrived: float, held: tuple[str, ...] = ()
) -> Descent:
    """Return the lowest point reached from ``start`` (p,), within so many simulations or a few more.

    What is ``held`` stays, F_c and d as what the chart has in their places. It has arrived where the step without
    damping promises less than ``arrived`` of the cost, or some steps together gained no more. Where steps gain undamped
    they go on further: the slopes' squares alone make the valley too steep.
    """
    chart = chart_of(model, start)
    own = chart.charted(start)
    here = None if own is None else _placed(model, chart, own)
    if here is None:
        return Descent(start, model.cost(start), 1, False)
    simulations, damping, reach = 1, _FIRST_DAMPING, 1.0
    costs = [here.cost]
    moving = np.array([name not in held for name in model.coordinates.names])
    while simulations < most_simulations:
        slopes, along = model.slopes(here.point, here=here.position_m), chart.slopes(here.own)
        simulations += 2 * start.size
        if slopes is None or along is None:
            break
        local = _Local(model, chart, here, slopes, along, moving)
        if local.gain(local.step(local.pull, _LEAST_DAMPING)) < arrived:
            return Descent(here.point, here.cost, simulations, True)
        found: _Place | None = None
        while found is None and damping < _MOST_DAMPING:
            found, tried = local.led(reach, damping)
            simulations += tried
            if found is not None:
                reach = 2.0 * reach if damping <= _UNDAMPED else reach
                damping = max(_SHRINKING * damping, _LEAST_DAMPING)
            elif reach > 1.0:
                reach = max(1.0, 0.25 * reach)
            else:
                damping = _GROWTH * max(damping, 0.1 * _UNDAMPED)
        if found is None:
            break
        here = found
        costs.append(here.cost)
        if len(costs) > _LEVEL_STEPS and costs[-1 - _LEVEL_STEPS] - costs[-1] < arrived:
            return Descent(here.point, here.cost, simulations, True)
    return Descent(here.point, here.cost, simulations, False)


@dataclass(frozen=True, slots=True, eq=False)
class _Local:
    """A place with the slopes there, (p, n) of the residuals and ``along`` (p, p) of the chart: what they promise."""

    model: StemModel
    chart: JumpChart
    here: _Place
    slopes: FloatArray
    along: FloatArray
    moving: BoolArray  # of the charted unknowns (p,)
    charted: FloatArray = field(init=False)
    normal: FloatArray = field(init=False)
    pull: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        known, weight = self.model.coordinates, self.model.coordinates.prior_weight
        charted = self.along @ self.slopes
        off = weight * (self.here.point - known.prior)
        object.__setattr__(self, "charted", charted)
        object.__setattr__(self, "normal", charted @ charted.T + (self.along * weight) @ self.along.T)
        object.__setattr__(self, "pull", charted @ self.here.residual - self.along @ off)

    def step(self, pull: FloatArray, damping: float) -> FloatArray:
        """Return the damped step of the charted point, shape (p,), for this pull (p,)."""
        count = pull.size
        far, longest = np.full(count, math.inf), np.full(count, _LONGEST)
        return bounded_step(self.normal, pull, damping, self.moving, self.here.own, -far, far, longest)

    def gain(self, step: FloatArray) -> float:
        """Return what this step (p,) would gain if nothing bent."""
        return float(2.0 * self.pull @ step - step @ self.normal @ step)

    def led(self, reach: float, damping: float) -> tuple[_Place | None, int]:
        """Return where ``reach`` times the damped step leads, led back; None if it gains nothing. And simulations."""
        step = reach * self.step(self.pull, damping)
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        enough = _BENT * abs(self.gain(step))
        longest = _FARTHEST_BACK * float(np.abs(step).max())
        trial, simulations = _placed(self.model, self.chart, self.here.own + step), 1
        for _ in range(_CORRECTIONS):
            if trial is None or self.here.cost - trial.cost > enough:
                break
            moved = trial.own - self.here.own
            back = self.step(self.charted @ (trial.residual - self.here.residual + moved @ self.charted), _UNDAMPED)
            if float(np.abs(back).max()) > longest:
                break
            led = _placed(self.model, self.chart, trial.own + back)
            simulations += 1
            if led is None or led.cost >= trial.cost:
                break
            trial = led
        return (trial if trial is not None and trial.cost < self.here.cost else None), simulations


def _placed(model: StemModel, chart: JumpChart, own: FloatArray) -> _Place | None:
    point = chart.point(own)
    position_m = None if point is None else model.simulate(point)
    if point is None or position_m is None:
        return None
    residual = model.left_by(position_m)
    return _Place(own, point, position_m, residual, float(residual @ residual) + model.prior_cost(point))


def chart_of(model: StemModel, point: FloatArray) -> JumpChart:
    """Return the chart of jumps on the ramps that drive this model at this point (p,)."""
    return JumpChart(model.coordinates, usual_rate(*model.corners(model.coordinates.values(point))))


def usual_rate(time_s: FloatArray, force_n: FloatArray) -> float:
    """Rate of force, N/s, that half of the time on ramps is spent below; of the corners (c,) of a force; 0 if flat."""
    lasts_s = np.diff(time_s)
    rate = np.abs(np.divide(np.diff(force_n), lasts_s, out=np.zeros_like(lasts_s), where=lasts_s > 0.0))
    order = np.argsort(rate)[np.count_nonzero(rate == 0.0) :]
    passed_s = np.cumsum(lasts_s[order])
    return float(rate[order[np.searchsorted(passed_s, 0.5 * passed_s[-1])]]) if order.size else 0.0
