"""The live view on a slow tablet: frames a second that the browser draws while a valve moves, its CPU slowed down."""

from __future__ import annotations

import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from rich.table import Table

from tests.support.gateway import Gateway, gateway
from tests.support.tablets import LANDSCAPE, PORTRAIT, Tablet, tablet
from tests.support.wired_plant import TAG

ASKED_FRAMES_PER_S: Final = 50.0
_SLOWED: Final = 6
_WINDOW_S: Final = 3.0
_TESTS: Final = 6
_MOTION: Final = {"sequence": "triangle", "overrides": {"period_s": 4.0, "cycles": 2}}
_COUNT: Final = (
    "window.drawnAt = []; const count = (at) => { window.drawnAt.push(at); requestAnimationFrame(count); }; "
    "requestAnimationFrame(count);"
)


def run(tests: int | None = None) -> Table:
    """Watch so many tests in each direction of the tablet; one window a test."""
    table = Table(
        title=f"Live view on a CPU slowed down {_SLOWED} times, windows of {_WINDOW_S:g} s",
        caption=f"asked: {ASKED_FRAMES_PER_S:g} frames/s; Chromium draws by the processor, beside service and device",
    )
    for heading in (
        "tablet",
        "windows",
        "frames/s, least",
        "median",
        "most",
        "longest wait for a frame, ms",
        "heap, MB",
    ):
        table.add_column(heading, justify="left" if heading == "tablet" else "right")
    with tempfile.TemporaryDirectory() as folder, gateway(Path(folder)) as service, tablet() as one:
        for size in (LANDSCAPE, PORTRAIT):
            one.turn(size)
            windows, heap = [], 0.0
            for _ in range(tests or _TESTS):
                windows.append(_watched(service, one))
                heap = max(heap, 1e-6 * float(one.run("return performance.memory.usedJSHeapSize")))
            rates = [1e3 * (len(frames) - 1) / (frames[-1] - frames[0]) for frames in windows]
            longest_ms = max(later - former for frames in windows for former, later in pairwise(frames))
            figures = (min(rates), float(np.median(rates)), max(rates), longest_ms)
            table.add_row(
                "x".join(str(side) for side in size), str(len(rates)), *(f"{one:.1f}" for one in figures), f"{heap:.1f}"
            )
    return table


def _watched(service: Gateway, one: Tablet) -> list[float]:
    """Return the instants, ms, of the frames in a window of one test that the tablet shows."""
    one.open(service.url)  # script and style are here then: a motion is short
    answer = service.client.post("/tests/run", json={"valve": TAG, **_MOTION}).raise_for_status()
    test_id = answer.json()["id"]
    one.open(f"{service.url}/ui/tests/{test_id}")
    one.until_reads("#phase", "Moving")
    one.driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": _SLOWED})
    try:
        one.run(_COUNT)
        began_points = int(one.see("#live").get_attribute("data-points") or 0)
        time.sleep(_WINDOW_S)  # nothing is asked of the browser meanwhile
        frames = [float(at) for at in one.run("return window.drawnAt")]
        came = int(one.see("#live").get_attribute("data-points") or 0) - began_points
    finally:
        one.driver.execute_cdp_cmd("Emulation.setCPUThrottlingRate", {"rate": 1})
    service.client.get(f"/tests/{test_id}/events")  # it ends when the test has
    if came < _WINDOW_S * 8.0:
        raise RuntimeError(f"only {came} positions came in {_WINDOW_S:g} s: there was nothing to draw")
    return frames
