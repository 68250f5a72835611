"""The fewest pieces that a noisy channel allows."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.likelihood.lines import pieces
from estimators.samples import FloatArray, IntArray


@pytest.mark.parametrize("times", [0, 1, 2, 3, 7, 8, 20])
def test_noise_that_asks_for_too_many_pieces_is_raised_no_further_than_it_takes_and_in_few_tries(
    times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # what a converter's steps leave between two of them looks like no noise: 20 tries of all pieces took 2 s
    tried: list[float] = []

    def edges(_time_s: FloatArray, _value: FloatArray, noise: float, _price: float) -> IntArray:
        tried.append(noise)
        return np.arange(5 if noise > 0.99 * 2.0 * 1.5**times else 1701)

    monkeypatch.setattr(pieces, "_edges", edges)
    noise, found = pieces._few_enough(np.zeros(1), np.zeros(1), 2.0, 1.0, 800)
    assert noise == pytest.approx(2.0 * 1.5**times)
    assert found.size == 5
    assert len(tried) <= min(times + 3, 11)
