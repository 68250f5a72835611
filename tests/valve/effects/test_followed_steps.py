"""Sub-steps of a sensor that lags or has play, and of bristles: as long as the stem goes evenly, and no longer."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt
import pytest

from valve.extended_motion import ExtendedStem
from valve.extended_state import ExtendedState
from valve.extended_valve import ExtendedValve, FrictionSlots, SensorPath
from valve.parameter_sets import parameter_set

# Two ramps, a reversal and a rest of a usual test; outputs as far apart as a fit's.
COURSE_S: Final = np.array([0.0, 6.0, 10.0, 11.0, 16.0])
COURSE_N: Final = np.array([0.0, 3200.0, 800.0, 800.0, 2900.0])
TIME_S: Final = np.arange(0.0, 16.0, 9.0e-3)
FINE_S: Final = 1.0e-3


def sensed(valve: ExtendedValve, longest_s: float) -> tuple[npt.NDArray[np.float64], int]:
    return ExtendedStem(valve, longest_step_s=longest_s).sensed(ExtendedState(), COURSE_S, COURSE_N, TIME_S)


@pytest.mark.parametrize("name", ["vendor", "nominal", "rough"])
@pytest.mark.parametrize(
    ("friction", "sensor", "off_m"),
    [
        (FrictionSlots(), SensorPath(lag_s=0.03), 1.0e-9),
        (FrictionSlots(presliding_m=1.0e-4), SensorPath(), 5.0e-7),
        (FrictionSlots(presliding_m=1.0e-3), SensorPath(lag_s=0.1), 5.0e-8),
    ],
    ids=["lag", "bristles", "bristles and lag"],
)
def test_long_sub_steps_of_an_even_motion_show_what_fine_ones_show(
    friction: FrictionSlots, sensor: SensorPath, off_m: float, name: str
) -> None:
    valve = ExtendedValve(parameter_set(name).parameters, friction=friction, sensor=sensor)
    fine_m, most = sensed(valve, FINE_S)
    found_m, passes = sensed(valve, 1.0e-2)
    assert np.abs(found_m - fine_m).max() < off_m
    # a vendor's stem hardly yields or rests: there is less to save
    assert passes < (1.01 if name == "vendor" and sensor.lag_s == 0.0 else 0.4) * most


@pytest.mark.parametrize("name", ["vendor", "nominal", "rough", "graphite"])
def test_play_is_followed_exactly_and_costs_no_sub_step(name: str) -> None:
    plain = ExtendedValve(parameter_set(name).parameters)
    play_m = 4.0e-4
    stem_m, passes = sensed(plain, 1.0e-2)
    found_m, own_passes = sensed(ExtendedValve(plain.parameters, sensor=SensorPath(play_m=play_m)), 1.0e-2)
    # between outputs this stem turns nowhere but at rest, so that they hold all that the lever follows
    lever_m, expected_m = stem_m[0], []
    for at_m in stem_m:
        lever_m = min(max(lever_m, at_m - 0.5 * play_m), at_m + 0.5 * play_m)
        expected_m.append(lever_m)
    assert own_passes == passes
    np.testing.assert_allclose(found_m, expected_m, rtol=0.0, atol=1.0e-12)
