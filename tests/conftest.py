"""For every test: lock files of buses in a folder of this process, so that tests side by side share no machine.

And one thread of linear algebra, set before numpy is loaded: on small matrices a second one only spins. Under several
workers tests/order.py says what runs beside what; ``--quick`` leaves out what tests/slow.txt names.
"""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import structlog

from drivers.motion.bus_lock import FOLDER_VARIABLE
from tests.order import WaitingBeside, give_way, is_slow

_locks = tempfile.TemporaryDirectory(prefix="breakaway-locks-")  # removed as the process ends
os.environ[FOLDER_VARIABLE] = _locks.name
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A traceback in colours and frames takes half a second, one as Python prints it nothing.
structlog.configure(
    processors=[
        *structlog.get_config()["processors"][:-1],
        structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback),
    ]
)


class _Unfit(logging.Handler):
    """Where a message's template does not fit its values a test fails; a service only logs it."""

    def emit(self, record: logging.LogRecord) -> None:
        raise AssertionError(record.getMessage())


logging.getLogger("valve.messages").addHandler(_Unfit())


@pytest.fixture
def quick_path(tmp_path: Path) -> Iterator[Path]:
    """Return a folder in memory where the machine has one: a busy disk is not what these tests measure."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        yield Path(folder)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add what ``make quick`` asks for."""
    parser.addoption("--quick", action="store_true", help="leave out the files that tests/slow.txt names")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let tests that only compute do so at a lower priority than those that wait."""
    if (own := getattr(item.config, "workerinput", None)) is not None:
        give_way(item.nodeid, own["workercount"])


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Not even import what is slow."""
    return True if config.getoption("quick") and is_slow(collection_path) else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> WaitingBeside | None:
    """Let workers from the third on run what waits, with ``--dist loadfile``."""
    return WaitingBeside(config, log) if config.getoption("dist") == "loadfile" else None
