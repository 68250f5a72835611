"""A gauge's noise and converters of 16 bit: what the lines of the pressure leave unknown is no effect of the valve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.diagnose import Verdict, diagnose, explains
from discrepancy.line_errors import with_line_errors
from discrepancy.observed import Observed, observe
from discrepancy.significance import least_rms, noise_factor
from tests.discrepancy.hidden import AREA_M2, FULL_PA, Hidden, hidden, recorded_of
from valve.effects import EFFECTS, effect_from_values
from valve.waveform import sine

pytestmark = pytest.mark.long

GAUGE_PA = 60.0
STEPS = 2.0**16


def as_a_device_reads(case: Hidden, seed: int, gauge_pa: float = GAUGE_PA) -> Hidden:
    """Return the case with a noisy gauge, and both channels in steps of a converter."""
    recording = case.recording
    assert recording.pressure_pa is not None
    noise_pa = gauge_pa * np.random.default_rng(seed).standard_normal(recording.time_s.size)
    step_m, step_pa = case.nameplate.actuator.travel_m / STEPS, FULL_PA / STEPS
    return replace(
        case,
        recording=replace(
            recording,
            position_m=step_m * np.round(recording.position_m / step_m),
            pressure_pa=step_pa * np.round((recording.pressure_pa + noise_pa) / step_pa),
        ),
    )


@pytest.mark.parametrize(
    ("cause", "values"),
    [
        ("position_lag", {"lag_s": 0.06}),
        ("local_friction", {"rise_n": 427.0, "centre_m": 0.0508, "width_m": 0.002}),
    ],
)
def test_a_cause_is_named_in_what_a_device_reads(cause: str, values: dict[str, float]) -> None:
    case = as_a_device_reads(hidden("nominal", effect_from_values(cause, values), seed=4, noise_m=5.0e-6), seed=5)
    found = diagnose([case.recording], case.nameplate)
    assert found.verdict is Verdict.NAMED, found.message
    assert [finding.cause for finding in found.causes] == [cause]
    strength = EFFECTS[cause].parameters[0].name
    assert found.causes[0].parameters[strength].value == pytest.approx(values[strength], rel=0.02)


def test_the_lines_of_a_noisy_pressure_leave_nothing_that_hangs_together() -> None:
    case = as_a_device_reads(hidden("nominal", seed=4, noise_m=5.0e-6), seed=5, gauge_pa=5.0 * GAUGE_PA)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    fit = with_line_errors(plain)
    assert noise_factor(plain) > 10.0
    assert noise_factor(fit) < 1.2


def test_an_exact_pressure_is_left_as_it_is() -> None:
    case = hidden("nominal", seed=4)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed)
    assert fit is not None
    assert with_line_errors(fit) is fit
    assert observed.has_exact_force
    # a command is what was asked for, and no measured force
    assert not replace(observed, command_only=True).has_exact_force


def test_what_pieces_of_a_noisy_curve_lack_of_its_shape_is_noise() -> None:
    """A sine: its pieces are as long as the noise lets them be, and a healthy stem is off by what they lack."""
    case = hidden("vendor", seed=1, noise_m=5.0e-6)
    low_pa = case.valve.parameters.preload_n / AREA_M2
    recording = recorded_of(case.valve, sine(8.0, 4, low_pa, 0.9 * FULL_PA), 1.0e-3, 5.0e-6, seed=1)
    assert recording.pressure_pa is not None
    noise_pa = 15.0 * np.random.default_rng(51).standard_normal(recording.time_s.size)
    observed = observe([replace(recording, pressure_pa=recording.pressure_pa + noise_pa)], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    fit = with_line_errors(plain)
    assert explains(fit)
    assert not explains(
        replace(fit, model=replace(fit.model, observed=replace(fit.model.observed, unresolved_rms=0.0)))
    )
    # no more than the noise moves the stem by: 15 Pa come to 18 um a row, and a piece is the mean of some hundred
    assert least_rms(fit) < 0.3


def test_straight_lines_lack_nothing_of_their_shape() -> None:
    case = as_a_device_reads(hidden("nominal", seed=4, noise_m=5.0e-6), seed=5)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    assert observed.deviations
    assert not observed.has_exact_force
    assert observed.unresolved == 0.0
