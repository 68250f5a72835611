"""A polled test that is ended because enough is known: as at its end, and a stop comes before it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from drivers.outcome import Ended, SampleBlock
from tests.support.played_device import LIMITS, SAFE_PA, Bench
from valve.errors import ConfigurationError
from valve.waveform import triangle

WAVE = triangle(2.0, 4, 10_000.0, 60_000.0)  # 8 s
TURN_S = 1.0
SLOW = replace(LIMITS, pressure_rate_pa_per_s=150_000.0)


async def test_a_test_that_knows_enough_completes_there_by_its_usual_ramp(bench: Bench) -> None:
    enough, blocks = asyncio.Event(), []

    def heard(block: SampleBlock) -> None:
        blocks.append(block)
        if block.time_s[-1] >= TURN_S:  # and amid the next block: its rows are handed on all the same
            asyncio.get_running_loop().call_later(0.05, enough.set)

    outcome = await bench.play(WAVE, limits=SLOW, enough=enough, on_samples=heard)
    assert (outcome.ended, outcome.safe_confirmed, outcome.error) == (Ended.COMPLETED, True, None)
    assert outcome.ended_early_s is not None
    assert TURN_S <= outcome.ended_early_s < 2.0  # on a machine with nothing else to do 1.1
    recording = outcome.recording
    assert recording is not None
    assert TURN_S <= recording.time_s[-1] <= outcome.ended_early_s
    assert np.array_equal(np.concatenate([block.time_s for block in blocks]), recording.time_s)
    assert [phase for _, phase in bench.phases][-3:] == ["returning", "at its safe value", "ended"]
    assert bench.device.output_pa == SAFE_PA
    assert bench.device.value("run_owner") == 0
    times_s, pressures_pa = np.array(bench.device.moves).T
    rise_pa, run_s = np.abs(np.diff(pressures_pa)), np.diff(times_s)
    assert (rise_pa <= 150_000.0 * (run_s + 0.03) + 1.0).all()
    # about 53 kPa back at 150 kPa/s, from where it stood
    falling = np.flatnonzero(pressures_pa == pressures_pa.max())[-1]
    assert pressures_pa[falling] > 0.8 * 60_000.0
    assert times_s[-1] - times_s[falling] > 0.25


async def test_a_stop_at_the_moment_in_which_enough_is_known_wins(bench: Bench) -> None:
    enough = asyncio.Event()

    def heard(block: SampleBlock) -> None:
        if block.time_s[-1] >= TURN_S:
            enough.set()
            bench.stop.set()

    outcome = await bench.play(WAVE, limits=SLOW, enough=enough, on_samples=heard)
    assert (outcome.ended, outcome.safe_confirmed, outcome.ended_early_s) == (Ended.STOPPED, True, None)
    assert "returning" not in [phase for _, phase in bench.phases]
    assert bench.device.output_pa == SAFE_PA


async def test_a_stop_on_the_way_back_of_a_test_that_knows_enough_is_a_stop(bench: Bench) -> None:
    enough = asyncio.Event()
    enough.set()
    bench.on_phase = lambda phase: bench.stop.set() if phase == "returning" else None
    outcome = await bench.play(WAVE, limits=SLOW, enough=enough)
    assert (outcome.ended, outcome.safe_confirmed, outcome.ended_early_s) == (Ended.STOPPED, True, None)
    assert bench.device.output_pa == SAFE_PA


async def test_a_test_that_never_knows_enough_is_played_to_its_end(bench: Bench) -> None:
    enough = asyncio.Event()
    bench.on_phase = lambda phase: enough.set() if phase == "returning" else None  # too late to save anything
    outcome = await bench.play(triangle(0.5, 1, 10_000.0, 60_000.0), enough=enough)
    assert (outcome.ended, outcome.ended_early_s) == (Ended.COMPLETED, None)
    assert outcome.recording is not None
    assert outcome.recording.time_s[-1] == pytest.approx(0.5, abs=0.05)


async def test_a_device_that_plays_by_itself_is_not_moved_where_enough_may_end_it(bench: Bench) -> None:
    with pytest.raises(ConfigurationError, match=r"acquisition.mode = polled"):
        await bench.play(mode="captured", period_s=0.001, enough=asyncio.Event())
    assert bench.device.slave.requests == []
