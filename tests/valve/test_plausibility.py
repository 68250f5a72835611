"""Values that a recording of this valve cannot have are refused with a remedy that fits."""

from __future__ import annotations

import numpy as np
import pytest

from valve.errors import RecordingError
from valve.parameter_sets import PARAMETER_SETS
from valve.plausibility import require_moving_input, require_plausible_position, require_plausible_pressure
from valve.recording import FloatArray
from valve.recording_files import recording_from_bytes

NAMEPLATE = PARAMETER_SETS["nominal"].nameplate
SWEEP = 0.5 - 0.5 * np.cos(np.linspace(0.0, 12.0, 1000))
STROKE_M: FloatArray = 0.07 * SWEEP
STILL_PA: FloatArray = 3.0e4 + np.random.default_rng(2).normal(0.0, 15.0, SWEEP.size)


@pytest.mark.parametrize("stand_in", [9999.0, -32768.0, 1.0e300])
def test_numbers_that_stand_for_no_value_are_no_wrong_unit(stand_in: float) -> None:
    position_m = STROKE_M.copy()
    position_m[[40, 41, 700]] = stand_in
    position_m[10] = np.nan
    with pytest.raises(RecordingError, match=r"row 41, column position_m: .* all but 3 values .*leave the cell empty"):
        require_plausible_position(position_m, NAMEPLATE, "a.csv")
    pressure_pa = 8.0e4 * SWEEP
    pressure_pa[5] = 1.0e30
    with pytest.raises(RecordingError, match=r"row 6, column pressure_pa: .*leave the cell empty"):
        require_plausible_pressure("pressure_pa", pressure_pa, STROKE_M, NAMEPLATE, "a.csv")
    with pytest.raises(RecordingError, match="looks like millimetres"):
        require_plausible_position(1.0e3 * STROKE_M, NAMEPLATE, "a.csv")
    seldom_m = np.where(np.arange(STROKE_M.size) > 0.97 * STROKE_M.size, 1.0e3 * STROKE_M, 0.0)
    with pytest.raises(RecordingError, match="write it in metres"):
        require_plausible_position(seldom_m, NAMEPLATE, "a.csv")


@pytest.mark.parametrize(
    ("position_m", "says"),
    [
        (100.0 * STROKE_M, "it looks like inches or centimetres: write it in metres"),
        (0.7 * SWEEP, "it looks like a share of travel: write it in metres"),
        (0.5 + STROKE_M, "or subtract what it reads with the valve closed, or correct"),
    ],
)
def test_a_position_in_another_unit_or_from_another_zero_is_told_so(position_m: FloatArray, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        require_plausible_position(position_m, NAMEPLATE, "a.csv")


def test_a_stem_that_goes_while_no_input_does_is_refused() -> None:
    said = "pressure_pa stays within .* while the stem goes .* record the pressure that moves the stem"
    with pytest.raises(RecordingError, match=said):
        require_moving_input({"pressure_pa": STILL_PA}, STROKE_M, NAMEPLATE, "a.csv")
    rows = "\n".join(f"{0.01 * row},{STILL_PA[row]},{STROKE_M[row]}" for row in range(STROKE_M.size))
    with pytest.raises(RecordingError, match=said):
        recording_from_bytes(f"time_s,pressure_pa,position_m\n{rows}\n".encode(), "a.csv", NAMEPLATE)


def test_a_stem_that_rests_or_that_one_input_moves_is_read() -> None:
    moving_pa = 8.0e4 * SWEEP
    require_moving_input({"pressure_pa": STILL_PA}, 0.01 * STROKE_M, NAMEPLATE, "a.csv")
    require_moving_input({"pressure_pa": STILL_PA, "command_pa": moving_pa}, STROKE_M, NAMEPLATE, "a.csv")
    require_moving_input({"pressure_pa": 0.05 * moving_pa}, STROKE_M, NAMEPLATE, "a.csv")
    require_moving_input({}, STROKE_M, NAMEPLATE, "a.csv")
    require_moving_input({"pressure_pa": np.full_like(STROKE_M, np.nan)}, 0.0 * STROKE_M, NAMEPLATE, "a.csv")


def test_a_channel_that_is_needed_is_not_to_be_removed() -> None:
    with pytest.raises(RecordingError, match=r"position_m holds no value, give its samples$"):
        recording_from_bytes(b"time_s,pressure_pa,position_m\n0,1,\n1,2,\n", "a.csv")
    with pytest.raises(RecordingError, match="rename it or leave it out"):
        recording_from_bytes(b"time_s,pressure_pa,position_m,temperature_c\n0,1,2,3\n", "a.csv")
