"""The causes that a balance of forces can show; add one by its entry and a line here."""

from __future__ import annotations

from typing import Final

from discrepancy.force_causes.base import ForceCause
from discrepancy.force_causes.channels import CHANNELS
from discrepancy.force_causes.friction import FRICTION

FORCE_CAUSES: Final[dict[str, ForceCause]] = {entry.name: entry for entry in (*FRICTION, *CHANNELS)}
