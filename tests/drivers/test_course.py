from __future__ import annotations

import numpy as np
import pytest

from drivers.course import Course
from valve.waveform import Waveform, steps, triangle


@pytest.mark.parametrize(
    "waveform",
    [
        triangle(7.0, 2, 12_345.678, 60_000.1),
        steps([10_000.0, 70_000.0, 33_333.3], 0.3),
        Waveform("steps", np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0]), np.array([5.0, 7.0, 7.0, 3.0, 4.0, 9.0])),
    ],
)
def test_what_is_commanded_at_one_time_is_what_the_waveform_has_there(waveform: Waveform) -> None:
    course = Course(waveform, 0.02)
    chance = np.random.default_rng(3)
    times_s = [*chance.uniform(-1.0, waveform.duration_s + 1.0, 300), *waveform.time_s.tolist()]
    assert [course.pressure_pa(time_s) for time_s in times_s] == [float(waveform.at(time_s)) for time_s in times_s]
    low_pa, high_pa = waveform.range_pa
    assert all(low_pa <= course.pressure_pa(time_s) <= high_pa for time_s in times_s)
