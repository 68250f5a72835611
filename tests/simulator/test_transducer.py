from __future__ import annotations

import numpy as np
import pytest

from simulator.plant import SoftwareValve
from simulator.transducer import CHORD_ERROR_PA, Transducer, lagged, limited, value_at
from tests.support.simulated_plants import valve
from valve.errors import ParameterError


def pressures(settings: Transducer, ask: list[tuple[float, float]], looks_s: list[float]) -> list[float]:
    """Actuator pressures at the looks; each command is (time, pressure)."""
    software = SoftwareValve(valve(transducer=settings))
    found = []
    for at_s, what in sorted([(t, p) for t, p in ask] + [(t, None) for t in looks_s], key=lambda pair: pair[0]):
        software.look(at_s)
        if what is None:
            found.append(software.pressure_pa)
        else:
            software.ask(what)
    return found


def test_a_step_is_followed_with_the_lags_exponential_however_often_somebody_looks() -> None:
    settings = Transducer((0.0, 1.0e5), lag_s=0.8, dac_bits=24)
    looks_s = list(np.linspace(1.01, 9.0, 173))
    found = np.array(pressures(settings, [(1.0, 6.0e4)], looks_s))
    exact = 6.0e4 * (1.0 - np.exp(-(np.array(looks_s) - 1.0) / 0.8))
    assert np.abs(found - exact).max() < 0.01


def test_a_ramp_is_followed_with_the_lags_closed_form_between_the_corners_too() -> None:
    time_s, target_pa = np.array([0.0, 10.0, 20.0]), np.array([0.0, 8.0e4, 0.0])
    corners_s, lagged_pa = lagged(time_s, target_pa, 0.0, 0.93)
    wanted_s = np.linspace(0.0, 20.0, 200_001)
    rate, lag_s = 8.0e3, 0.93
    up = rate * (wanted_s - lag_s + lag_s * np.exp(-wanted_s / lag_s))
    top = rate * (10.0 - lag_s + lag_s * np.exp(-10.0 / lag_s))
    after = wanted_s - 10.0
    down = 8.0e4 - rate * (after - lag_s) + (top - 8.0e4 - rate * lag_s) * np.exp(-after / lag_s)
    exact = np.where(wanted_s <= 10.0, up, down)
    error = np.abs(value_at(corners_s, lagged_pa, wanted_s) - exact)
    assert error.max() <= CHORD_ERROR_PA
    assert error.max() > CHORD_ERROR_PA / 20.0  # the corners are not wastefully close
    assert corners_s.size < 2000


@pytest.mark.parametrize("duration_s", [0.001, 0.3, 5.0, 60.0, 4000.0])
def test_the_chords_of_a_full_step_keep_their_error_at_any_length(duration_s: float) -> None:
    corners_s, lagged_pa = lagged(np.array([0.0, duration_s]), np.full(2, 82737.0), 0.0, 0.5)
    wanted_s = np.concatenate([np.linspace(0.0, duration_s, 100_001), np.linspace(0.0, min(duration_s, 10.0), 100_001)])
    exact = 82737.0 * (1.0 - np.exp(-wanted_s / 0.5))
    assert np.abs(value_at(corners_s, lagged_pa, wanted_s) - exact).max() <= CHORD_ERROR_PA
    assert corners_s[-1] == duration_s


def test_dead_time_delays_the_pressure_and_nothing_else() -> None:
    settings = Transducer((0.0, 1.0e5), dead_time_s=0.25, dac_bits=24)
    found = pressures(settings, [(1.0, 5.0e4), (1.1, 3.0e4)], [1.2499, 1.2501, 1.3499, 1.3501])
    assert found == pytest.approx([0.0, 5.0e4, 5.0e4, 3.0e4], abs=0.01)


def test_the_supply_limits_the_pressure_and_a_corner_marks_where() -> None:
    time_s, asked_pa = limited(np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0e5, 0.0]), 6.0e4)
    assert time_s == pytest.approx([0.0, 6.0, 10.0, 14.0, 20.0])
    assert asked_pa == pytest.approx([0.0, 6.0e4, 6.0e4, 6.0e4, 0.0])
    settings = Transducer((0.0, 1.0e5), supply_pa=6.0e4, lag_s=0.1)
    assert pressures(settings, [(0.0, 1.0e5)], [5.0]) == pytest.approx([6.0e4], abs=0.01)


def test_the_output_has_as_many_levels_as_its_converter() -> None:
    settings = Transducer((0.0, 82737.0), dac_bits=8)
    levels = np.unique(settings.quantised(np.linspace(-1000.0, 90000.0, 100_000)))
    assert levels.size == 256
    assert levels[[0, -1]] == pytest.approx([0.0, 82737.0])
    assert [settings.level(p) for p in (-5.0, 1000.0, 41000.0, 9e4)] == pytest.approx(
        settings.quantised(np.array([-5.0, 1000.0, 41000.0, 9e4]))
    )
    assert np.diff(levels) == pytest.approx(np.full(255, settings.resolution_pa))
    assert pressures(settings, [(0.0, 1000.0)], [1.0]) == pytest.approx([3 * settings.resolution_pa])


@pytest.mark.parametrize(
    "wrong",
    [{"lag_s": -1.0}, {"dead_time_s": float("nan")}, {"supply_pa": 0.0}, {"dac_bits": 2}, {"range_pa": (1.0, 1.0)}],
)
def test_a_transducer_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        Transducer(**{"range_pa": (0.0, 1.0e5), **wrong})  # type: ignore[arg-type]  # the wrong value is the test
