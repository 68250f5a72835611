"""Runs as a store has them, and what drives them in tests."""

from __future__ import annotations

import numpy as np

from drivers.outcome import SampleBlock
from service.config.plant import Plant
from service.model.run import Run, RunState, new_run_id
from service.runs.service import Runs
from service.store.store import Store
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import motion_on


def runs_of(plant: Plant, store: Store, rig: FakeRig) -> Runs:
    return Runs(plant, store, motion_on(plant, rig, folder=store.folder), FakeAnalyst(), software="breakaway 0")


def stored(state: RunState) -> Run:
    return Run(id=new_run_id(), valve="FV-101", sequence="triangle", state=state)


def block(count: int) -> SampleBlock:
    time_s = np.linspace(0.0, 1.0, count)
    channel = np.full(count, 1.0)
    return SampleBlock(time_s, 0.001 * channel, channel, channel, time_s, time_s, recorded=True)
