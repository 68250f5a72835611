"""The I/P of a polled test, fitted to its measured pressure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from estimators.likelihood.inputs import commanded_path, transducer_fit
from estimators.likelihood.inputs.input_path import CommandedPath, MeasuredPath, input_path
from tests.blind.cases import blind_case
from tests.estimators.likelihood.polled_recordings import written_test


def test_a_pressure_that_is_the_command_but_for_rounding_is_followed_as_measured() -> None:
    case = blind_case(7203, "polled")  # rounding alone, 1e-20 N2 in all, tells no lags apart: none was left before
    path = input_path(case.recordings[0], case.nameplate)
    assert isinstance(path, MeasuredPath)


def test_all_who_ask_for_a_recordings_force_share_one_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    test, asked = written_test("nominal", 3, ramp_s=4.0, cycles=1), []
    fitted = transducer_fit.fit_transducer

    def counted(*given: Any) -> Any:
        asked.append(given)
        return fitted(*given)

    monkeypatch.setattr(commanded_path, "fit_transducer", counted)
    first = input_path(test.recording, test.nameplate)
    assert isinstance(first, CommandedPath)
    assert input_path(test.recording, replace(test.nameplate)) is first
    assert len(asked) == 1
    # other rows or another valve are another recording
    assert input_path(replace(test.recording), test.nameplate) is not first
    wide = replace(test.nameplate.actuator, diaphragm_area_m2=0.02)
    assert input_path(test.recording, replace(test.nameplate, actuator=wide)) is not first
    assert len(asked) == 3


def test_a_pressure_that_is_no_answer_to_the_command_is_not_weighed_at_length(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_given: Any) -> Any:
        pytest.fail("the likelihood of lags and delays was taken of a fit that leaves more than noise")

    monkeypatch.setattr(transducer_fit, "_likelihood", never)
    case = blind_case(7004, "polled")  # its pressure follows a smooth command, of which the rows are no writes
    assert isinstance(input_path(case.recordings[0], case.nameplate), MeasuredPath)
