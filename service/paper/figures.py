"""Figures 1 to 5 of Romano & Garcia (2007), drawn from our own computation as PNG and SVG."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from estimators.base import Outcome
from estimators.classic.regression import RegressionEstimator
from estimators.motion.recorded_motion import read_motion
from valve.errors import MeasurementError
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.recording import Recording
from valve.waveform import Waveform

FloatArray = npt.NDArray[np.float64]

# Okabe and Ito's colours, told apart also by colour-blind readers.
_BLACK: Final = "#000000"
_BLUE: Final = "#0072B2"
_ORANGE: Final = "#D55E00"
_GREY: Final = "#999999"
_DRAWN: Final = {
    "regression, ours": (_BLUE, "-", "method 1"),
    "garcia, ours": (_ORANGE, "-", "method 2"),
    "regression, printed": (_BLUE, ":", "method 1, printed parameters"),
    "garcia, printed": (_ORANGE, ":", "method 2, printed parameters"),
}
_LARGEST_POINTS: Final = 4000  # of a line in a picture


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """One valve under the validating sine: pressure (Pa), true position and others' (m), shape (n,)."""

    valve: str
    time_s: FloatArray
    pressure_pa: FloatArray
    truth_m: FloatArray
    positions_m: dict[str, FloatArray]

    def largest_errors_m(self) -> dict[str, float]:
        """Largest position error of each, m."""
        return {name: float(np.abs(found - self.truth_m).max()) for name, found in self.positions_m.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Method 1's estimates by symbol over the thresholds of speed (m/s), shape (S,)."""

    thresholds_m_per_s: FloatArray
    estimates: dict[str, FloatArray]


def paper_sweep(recording: Recording, nameplate: Nameplate, method_1: RegressionEstimator) -> Sweep:
    """Return what method 1 gives for every threshold of Eq. (7). Raises MeasurementError where nothing moves."""
    motion = read_motion(recording, nameplate)
    if isinstance(motion, Outcome):
        raise MeasurementError(f"{nameplate.tag}: {motion}")
    sweep, names, speed = method_1.sweep(motion)
    found = {name: sweep.coefficients[:, place] for place, name in enumerate(names)}
    coulomb = found["A"] - found["F_v"] * speed
    return Sweep(sweep.thresholds_m_per_s, {"m": found["m"], "k": found["k"], "F_v": found["F_v"], "F_c": coulomb})


def draw_figures(out_dir: Path, test: Waveform, sweep: Sweep, validations: tuple[Validation, ...]) -> tuple[Path, ...]:
    """Draw the figures into ``out_dir``, which is made, and return their paths (PNG and SVG of each)."""
    out_dir.mkdir(parents=True, exist_ok=True)
    figures = {"figure_1": _pressure(test), "figure_2": _sweep(sweep)}
    for number, validation in enumerate(validations, 3):
        figures[f"figure_{number}"] = _validation(number, validation)
    paths = []
    for name, figure in figures.items():
        for suffix in ("png", "svg"):
            path = out_dir / f"{name}.{suffix}"
            figure.savefig(path, dpi=150, metadata={"Date": None} if suffix == "svg" else None)
            paths.append(path)
    return tuple(paths)


def _figure(width_in: float, height_in: float, title: str) -> Figure:
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure


def _tidy(axes: Axes, *, x: str | None, y: str) -> None:
    axes.set_ylabel(y)
    if x is not None:
        axes.set_xlabel(x)
    axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _pressure(test: Waveform) -> Figure:
    figure = _figure(7.0, 3.0, "Figure 1. Actuator pressure of the estimation test")
    axes = figure.subplots()
    axes.plot(test.time_s, test.pressure_pa / 1e3, color=_BLUE)
    axes.set_xlim(0.0, test.duration_s)
    axes.set_ylim(bottom=0.0)
    _tidy(axes, x="time, s", y="pressure, kPa")
    return figure


def _sweep(sweep: Sweep) -> Figure:
    """Figure 2: what the regression gives for every threshold, the true values beside it."""
    figure = _figure(7.0, 5.4, "Figure 2. Method 1 on the vendor valve: estimates over the threshold of speed, Eq. (7)")
    truth = parameter_set("vendor").parameters.by_symbol()
    units = {"m": "m, kg", "k": "k, kN/m", "F_v": "$F_v$, N s/m", "F_c": "$F_c$, N"}
    panels = figure.subplots(2, 2, sharex=True)
    for axes, (symbol, estimates) in zip(panels.flat, sweep.estimates.items(), strict=True):
        scale = 1.0e-3 if symbol == "k" else 1.0
        values, true_value = estimates * scale, truth[symbol] * scale
        axes.axhline(true_value, color=_GREY, linestyle="--", linewidth=1.2, label="true value")
        axes.plot(sweep.thresholds_m_per_s * 1e3, values, color=_BLUE, linewidth=1.3, label="method 1")
        shown = [*np.quantile(values, [0.02, 0.98]), true_value]
        margin = 0.15 * (max(shown) - min(shown))
        axes.set_ylim(min(shown) - margin, max(shown) + margin)
        axes.ticklabel_format(useOffset=False)
        _tidy(axes, x="threshold $\\delta v$, mm/s" if symbol in ("F_v", "F_c") else None, y=units[symbol])
    panels.flat[0].legend(frameon=False, fontsize=9)
    return figure


def _validation(number: int, validation: Validation) -> Figure:
    """Figures 3 to 5: position above, its error below."""
    title = f"Figure {number}. {validation.valve.capitalize()} valve under an 8 s sine that was not estimated from"
    figure = _figure(7.0, 5.2, title)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    step = max(1, validation.time_s.size // _LARGEST_POINTS)
    time_s = validation.time_s[::step]
    above.plot(time_s, validation.truth_m[::step] * 1e3, color=_BLACK, linewidth=2.2, label="true valve")
    for name, position_m in validation.positions_m.items():
        colour, line, label = _DRAWN[name]
        if name.endswith("ours"):
            above.plot(time_s, position_m[::step] * 1e3, color=colour, linewidth=1.1, linestyle="--", label=label)
        error_mm = (position_m - validation.truth_m)[::step] * 1e3
        below.plot(time_s, error_mm, color=colour, linestyle=line, linewidth=1.1, label=label)
    above.set_xlim(0.0, float(time_s[-1]))
    _tidy(above, x=None, y="stem position, mm")
    _tidy(below, x="time, s", y="error, mm")
    above.legend(frameon=False, fontsize=9, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    below.legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure
