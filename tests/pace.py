"""How much slower a processor works for what other programs do beside it, told by a small piece of work of one's own.

Two cores that share their units or caches, or are taken away again and again, need up to twice the processor time for
the same work when both are busy. A piece of fixed work, done again and again in between, meets the same: what it takes
on average over what it takes undisturbed is how many times the processor time grew.
"""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Final

import numpy as np

_EVERY_S: Final = 0.2
_TABLE: Final = 997
_STEPS: Final = 12_000  # 2 ms: short enough to be left alone at times, long enough to be timed
_MATRIX: Final = np.random.default_rng(1).normal(size=(400, 12))


def _piece() -> None:
    counted: dict[int, int] = {}
    for step in range(_STEPS):
        counted[step % _TABLE] = counted.get(step % _TABLE, 0) + step * step % 7
    for _ in range(3):
        np.linalg.qr(_MATRIX)


class Pace:
    """Times the piece beside the work of the block; ``slowdown`` afterwards."""

    def __init__(self) -> None:
        self.pieces_s: list[float] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._go, daemon=True)

    def __enter__(self) -> Pace:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    @property
    def slowdown(self) -> float:
        """How many times the undisturbed processor time the piece took on average: 1 where nothing disturbed it."""
        return sum(self.pieces_s) / (len(self.pieces_s) * min(self.pieces_s))

    def _go(self) -> None:
        _piece()  # the first one loads what it needs
        while not self._over.wait(_EVERY_S):
            began_s = time.thread_time()
            _piece()
            self.pieces_s.append(time.thread_time() - began_s)
