"""What a process does with its precedence, as a program of its own."""

from __future__ import annotations

import asyncio
import ctypes
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import uvloop

from drivers.motion.precedence import Precedence

_OF_A_CHILD = "import os; print(os.sched_getscheduler(0))"


def _policy(thread: int = 0) -> tuple[int, int]:
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(thread).sched_priority


async def _until(true: Callable[[], bool], within_s: float = 5.0) -> None:
    until_s = time.monotonic() + within_s
    while not true() and time.monotonic() < until_s:  # noqa: ASYNC110  # the system sets no event
        await asyncio.sleep(0.01)


async def _motion(precedence: Precedence) -> dict[str, Any]:
    """Policies of the loop, of two other threads, and of a child, in a motion and after it."""
    ended = threading.Event()
    threads = [threading.Thread(target=ended.wait) for _ in range(2)]
    threads[0].start()
    with precedence.motion():
        loop = _policy()
        threads[1].start()
        await _until(lambda: _policy(threads[1].native_id or 0)[0] == os.SCHED_RR)
        others = [_policy(thread.native_id or 0) for thread in threads]
        started = await asyncio.create_subprocess_exec(sys.executable, "-c", _OF_A_CHILD, stdout=subprocess.PIPE)
        child, _ = await started.communicate()
    at_once = _policy()
    await _until(lambda: _policy()[0] == os.SCHED_OTHER)
    after = [_policy(), *(_policy(thread.native_id or 0) for thread in threads)]
    ended.set()
    return {"loop": loop, "others": others, "child": int(child), "at_once": at_once, "after": after}


async def _spin(precedence: Precedence) -> dict[str, Any]:
    """How long a loop that never waits keeps its precedence, s, and whether it is there again once it turns."""
    with precedence.motion():
        began_s = time.monotonic()
        while _policy()[0] == os.SCHED_RR and time.monotonic() - began_s < 8.0:
            pass
        lasted_s = time.monotonic() - began_s
        await _until(lambda: _policy()[0] == os.SCHED_RR)
        await asyncio.sleep(0.0)
        again = _policy()[0] == os.SCHED_RR
    precedence.close()  # as the service does at its end
    return {"lasted_s": lasted_s, "again": again, "closed": _policy()[0] == os.SCHED_OTHER}


async def _refused(precedence: Precedence) -> dict[str, Any]:
    """Policy in a motion where the system refuses: root loses the capability, too."""
    with precedence.motion():
        return {"loop": _policy(), "allowed": precedence.allowed}


def main(what: str) -> None:
    """Say what was seen."""
    if what == "refused":
        ctypes.CDLL(None).prctl(24, 23, 0, 0, 0)  # CAP_SYS_NICE out of the bounding set: gone with the next program
        os.execv(sys.executable, [sys.executable, "-m", "tests.service.precedence_probe", "refused-now"])
    precedence = Precedence()
    precedence.try_once()
    seen = {"motion": _motion, "spin": _spin, "refused-now": _refused}[what]
    print(json.dumps({"allowed": precedence.allowed, **uvloop.run(seen(precedence))}))


if __name__ == "__main__":
    main(sys.argv[1])
