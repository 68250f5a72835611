"""For every test: lock files of buses in a folder of this process, so that tests side by side share no machine.

And one thread of linear algebra, set before numpy is loaded: on small matrices a second one only spins. With
``--dist loadfile`` tests that wait run beside those that compute (tests/scheduling.py).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.motion.bus_lock import FOLDER_VARIABLE
from tests.scheduling import WaitingBeside

_locks = tempfile.TemporaryDirectory(prefix="breakaway-locks-")  # removed as the process ends
os.environ[FOLDER_VARIABLE] = _locks.name
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture
def quick_path(tmp_path: Path) -> Iterator[Path]:
    """Return a folder in memory where the machine has one: a busy disk is not what these tests measure."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> WaitingBeside | None:
    """Let workers from the third on run what waits; see tests/scheduling.py."""
    return WaitingBeside(config, log) if config.getoption("dist") == "loadfile" else None
