"""A service as a process of its own, whose analyses are slow: python -m tests.service.reanalysis_process PLANT S LOG.

It notes in LOG when the analysis of a recording begins and when it has ended, and says on which port it listens.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from pathlib import Path
from typing import Any

from service.config.settings import load_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service


class _Slow(FakeAnalyst):
    """Takes ``duration_s`` and notes what it does."""

    def __init__(self, duration_s: float, log: Path) -> None:
        super().__init__()
        self._duration_s, self._log = duration_s, log

    async def analyze(self, recording_path: Path, *args: Any, **more: Any) -> dict[str, Any]:
        self._note("begun", recording_path)
        await asyncio.sleep(self._duration_s)
        answer = await super().analyze(recording_path, *args, **more)
        self._note("ended", recording_path)
        return answer

    def _note(self, what: str, recording_path: Path) -> None:
        with self._log.open("a", encoding="utf-8") as log:
            log.write(f"{what} {recording_path.stem}\n")


async def main(plant_file: Path, duration_s: float, log: Path) -> None:
    ended = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, ended.set)
    async with running_service(load_plant(plant_file), FakeRig(), _Slow(duration_s, log)) as client:
        print(client.base_url, flush=True)
        await ended.wait()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])))
