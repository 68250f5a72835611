"""The signals that end a command: a closed terminal and a service manager want the same as Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from typing import Final

ENDING_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


@contextlib.contextmanager
def signals_held_back() -> Iterator[None]:
    """Let a signal that comes meanwhile end the command only once the block is done, as KeyboardInterrupt.

    For a request whose answer says what must be ended: without it nobody could.
    """
    noted: list[int] = []
    former = {number: signal.signal(number, lambda one, _frame: noted.append(one)) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
    if noted:
        raise KeyboardInterrupt


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let each of these signals end what runs inside as Ctrl-C does: by KeyboardInterrupt, also in the background."""
    former = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in ENDING_SIGNALS[1:]:
        signal.signal(number, lambda _number, _frame: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
