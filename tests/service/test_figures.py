"""The pictures of tablet and report: what they draw and say of a test."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.figures.canvas import svg_text
from service.figures.loop import loop_picture
from service.figures.methods import methods_picture
from service.figures.misfit import time_picture
from service.figures.trace import trace_picture
from service.shown_units import UnitSystem
from valve.recording import Recording


def _estimates(preload_n: float, half_n: float) -> list[dict[str, Any]]:
    """Return two methods that differ by 0.1 % in friction and by twice in preload."""
    return [
        {
            "method": method,
            "parameters": {
                "F_c": {"value": friction_n, "unit": "N", "ci95": [friction_n - 1.0, friction_n + 1.0]},
                "F_0": {"value": offset_n, "unit": "N", "ci95": [offset_n - half_n, offset_n + half_n]},
            },
        }
        for method, friction_n, offset_n in (("regression", 1000.0, preload_n), ("garcia", 1001.0, 2.0 * preload_n))
    ]


def test_a_trace_of_many_samples_keeps_the_one_that_stands_out_and_its_holes() -> None:
    time_s = np.linspace(0.0, 59.999, 60_000)
    position_m = np.full(time_s.size, 0.05)
    position_m[31_234] = 0.09
    position_m[10_000:20_000] = np.nan
    recording = Recording(time_s, position_m, command_pa=np.linspace(0.0, 8.0e4, time_s.size))
    picture = trace_picture(recording, UnitSystem.SI)
    above, below = picture.figure.axes
    drawn_s, drawn = (np.asarray(one, dtype=np.float64) for one in above.get_lines()[0].get_data())
    assert drawn.size < 2000
    assert np.nanmax(drawn) > 1.5 * np.nanmin(drawn)
    assert np.isnan(drawn[(drawn_s > 10.1) & (drawn_s < 19.9)]).all()
    assert [line.get_label() for line in below.get_lines()] == ["command"]
    assert "60000 samples" in picture.description


def test_the_noise_of_a_stem_that_stood_still_is_not_drawn_as_motion() -> None:
    time_s = np.linspace(0.0, 10.0, 1001)
    still = Recording(time_s, 2.0e-6 * np.sin(900.0 * time_s), command_pa=np.zeros(time_s.size))
    for system in UnitSystem:
        low, high = trace_picture(still, system).figure.axes[0].get_ylim()
        drawn = trace_picture(still, system).figure.axes[0].get_lines()[0].get_ydata()
        assert np.ptp(np.asarray(drawn, dtype=np.float64)) < 0.01 * (high - low)


def test_a_trace_without_a_single_position_says_so() -> None:
    recording = Recording(np.array([0.0, 1.0]), np.full(2, np.nan), command_pa=np.zeros(2))
    assert "never measured" in trace_picture(recording, UnitSystem.SI).description


def test_a_parameter_that_may_be_zero_is_not_drawn_in_percent() -> None:
    picture = methods_picture(_estimates(0.01, 0.05), UnitSystem.SI)
    assert picture is not None
    assert "F_c" in picture.description
    assert "F_0" not in picture.description
    (axes,) = picture.figure.axes
    assert max(abs(end) for end in axes.get_xlim()) < 1.0


def test_a_preload_that_is_known_is_drawn() -> None:
    picture = methods_picture(_estimates(100.0, 1.0), UnitSystem.SI)
    assert picture is not None
    assert "F_0" in picture.description


def test_a_misfit_without_a_cause_is_not_called_one_without_the_cause() -> None:
    time = {"time_s": [0.0, 1.0], "measured_m": [0.0, 1.0e-3], "before_m": [0.0, 1.1e-3]}
    healthy, found = (time_picture({"time": one}, UnitSystem.SI) for one in (time, time | {"after_m": [0.0, 1.0e-3]}))
    assert healthy is not None
    assert found is not None
    assert "the cause" not in svg_text(healthy)
    assert "without the cause" in svg_text(found)


def _loop_over(channel: str) -> dict[str, Any]:
    """Return a signature with both branches over ``channel``."""
    up = {"travel_m": [0.0, 0.05, 0.1], channel: [0.0, 1000.0, 2000.0]}
    return {"curve": {"up": up, "down": up}, "central_stroke_m": [0.03, 0.07], "friction_mean_n": 20.0}


def test_the_loop_of_a_drive_is_drawn_over_its_force_and_never_over_a_pressure() -> None:
    """A recording with force_n has no pressure: its report ended in a KeyError."""
    picture = loop_picture(_loop_over("force_n"), _loop_over("pressure_pa"), UnitSystem.SI)
    assert picture is not None
    (axes,) = picture.figure.axes
    assert axes.get_xlabel() == "force of the actuator, N"
    drawn = [line.get_label() for line in axes.get_lines() if np.asarray(line.get_xdata()).size == 3]
    assert drawn == ["opening", "closing"]
    over_pressure = loop_picture(_loop_over("pressure_pa"), None, UnitSystem.SI)
    assert over_pressure is not None
    assert over_pressure.figure.axes[0].get_xlabel() == "pressure at the actuator, kPa"
