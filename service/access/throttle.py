"""Sign-ins that fail are slowed down: by name and address together, by name, and by address."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from service.model.refusals import ThrottledError
from valve.messages import say

WINDOW_S: Final = 900.0
MOST_BY_BOTH: Final = 5
MOST_BY_NAME: Final = 50  # higher: a stranger elsewhere must not lock somebody out by trying their name
MOST_BY_ADDRESS: Final = 30
_KEPT: Final = 10_000


class Throttle:
    """Failures of the last 15 minutes, in memory: a restart forgives."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._failures: OrderedDict[tuple[str, str], list[float]] = OrderedDict()

    def check(self, name: str, address: str) -> None:
        """Raise ThrottledError where this name or this address has failed too often."""
        now_s = self._clock_s()
        for key, most in self._keys(name, address).items():
            failures = [at_s for at_s in self._failures.get(key, ()) if at_s > now_s - WINDOW_S]
            if len(failures) >= most:
                wait_s = failures[-most] + WINDOW_S - now_s
                raise ThrottledError(
                    say(
                        "too_many_sign_ins",
                        "{count} sign-ins failed within {window:g} minutes, the most is {most}: wait {wait:.0f} "
                        "minutes, then try again",
                        count=len(failures),
                        window=WINDOW_S / 60.0,
                        most=most,
                        wait=wait_s / 60.0,
                    ),
                    wait_s,
                )

    def failed(self, name: str, address: str) -> None:
        """Count a sign-in that failed."""
        now_s = self._clock_s()
        for key in self._keys(name, address):
            failures = [at_s for at_s in self._failures.pop(key, []) if at_s > now_s - WINDOW_S]
            self._failures[key] = [*failures[-MOST_BY_NAME:], now_s]
        while len(self._failures) > _KEPT:
            self._failures.popitem(last=False)

    def succeeded(self, name: str, address: str) -> None:
        """Forget what this name failed from this address."""
        self._failures.pop((name.casefold(), address), None)

    @staticmethod
    def _keys(name: str, address: str) -> dict[tuple[str, str], int]:
        folded = name.casefold()
        return {(folded, address): MOST_BY_BOTH, (folded, ""): MOST_BY_NAME, ("", address): MOST_BY_ADDRESS}
