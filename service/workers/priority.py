"""What works beside the service: of lower priority, as sampling must not wait, and ended when the service ends."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from typing import Final

ANALYSIS: Final = 10  # niceness: beside a busy service a tenth of a core is left to it, of a free core all
UPLOAD: Final = 19  # beside an analysis of a real test an eighth
AWAITED: Final = 5  # a third: somebody looks at a page until its pictures are there
_PR_SET_PDEATHSIG: Final = 1  # prctl(2)


def stand_back() -> None:
    """Lower the priority of this process, which makes what somebody waits for, before it loads anything."""
    end_with_parent()
    os.nice(AWAITED)


def end_with_parent() -> None:
    """Let this process end as soon as the one that started it does, also where that is killed amid its work.

    What a terminal or a service manager sends to the whole group is left to that one: it decides when this ends.
    """
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    if sys.platform != "linux":
        return
    parent = os.getppid()
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended in between
        os.kill(os.getpid(), signal.SIGKILL)
