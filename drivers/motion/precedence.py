"""Real-time precedence of this process: while a valve is polled from here, and where the system allows it.

A thread of ``SCHED_RR`` gets a core before everything that is not real-time (sched(7)), other programs and the analyses
among it. The event loop's thread comes first and the others of this process behind it: with none of it they would keep
the loop waiting, as whoever holds the interpreter's lock and gets no core holds it for long (benchmark ``load`` on two
busy cores: one sample in a thousand 32 ms late instead of 5). A thread that is started is ordinary until it is met
here, a process for ever (``SCHED_RESET_ON_FORK``). The system allows it by ``RLIMIT_RTPRIO`` (a unit's ``LimitRTPRIO``,
a container's ``ulimits``) or ``CAP_SYS_NICE``.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Final

import structlog

_LOG = structlog.get_logger(__name__)
LOOP: Final = 2  # of 1 to 99: before what is not real-time, behind most others that are
BESIDE: Final = 1
_LONGEST_SPIN_S: Final = 1.0  # a burst of the loop takes milliseconds; a device's watchdog waits longer as a rule
_RENEWED_S: Final = 0.05  # threads come and go; it takes 0.1 ms
_LINGERS_S: Final = 3.0  # recordings are put together and stored then: without, answers took up to 0.7 s (``load``)
_SUPPORTED: Final = sys.platform == "linux"


class Precedence:
    """Taken and given back by the event loop's thread, which must be the main one.

    A thread that works for a second without ever waiting loses it for all (``RLIMIT_RTTIME``); they get it back once
    the event loop turns. One that hangs leaves its core to whoever ends it.
    """

    def __init__(self) -> None:
        self._allowed = False
        self._spun = False
        self._renewing: asyncio.Task[None] | None = None
        self._ending: asyncio.TimerHandle | None = None
        self._motions = 0

    @contextlib.contextmanager
    def motion(self) -> Iterator[None]:
        """Have it while a motion that is polled goes on, and while others do that overlap with it."""
        self._motions += 1
        self.begin()
        try:
            yield
        finally:
            self._motions -= 1
            if not self._motions:
                self.end()

    @property
    def allowed(self) -> bool:
        """Whether the system allowed it when it was last asked."""
        return self._allowed

    def try_once(self) -> None:
        """Take it and give it back, so that the log says at the start whether it can be had."""
        if _SUPPORTED:
            signal.signal(signal.SIGXCPU, self._on_spin)
        self._take()
        self._give_back()
        if self._allowed:
            _LOG.info("polling has precedence", policy="SCHED_RR", priority=LOOP)
        else:
            _LOG.warning(
                "polling has no precedence: other work may make samples late",
                remedy=f"allow real-time scheduling: LimitRTPRIO={LOOP} in the unit, ulimits rtprio of the container",
            )

    def begin(self) -> None:
        """Take it until ``end``; where it is refused nothing changes. Called in the event loop."""
        if self._ending is not None:
            self._ending.cancel()
            self._ending = None
        self._take()
        if self._allowed and self._renewing is None:
            self._spun = False
            self._renewing = asyncio.get_running_loop().create_task(self._renew())

    def end(self) -> None:
        """Let every thread be as ordinary as before, a moment later."""
        if self._ending is None:
            self._ending = asyncio.get_running_loop().call_later(_LINGERS_S, self._end)

    def close(self) -> None:
        """Let every thread be ordinary at once: at its end a process no longer answers the signal of a spin."""
        if self._ending is not None:
            self._ending.cancel()
        self._end()

    def _end(self) -> None:
        self._ending = None
        if self._renewing is not None:
            self._renewing.cancel()
            self._renewing = None
            self._give_back()

    async def _renew(self) -> None:
        told = False
        while True:
            await asyncio.sleep(_RENEWED_S)
            self._take()
            if self._spun and not told:
                told = True  # a thread that goes on would fill the log
                _LOG.error("a thread kept its core for a second: polling had no precedence until the event loop turned")

    def _take(self) -> None:
        if not _SUPPORTED:
            return
        hard = resource.getrlimit(resource.RLIMIT_RTTIME)[1]
        spin_us = round(1e6 * _LONGEST_SPIN_S)
        # Set anew each time: the system puts it up by a second with each signal.
        soft = spin_us if hard == resource.RLIM_INFINITY else min(spin_us, hard)
        resource.setrlimit(resource.RLIMIT_RTTIME, (soft, hard))
        loop_thread = threading.main_thread().native_id
        try:
            for thread in _threads():
                _schedule(thread, os.SCHED_RR, LOOP if thread == loop_thread else BESIDE)
        except PermissionError:
            self._allowed = False
            self._give_back()
        else:
            self._allowed = True

    def _give_back(self) -> None:
        with contextlib.suppress(PermissionError):  # where it never was allowed
            for thread in _threads():
                _schedule(thread, os.SCHED_OTHER, 0)

    def _on_spin(self, _signal: int, _frame: FrameType | None) -> None:
        # Nothing is written here: it may have been in the middle of writing.
        self._spun = True
        self._give_back()


def _threads() -> list[int]:
    return [int(thread.name) for thread in Path("/proc/self/task").iterdir()]


def _schedule(thread: int, policy: int, priority: int) -> None:
    """Schedule a thread so, unless it is so already or has ended."""
    wanted = policy | os.SCHED_RESET_ON_FORK
    with contextlib.suppress(ProcessLookupError):
        if os.sched_getscheduler(thread) != wanted or os.sched_getparam(thread).sched_priority != priority:
            os.sched_setscheduler(thread, wanted, os.sched_param(priority))
