"""The I/P of a polled test, fitted to its measured pressure."""

from __future__ import annotations

from estimators.likelihood.input_path import MeasuredPath, input_path
from tests.blind.cases import blind_case


def test_a_pressure_that_is_the_command_but_for_rounding_is_followed_as_measured() -> None:
    case = blind_case(7203, "polled")  # rounding alone, 1e-20 N2 in all, tells no lags apart: none was left before
    path = input_path(case.recordings[0], case.nameplate)
    assert isinstance(path, MeasuredPath)
