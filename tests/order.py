"""Which worker runs which file of tests, and what ``make quick`` leaves out.

What waits for motions in real time has workers of its own beside the others, and hardly computes; as many others as
there are cores compute all the while. These have a lower priority: who keeps time, and a worker of a service, which
stands back itself, have a core when they need one.

xdist's ``xdist_group`` lays files on workers and does not say which wait (beside pytest 9.2 it has no effect at all,
pytest-xdist issue 1386): with files in turn on three workers the suite took 716 s, on four 618 s.
"""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]
from xdist.workermanage import WorkerController  # type: ignore[import-untyped]

_HERE: Final = Path(__file__).parent
# They mostly wait; the first two folders compute a tenth of their time.
WAITING: Final = (
    "tests/drivers/",
    "tests/bench/faults/",
    "tests/end_to_end/test_sticky.py",
    "tests/service/access/test_access_settings.py",
    "tests/service/access/test_stop_alone.py",
    "tests/service/mqtt/",
    "tests/service/test_worker_pool.py",
    "tests/service/test_analysis_process.py",
    "tests/service/test_durable_nights.py",
    "tests/service/test_http_protocol.py",
    "tests/service/test_motion_process.py",
    "tests/service/test_reanalyses.py",
    "tests/service/test_recovery.py",
    "tests/service/test_stem_looks.py",
    "tests/service/test_until.py",
    "tests/service/test_watched_process.py",
    "tests/service/test_wired.py",
)
# Half of their time is waiting: for a process, a browser, a database.
HALF_WAITING: Final = ("tests/service/", "tests/browser/", "tests/end_to_end/")
_COMPUTE: Final = ("gw0", "gw1")
_WORKERS: Final = 3  # of fewer none stands aside
_COMPUTING: Final = 10  # niceness: as that of a service's analyses


class WaitingBeside(LoadFileScheduling):  # type: ignore[misc]  # it has no types
    """Files in order, each on one worker: two workers compute, those from the third on take what waits.

    At the end the first two help with what waits; the others never take what only computes.
    """

    def _assign_work_unit(self, node: WorkerController) -> None:
        file = self._next_file(node)
        if file is None:
            node.shutdown()
            return
        self.workqueue.move_to_end(file, last=False)
        super()._assign_work_unit(node)

    def _next_file(self, node: WorkerController) -> str | None:
        waiting = [file for file in self.workqueue if file.startswith(WAITING)]
        half = [file for file in self.workqueue if file.startswith(HALF_WAITING) and file not in waiting]
        if node.gateway.id not in _COMPUTE and len(self.nodes) >= _WORKERS:
            return next(iter((*waiting, *half)), None)
        computing = [file for file in self.workqueue if not file.startswith((*WAITING, *HALF_WAITING))]
        return next(iter((*computing, *half, *waiting)), None)


def give_way(file: str, workers: int) -> None:
    """Lower the priority of this process for tests of a file that only compute, where others that wait run beside.

    For what waits it is as high as any again, where the system lets a process raise its own.
    """
    if workers >= _WORKERS:
        computes = not file.startswith((*WAITING, *HALF_WAITING))
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, _COMPUTING if computes else 0)


def _name(path: Path) -> str:
    return path.relative_to(_HERE).as_posix()


@cache
def slow() -> tuple[str, ...]:
    """Folders, with a stroke at their end, and files that take more than about two seconds of a core."""
    return tuple((_HERE / "slow.txt").read_text(encoding="utf-8").split())


def is_slow(path: Path) -> bool:
    """Whether a file or folder of tests is one of them."""
    if not path.is_relative_to(_HERE):
        return False
    return f"{_name(path)}{'/' if path.is_dir() else ''}" in slow()
