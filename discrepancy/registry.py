"""The causes that can be named; add one by its entry and a line here."""

from __future__ import annotations

from typing import Final

from discrepancy.causes.base import Cause
from discrepancy.causes.channels import CHANNELS
from discrepancy.causes.forces import FORCES
from discrepancy.causes.friction import FRICTION

CAUSES: Final[dict[str, Cause]] = {entry.name: entry for entry in (*FRICTION, *FORCES, *CHANNELS)}
