from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from simulator.sensor import Sensor, noise, noise_of_one
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
