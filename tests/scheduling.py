"""Which worker runs which file of tests: what waits for motions in real time has workers of its own beside the others.

Those hardly compute, so as many others as there are cores compute all the while. A further one that computes
would take the core that the analyses have, which stand back behind everything: their tests then last for minutes.
"""

from __future__ import annotations

from typing import Final

from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]
from xdist.workermanage import WorkerController  # type: ignore[import-untyped]

# They mostly wait; the first two folders compute a tenth of their time.
WAITING: Final = (
    "tests/drivers/",
    "tests/faults/",
    "tests/end_to_end/test_sticky.py",
    "tests/end_to_end/test_tutorial.py",
    "tests/end_to_end/test_gateways.py",
    "tests/service/access/test_stop_alone.py",
    "tests/service/mqtt/",
    "tests/service/test_durable_nights.py",
    "tests/service/test_http_protocol.py",
    "tests/service/test_reanalyses.py",
    "tests/service/test_stem_looks.py",
    "tests/service/test_wired.py",
)
# Half of their time is waiting: for a process, a browser, a database.
HALF_WAITING: Final = ("tests/service/", "tests/browser/", "tests/end_to_end/")
_WAITERS: Final = ("gw2", "gw3")  # beside two that compute
_WORKERS: Final = 3  # of fewer none stands aside


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
        if node.gateway.id in _WAITERS and len(self.nodes) >= _WORKERS:
            return next(iter((*waiting, *half)), None)
        computing = [file for file in self.workqueue if not file.startswith((*WAITING, *HALF_WAITING))]
        return next(iter((*computing, *half, *waiting)), None)
