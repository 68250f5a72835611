"""What the blind tests' own tests share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.bench.blind.oddities import Steps
from valve.recording import FloatArray


@pytest.fixture
def unmoved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases in which nothing moves: what is drawn and how it is written down, without the time to integrate."""

    def still(_valve: Any, _time: Any, _force: Any, duration_s: float, output_s: float, step_s: float) -> Any:
        return (np.zeros(round(duration_s / step_s) // round(output_s / step_s) + 1),) * 2

    def still_oddly(*arguments: Any) -> FloatArray:
        return np.zeros(arguments[-2] // arguments[-1] + 1)

    monkeypatch.setattr("tests.bench.blind.cases.STEPS", Steps(1.0e-3, 1.0e-3))
    monkeypatch.setattr("tests.bench.blind.plant.integrate", still)
    monkeypatch.setattr("tests.bench.blind.oddities.integrate_odd", still_oddly)
