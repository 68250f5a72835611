"""Sums of waves beside the plain table of all frequencies and instants, which takes a gigabyte for a stick-slip."""

from __future__ import annotations

import tracemalloc

import numpy as np

from discrepancy.waves import share_taken, wave_sums

TIME_S = np.sort(np.random.default_rng(1).uniform(0.0, 40.0, 90))
FREQUENCY_HZ = np.arange(0.3, 20.0, 1.0 / 320.0)
SENSE = np.where(np.arange(90) % 20 < 10, 1.0, -1.0)
BASE = np.column_stack([np.linspace(0.0, 0.03, 90), np.ones(90), SENSE])


def test_sums_are_those_of_the_whole_table() -> None:
    waves = np.exp(2.0j * np.pi * np.outer(FREQUENCY_HZ, TIME_S))
    assert np.abs(wave_sums(FREQUENCY_HZ, TIME_S, BASE) - waves @ BASE).max() < 1.0e-9


def test_a_wave_takes_what_a_fit_with_it_takes() -> None:
    noise_n = np.random.default_rng(2).normal(0.0, 3.0, 90)
    force_n = BASE @ np.array([5.0e4, 100.0, 700.0]) + 20.0 * np.sin(2.0 * np.pi * 7.3 * TIME_S + 0.4) + noise_n
    taken = share_taken(FREQUENCY_HZ, TIME_S, BASE, force_n)
    left_n = force_n - BASE @ np.linalg.lstsq(BASE, force_n)[0]
    for place in (0, 1, 700, int(np.argmax(taken)), FREQUENCY_HZ.size - 1):
        turn = 2.0 * np.pi * FREQUENCY_HZ[place] * TIME_S
        columns = np.column_stack([BASE, np.sin(turn), np.cos(turn)])
        rest_n = force_n - columns @ np.linalg.lstsq(columns, force_n)[0]
        assert abs(taken[place] - (1.0 - rest_n @ rest_n / (left_n @ left_n))) < 1.0e-9
    assert abs(FREQUENCY_HZ[np.argmax(taken)] - 7.3) < 0.01


def test_many_steps_of_a_long_test_take_little_memory() -> None:
    time_s = np.linspace(0.0, 140.0, 600)
    base = np.column_stack([time_s, np.ones(600)])
    frequency_hz = np.arange(0.3, 60.0, 1.0 / (8.0 * 140.0))
    tracemalloc.start()
    share_taken(frequency_hz, time_s, base, np.sin(40.0 * time_s))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 5.0e7  # the table of 67,000 by 600 alone is 3.2e8 bytes
