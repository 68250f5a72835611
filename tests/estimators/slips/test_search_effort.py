"""How much the slips' fit computes, in counts: no round for what is not worth one."""

from __future__ import annotations

from typing import Any

import pytest

from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.motion.recorded_motion import read_motion
from estimators.slips.kernel import normal_equations
from tests.estimators.recordings import recorded


class _Counted:
    """A function that counts its calls."""

    def __init__(self, function: Any) -> None:
        self.function, self.calls = function, 0

    def __call__(self, *arguments: Any) -> Any:
        self.calls += 1
        return self.function(*arguments)


def test_a_minimum_that_explains_nothing_and_one_that_is_reached_take_no_more_rounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted = _Counted(normal_equations)
    monkeypatch.setattr("estimators.slips.solution.normal_equations", counted)
    # a stem that slides at DV: the first of its fits, which takes none for sliding, ends far off
    test = recorded("graphite", noise_m=5.0e-6)
    motion = read_motion(test.recording, test.nameplate)
    found = [method.estimate_motion(motion) for method in (RegressionEstimator(), GarciaEstimator())]
    for estimate in found:
        for symbol in ("k", "F_v", "F_c", "DV"):
            value, error = estimate.parameters[symbol].value, estimate.parameters[symbol].std_error
            assert value is not None
            assert error is not None
            assert abs(value - test.truth.by_symbol()[symbol]) < 3.0 * error
    # 104 with rounds for trifles of a far-off minimum and with each slip's rest found anew
    assert counted.calls < 85
