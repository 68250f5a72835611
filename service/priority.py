"""The priority of what works beside the service: below it, as its sampling must not wait."""

from __future__ import annotations

import os
from typing import Final

ANALYSIS: Final = 10  # niceness: beside a busy service a tenth of a core is left to it, of a free core all
AWAITED: Final = 5  # a third: somebody looks at a page until its pictures are there


def stand_back() -> None:
    """Lower the priority of this process, which makes what somebody waits for, before it loads anything."""
    os.nice(AWAITED)
