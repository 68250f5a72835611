"""Which motions take precedence: those that are sampled by requests."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.addresses import Mode
from drivers.motion import rig as rig_of_wires
from drivers.motion.orders import Order
from drivers.motion.rig import Watcher, WiredRig
from service.config.plant import Plant
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
    going: list[bool] = []
    seen: dict[Mode, bool] = {}

    async def played(*_: Any, mode: Mode, **__: Any) -> None:
        seen[mode] = bool(going)
        if fails:
            raise WireError("bus plc-1: no answer")

    monkeypatch.setattr(rig_of_wires, "play_sequence", played)
    monkeypatch.setattr(WiredRig, "_connected", _no_wires)

    @contextmanager
    def polled() -> Iterator[None]:
        going.append(True)
        try:
            yield
        finally:
            going.pop()

    rig = WiredRig(plant.buses, "test", polled)
    watcher = Watcher(_nothing, lambda _: None, lambda *_: None)
    for valve in (plant.valves["FV-101"], plant.valves["FV-102"]):
        order = Order("20261121T031502Z-9f3c01ab", "FV-101", triangle(1.0, 1, 0.0, 10_000.0), "triangle", 1)
        playing = rig.play(valve.wiring, order, watcher, asyncio.Event())
        assert isinstance((await asyncio.gather(playing, return_exceptions=True))[0], WireError) is fails
    assert seen == {Mode.CAPTURED: False, Mode.POLLED: True}
    assert going == []
