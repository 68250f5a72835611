"""Which slots a polled test takes after a delay, by a clock that only the steps move."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from drivers import polled_play
from drivers.course import Course
from drivers.mover import Mover
from drivers.outcome import Sample, SampleBlock
from drivers.polled_play import PolledPlay
from valve.waveform import triangle

PERIOD_S = 0.02
WAVE = triangle(0.2, 1, 10_000.0, 60_000.0)


class SteppedMover:
    """Takes as long for each step as it is told, and no time for anything else."""

    def __init__(self, steps_s: list[float]) -> None:
        self.device = SimpleNamespace(in_force_pa=0.0)
        self.written = None
        self.now_s = 100.0
        self._steps_s = iter(steps_s)
        self.usual_s = 0.002

    def monotonic(self) -> float:
        return self.now_s

    async def pause_until(self, until_s: float) -> None:
        self.now_s = max(self.now_s, until_s)

    async def step(self, _pressure_pa: float) -> Sample:
        sent_s = self.now_s
        self.now_s += next(self._steps_s, self.usual_s)
        return Sample(sent_s, self.now_s, 0.01, 20_000.0, 20_000.0)

    async def glance(self) -> None:
        """Look, in no time."""


async def begun_s(monkeypatch: pytest.MonkeyPatch, mover: SteppedMover) -> tuple[np.ndarray, np.ndarray]:
    """Return when each sample began, from the start, and how long after its slot, s."""
    blocks: list[SampleBlock] = []
    monkeypatch.setattr(polled_play, "time", SimpleNamespace(monotonic=mover.monotonic))
    await PolledPlay(Course(WAVE, PERIOD_S), blocks.append, lambda _share: None).play(cast("Mover", mover))
    columns = [(block.sent_s, block.late_s) for block in blocks]
    return tuple(np.concatenate([column[place] for column in columns if column[place] is not None]) for place in (0, 1))  # type: ignore[return-value]


async def test_a_slot_that_began_during_a_delay_is_taken_while_a_sample_fits_in_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    began_s, late_s = await begun_s(monkeypatch, SteppedMover([0.002, 0.036]))  # ends 4 ms before slot 2 does
    assert began_s.size == 11
    np.testing.assert_allclose(began_s[:5], [0.0, 0.02, 0.056, 0.066, 0.08], atol=1.0e-9)
    np.testing.assert_allclose(late_s[:5], [0.0, 0.0, 0.016, 0.006, 0.0], atol=1.0e-9)


async def test_a_slot_that_is_over_before_a_sample_fits_in_it_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    began_s, _ = await begun_s(monkeypatch, SteppedMover([0.002, 0.039]))
    np.testing.assert_allclose(began_s[:4], [0.0, 0.02, 0.06, 0.08], atol=1.0e-9)


async def test_samples_after_a_delay_are_half_a_slot_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    began_s, _ = await begun_s(monkeypatch, SteppedMover([0.002, 0.037, 0.002, 0.035, 0.002, 0.002, 0.030]))
    assert np.diff(began_s).min() >= 0.5 * PERIOD_S - 1.0e-9


async def test_a_device_slower_than_a_slot_keeps_a_rhythm_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    mover = SteppedMover([])
    mover.usual_s = 0.035  # over in slot 1, of which a quarter is left: not enough for another
    began_s, late_s = await begun_s(monkeypatch, mover)
    np.testing.assert_allclose(np.diff(began_s), 2.0 * PERIOD_S, atol=1.0e-9)
    np.testing.assert_allclose(late_s, 0.0, atol=1.0e-9)
