"""A polled pressure between its rows, as its command tells it."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.likelihood.inputs.answered_lines import answered_corners
from estimators.likelihood.inputs.pressure_lines import MeasuredPath, measured_path
from estimators.motion.lagged_lines import lagged
from estimators.samples import BoolArray, FloatArray
from valve.recording import Acquisition, Provenance, Recording

_CORNER_S = np.array([0.0, 0.513, 4.513, 8.513, 9.663, 10.813, 12.813])
_ASKED_PA = np.array([0.0, 0.0, 1.0e5, 0.0, 1.0e5, 0.0, 0.5e5])
_CLOSE = 1.0e-4  # of the span
_LATE_S = 4.0e-4  # that the pressure is read after its row


def _answer(lag_s: float, dead_time_s: float, limit_pa: float) -> tuple[FloatArray, FloatArray]:
    time_s: FloatArray = np.arange(0.0, 12.813, 1.0e-4)
    limited = np.minimum(np.interp(time_s - dead_time_s, _CORNER_S, _ASKED_PA), limit_pa)
    return (time_s, limited) if lag_s == 0.0 else lagged(time_s, limited, 0.0, lag_s, 1.0e-2)


def _polled(pressure: tuple[FloatArray, FloatArray], noise_pa: float = 0.0, kept: BoolArray | None = None) -> Recording:
    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 12.7, 0.02)
    time_s[1:] += 0.1 * 0.02 * np.clip(rng.normal(size=time_s.size - 1), -3.0, 3.0)
    pressure_pa = np.interp(time_s + _LATE_S, *pressure) + noise_pa * rng.normal(size=time_s.size)
    provenance = Provenance(Acquisition.POLLED, requested_period_s=0.02, timing_uncertainty_s=1.0e-3)
    asked_pa = np.interp(time_s, _CORNER_S, _ASKED_PA)
    made = Recording(time_s, asked_pa / 1.0e6, pressure_pa=pressure_pa, command_pa=asked_pa, provenance=provenance)
    return made if kept is None else made.rows(kept)


@pytest.mark.parametrize(
    ("lag_s", "dead_time_s", "limit_pa"), [(0.1, 0.0, 2.0e5), (0.0, 0.2, 2.0e5), (0.0, 0.0, 9.7e4)]
)
def test_a_polled_pressure_is_known_between_its_rows_and_in_a_gap_at_its_turn(
    lag_s: float, dead_time_s: float, limit_pa: float
) -> None:
    answer = _answer(lag_s, dead_time_s, limit_pa)
    rows = np.arange(635)
    recording = _polled(answer, kept=(rows < 224) | (rows > 232))
    assert recording.pressure_pa is not None
    path = measured_path(recording, 0.05 * recording.pressure_pa)
    assert isinstance(path, MeasuredPath)
    assert path.breaks_s.size == 0
    at_s = np.linspace(0.1, 12.6, 5000)
    known = np.interp(at_s, *path.corners(np.zeros(1)))
    assert known == pytest.approx(0.05 * np.interp(at_s + _LATE_S, *answer), abs=_CLOSE * 5.0e3)


def test_a_noisy_gauge_is_read_from_its_own_rows() -> None:
    recording = _polled(_answer(0.1, 0.0, 2.0e5), noise_pa=100.0)
    assert recording.pressure_pa is not None
    assert answered_corners(recording, 0.05 * recording.pressure_pa) is None


def test_a_pressure_that_does_not_follow_its_command_is_read_from_its_own_rows() -> None:
    time_s, answer = _answer(0.1, 0.0, 2.0e5)
    recording = _polled((time_s, answer + 3.0e3 * np.sin(7.0 * time_s)))
    assert recording.pressure_pa is not None
    assert answered_corners(recording, 0.05 * recording.pressure_pa) is None
