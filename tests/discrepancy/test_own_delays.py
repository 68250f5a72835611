"""The delay between a polled pressure and position is each recording's own, and says nothing of the valve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.baseline import baseline_unknowns
from discrepancy.gain import held_out_gain
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from tests.estimators.recordings import Recorded, recorded
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import sine, triangle

_NOISE_M = 5.0e-6
_SAID_S = 1.0e-3
_LATE_S = 1.0e-3  # that each pressure was read after its position; before it in the other recording
_PERIOD_S = 20.0e-3


def _polled(made: Recorded, late_s: float) -> Recording:
    recording = made.recording
    assert recording.pressure_pa is not None
    pressure_pa = np.interp(recording.time_s + late_s, recording.time_s, recording.pressure_pa)
    provenance = Provenance(Acquisition.POLLED, requested_period_s=_PERIOD_S, timing_uncertainty_s=_SAID_S)
    return replace(recording, pressure_pa=pressure_pa, provenance=provenance)


def _observed(recording: Recording, made: Recorded) -> Observed:
    observed = observe([recording], made.nameplate)
    assert isinstance(observed, Observed)
    return observed


@pytest.mark.parametrize("period_s", [0.998 * _PERIOD_S, _PERIOD_S, 1.002 * _PERIOD_S])
def test_what_rows_may_be_read_apart_is_fitted_whichever_side_of_the_usual_period_theirs_is(period_s: float) -> None:
    """At a twentieth of a period and no more it was fitted or not by the jitter: a lag of the position was named."""
    made = recorded("nominal", period_s=period_s, noise_m=_NOISE_M, waveform=triangle(12.0, 1, 0.0, 8.0e4))
    assert _observed(_polled(made, 0.0), made).delay is not None
    captured = Provenance(Acquisition.CAPTURED, requested_period_s=period_s)
    assert _observed(replace(made.recording, provenance=captured), made).delay is None


def test_a_prediction_is_not_told_another_recordings_delay() -> None:
    """Both models are the valve itself: the rows' noise is left, where the other delay left twice as much."""
    fitted = recorded("nominal", period_s=_PERIOD_S, waveform=triangle(12.0, 1, 0.0, 8.0e4))
    made = recorded("nominal", period_s=_PERIOD_S, noise_m=_NOISE_M, waveform=sine(8.0, 1, 0.0, 8.0e4))
    observed = _observed(_polled(fitted, -_LATE_S), fitted)
    unknowns = baseline_unknowns(observed, 2.0e-2, 1500.0)
    own = fitted.truth.by_symbol()
    values = {**own, "d": own["F_s"] / own["F_c"] - 1.0, "first_rise": 0.0, "x_0": 0.0, "delay_s": _LATE_S}
    fit: Fit = start_fit(Model(observed, unknowns), unknowns.point(values))
    gain = held_out_gain("sine", _polled(made, _LATE_S), made.nameplate, fit, fit)
    assert gain is not None
    assert gain.rmse_after_m < 1.1 * _NOISE_M
