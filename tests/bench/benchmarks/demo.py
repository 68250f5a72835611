"""How long ``breakaway demo --once`` takes as a whole command, beside the 90 s that its contract grants."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from datetime import datetime
from typing import Final

from rich.table import Table

_GRANTED_S: Final = 90.0


def run() -> Table:
    """The command's wall clock, the longest motion in it, and what its analyses took beside and after that."""
    began_s = time.monotonic()
    command = [sys.executable, "-m", "service.cli", "demo", "--once", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    took_s = time.monotonic() - began_s
    table = Table("what", "s", title="breakaway demo --once")
    table.add_row("whole command", f"{took_s:.1f}")
    table.add_row("granted", f"{_GRANTED_S:.0f}")
    tests = [made["test"] for made in json.loads(done.stdout)["valves"]]
    moved_s = max(
        (datetime.fromisoformat(test["motion_ended_at"]) - datetime.fromisoformat(test["created_at"])).total_seconds()
        for test in tests
    )
    table.add_row("longest motion", f"{moved_s:.1f}")
    return table
