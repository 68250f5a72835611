"""A pressure that ends below its command is the supply's only where the command goes on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter

from discrepancy.rough.causes.supply_saturation import SupplySaturation
from valve.recording import Recording

_SPAN_PA = 80.0e3


def _seen(command: npt.NDArray[np.float64], pressure: npt.NDArray[np.float64]) -> float | None:
    time_s = np.linspace(0.0, 1.0e-3 * (command.size - 1), command.size)
    recorded = Recording(time_s, np.zeros(command.size), _SPAN_PA * pressure, command_pa=_SPAN_PA * command)
    shown = SupplySaturation().seen_in(recorded)
    return None if shown is None else shown.fitted["limit_pa"].value


def test_a_pressure_that_stays_at_its_top_while_the_command_rises_is_limited() -> None:
    command = np.concatenate([np.linspace(0.0, 1.0, 1000), np.linspace(1.0, 0.0, 1000)])
    assert _seen(command, np.minimum(command, 0.95)) == pytest.approx(0.95 * _SPAN_PA, rel=1.0e-6)


@pytest.mark.parametrize(("noise", "is_seen"), [(0.0, True), (0.003, False)])
def test_a_quiet_pressure_shows_a_limit_that_takes_one_percent(noise: float, is_seen: bool) -> None:
    command = np.concatenate([np.linspace(0.0, 1.0, 3000), np.linspace(1.0, 0.0, 3000)])
    pressure = np.minimum(command, 0.99) + noise * np.random.default_rng(3).standard_normal(command.size)
    assert (_seen(command, pressure) is not None) is is_seen


def test_a_pressure_that_lags_and_turns_below_the_top_of_the_command_is_not_limited() -> None:
    # 0.06 s behind a triangle of 10 s: 0.6 % of the span below its top
    command = np.concatenate([np.linspace(0.0, 1.0, 10000), np.linspace(1.0, 0.0, 10000)])
    keep = np.exp(-1.0e-3 / 0.06)
    pressure = lfilter([1.0 - keep], [1.0, -keep], command)
    assert _seen(command, pressure) is None


def test_a_pressure_that_stays_short_of_a_command_that_is_held_is_not() -> None:
    # hysteresis of the I/P: it was told as the air supply's
    command = np.concatenate([np.linspace(0.0, 1.0, 1000), np.ones(300), np.linspace(1.0, 0.0, 1000)])
    rising = np.arange(command.size) < 1300
    pressure = command + np.where(rising, -0.015, 0.015) * (command > 0.5)
    assert _seen(command, np.minimum(pressure, 0.985)) is None
