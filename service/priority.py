"""The priority of what works beside the service: below it, as its sampling must not wait."""

from __future__ import annotations

import os
from typing import Final

NICENESS: Final = 10  # beside a busy service a tenth of a core is left to it, on a free core all of it


def stand_back() -> None:
    """Lower the priority of this process, before it loads anything."""
    os.nice(NICENESS)
