"""Where a test left its valve, as the commands say it: the service's own sentence."""

from __future__ import annotations

import time
from typing import Any, Final
from urllib.parse import quote

import httpx

from drivers.stands_at import StemVerdict
from service.cli.client import asked

_POLL_S: Final = 0.25
_BEYOND_S: Final = 15.0  # on top of the set time: the look itself, and a test of another valve that ends on its bus


def stands_of(test: dict[str, Any]) -> str:
    """Return signal and stem in words; "" for a test that has not come to rest."""
    return "" if test["stands"] is None else str(test["stands"]["sentence"])


def is_moving(test: dict[str, Any]) -> bool:
    """Whether the stem was not looked at yet."""
    return test["stands"] is not None and test["stands"]["verdict"] == StemVerdict.MOVING.value


def is_astray(test: dict[str, Any]) -> bool:
    """Whether the stem was not seen at its declared safe position."""
    return test["stands"] is not None and StemVerdict(test["stands"]["verdict"]).is_alarm


def looked_at(client: httpx.Client, test: dict[str, Any]) -> dict[str, Any]:
    """Return a test as it stands once its stem was looked at, or as it does when the time for that is over."""
    if test["stands"] is None:
        return test
    until_s = time.monotonic() + test["stands"]["due_s"] + _BEYOND_S
    while is_moving(test) and time.monotonic() < until_s:
        time.sleep(_POLL_S)
        test = asked(client, "GET", f"/tests/{quote(test['id'], safe='')}")
    return test
