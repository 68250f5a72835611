"""Which motions count as polling: those that are sampled from here."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.addresses import Mode
from service.config.settings import Plant
from service.runs import wired_rig
from service.runs.rig import Order, Watcher
from service.runs.wired_rig import WiredRig
from service.workers.polling import Polling
from valve.errors import WireError
from valve.waveform import triangle


async def _nothing(*_: Any) -> None:
    return


@asynccontextmanager
async def _no_wires(*_: Any) -> AsyncIterator[SimpleNamespace]:
    yield SimpleNamespace(commanded=False)


@pytest.mark.parametrize("fails", [False, True])
async def test_a_polled_motion_counts_and_a_captured_one_does_not(
    plant: Plant, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    polling = Polling()
    seen: dict[Mode, bool] = {}

    async def played(*_: Any, mode: Mode, **__: Any) -> None:
        seen[mode] = polling.goes_on
        if fails:
            raise WireError("bus plc-1: no answer")

    monkeypatch.setattr(wired_rig, "play_sequence", played)
    monkeypatch.setattr(WiredRig, "_connected", _no_wires)
    rig = WiredRig(plant.buses, "test", polling)
    watcher = Watcher(_nothing, lambda _: None, lambda *_: None)
    for valve in (plant.valves["FV-101"], plant.valves["FV-102"]):
        playing = rig.play(Order(valve, triangle(1.0, 1, 0.0, 10_000.0), "triangle", 1), watcher, asyncio.Event())
        assert isinstance((await asyncio.gather(playing, return_exceptions=True))[0], WireError) is fails
    assert seen == {Mode.CAPTURED: False, Mode.POLLED: True}
    assert not polling.goes_on
