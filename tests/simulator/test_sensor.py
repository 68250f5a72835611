from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from simulator.sensor import DropOut, Sensor, coloured_noise, noise, noise_of_one
from valve.errors import ParameterError


def test_the_same_seed_and_sample_give_the_same_reading_in_any_order_and_company() -> None:
    sensor = Sensor((0.0, 0.1), noise_rms=1.0e-4, seed=7)
    together = sensor.readings(np.full(1000, 0.05), 400)
    alone = [sensor.reading(0.05, 400 + i) for i in reversed(range(1000))][::-1]
    assert together == pytest.approx(alone, abs=1.0e-12)
    assert not np.array_equal(together, Sensor((0.0, 0.1), noise_rms=1.0e-4, seed=8).readings(np.full(1000, 0.05), 400))
    assert [noise_of_one(3, i) for i in range(50)] == pytest.approx(noise(3, np.arange(50)), abs=1.0e-12)


def test_the_noise_is_normal_and_its_neighbours_are_independent() -> None:
    values = noise(11, np.arange(200_000))
    assert stats.kstest(values, "norm").pvalue > 0.01
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.01
    assert abs(np.corrcoef(values, noise(12, np.arange(200_000)))[0, 1]) < 0.01


def test_a_16_bit_reading_is_one_of_65535_codes_and_the_nearest() -> None:
    sensor = Sensor((-0.01, 0.12))
    true = np.linspace(-0.01, 0.12, 50_000)
    readings = sensor.readings(true, 0)
    assert np.abs(readings - true).max() <= sensor.resolution / 2 * (1 + 1e-9)
    codes = (readings + 0.01) / sensor.resolution
    assert np.abs(codes - np.rint(codes)).max() < 1e-6
    assert sensor.resolution == pytest.approx(0.13 / 65534)


def test_a_reading_beyond_the_range_stays_at_its_end_and_nan_stays_nan() -> None:
    sensor = Sensor((0.0, 0.1))
    assert sensor.readings(np.array([-1.0, 5.0, math.nan]), 0) == pytest.approx([0.0, 0.1, math.nan], nan_ok=True)
    assert math.isnan(sensor.reading(math.nan, 0))
    assert sensor.reading(5.0, 0) == pytest.approx(0.1)


def test_a_sensor_that_cannot_be_is_refused() -> None:
    for span, rms, bits in (((1.0, 0.0), 0.0, 16), ((0.0, 1.0), -1.0, 16), ((0.0, 1.0), 0.0, 1)):
        with pytest.raises(ParameterError):
            Sensor(span, rms, bits)


def test_coloured_noise_is_first_order_and_the_same_for_a_time_however_it_is_asked_for() -> None:
    times_s = np.arange(200_000, dtype=np.float64) * 0.01
    drawn = coloured_noise(3, 0.05, times_s)
    assert drawn.std() == pytest.approx(1.0, abs=0.03)
    assert abs(drawn.mean()) < 0.03
    for late in (1, 5, 15):
        assert np.mean(drawn[late:] * drawn[:-late]) == pytest.approx(math.exp(-0.2 * late), abs=0.03)
    for row in (0, 17, 199_999):
        assert coloured_noise(3, 0.05, times_s[row : row + 1])[0] == pytest.approx(drawn[row], abs=2.0e-3)
    assert np.corrcoef(drawn, coloured_noise(4, 0.05, times_s))[0, 1] == pytest.approx(0.0, abs=0.02)


def test_a_reading_has_its_white_and_coloured_noise_and_its_hum() -> None:
    times_s = np.arange(100_000, dtype=np.float64) * 1.0e-3
    still = np.full(times_s.size, 0.05)
    sensor = Sensor((0.0, 0.1), 2.0e-5, 24, 1, coloured_rms=1.0e-5, coloured_s=0.02, hum_rms=3.0e-5, hum_hz=50.0)
    errors = sensor.readings(still, 0, times_s) - 0.05
    hum = 2.0 * np.abs(np.mean(errors * np.exp(-2.0j * np.pi * 50.0 * times_s)))
    assert hum == pytest.approx(math.sqrt(2.0) * 3.0e-5, rel=0.02)
    assert errors.std() == pytest.approx(math.sqrt(2.0**2 + 1.0 + 3.0**2) * 1.0e-5, rel=0.02)
    quiet = Sensor((0.0, 0.1), 0.0, 24, 1, coloured_rms=1.0e-5, coloured_s=0.02)
    colour = quiet.readings(still, 0, times_s) - 0.05
    assert np.mean(colour[20:] * colour[:-20]) / colour.var() == pytest.approx(math.exp(-1.0), abs=0.05)


def test_one_reading_is_that_of_many() -> None:
    sensor = Sensor(
        (0.0, 0.1), 2.0e-5, 14, 9, coloured_rms=1.0e-5, hum_rms=3.0e-5, dropouts_per_s=2.0, dropout_to=DropOut.LOW
    )
    times_s, true = np.arange(4000, dtype=np.float64) * 1.0e-3, np.linspace(0.02, 0.06, 4000)
    many = sensor.readings(true, 100, times_s)
    lost = sensor.is_lost(times_s)
    assert 0 < np.count_nonzero(lost) < 1500
    for row in (*range(0, 4000, 97), int(lost.argmax())):
        assert sensor.reading(float(true[row]), 100 + row, float(times_s[row])) == pytest.approx(
            many[row], abs=sensor.resolution * 1.01
        )


@pytest.mark.parametrize(("shown", "expected"), [("zero", 0.0), ("low", -0.01), ("gap", math.nan)])
def test_a_lost_signal_shows_what_it_is_set_to_as_often_and_as_long_as_asked(shown: str, expected: float) -> None:
    sensor = Sensor((-0.01, 0.1), seed=2, dropouts_per_s=0.5, dropout_s=0.04, dropout_to=DropOut(shown))
    times_s = np.arange(400_000, dtype=np.float64) * 1.0e-3
    readings = sensor.readings(np.full(times_s.size, 0.05), 0, times_s)
    lost = readings < 0.01 if shown != "gap" else np.isnan(readings)
    assert np.count_nonzero(lost) / times_s.size == pytest.approx(0.02, rel=0.3)
    assert readings[lost][0] == pytest.approx(expected, nan_ok=True)
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate(([0], lost.astype(int), [0])))))[::2]
    assert abs(runs.min() - 40) <= 1  # rows of 1 ms
    assert (np.abs(readings[~lost] - 0.05) < 1.0e-4).all()


def test_a_sensor_with_a_clock_of_its_own_is_late_and_later() -> None:
    sensor = Sensor((0.0, 0.1), delay_s=0.004, rate_ppm=100.0)
    times_s = np.array([5.0, 10.0, 65.0])
    assert times_s - sensor.taken_s(times_s, 5.0) == pytest.approx([0.004, 0.0045, 0.010])


def test_a_held_reading_keeps_its_value_and_its_noise() -> None:
    sensor = Sensor((0.0, 0.1), 1.0e-4, 24, 7, refresh_s=0.05)
    times_s = np.arange(2000, dtype=np.float64) * 0.01
    taken_s = sensor.taken_s(times_s, 0.0)
    assert np.unique(np.round(taken_s, 9)).size == pytest.approx(401, abs=1)
    assert ((times_s - taken_s) >= -1.0e-12).all()
    assert ((times_s - taken_s) < 0.05 + 1.0e-9).all()
    readings = sensor.readings(0.05 + 1.0e-3 * taken_s, 0, taken_s)
    assert np.unique(readings).size == np.unique(np.round(taken_s, 9)).size
    assert np.std(readings - 0.05 - 1.0e-3 * taken_s) == pytest.approx(1.0e-4, rel=0.15)


@pytest.mark.parametrize(
    "changes",
    [{"filter_s": -1.0}, {"coloured_rms": math.nan}, {"delay_s": -0.1}, {"dropout_s": 0.0}, {"dropout_to": "noise"}],
)
def test_a_sensor_with_impossible_instruments_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(changes))):
        Sensor((0.0, 0.1), **changes)
