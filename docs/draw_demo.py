"""Draw docs/pictures/demo.svg from a run of the demonstration.

``breakaway demo --once --json | python -m docs.draw_demo`` draws two of the six valves as the terminal
shows them.
"""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from service.cli.demo_plant import DEMO_VALVES
from service.cli.demo_tables import print_test

PICTURE: Final = Path(__file__).parent / "pictures" / "demo.svg"
SHOWN: Final = (DEMO_VALVES[1], DEMO_VALVES[4])  # a healthy one, and one with a tight spot
_COLUMNS: Final = 80
# What rich puts in beside the drawing: fonts that a browser would load from elsewhere, and who made it.
_FOREIGN: Final = re.compile(r"[ \t]*@font-face\s*\{.*?\}\n?|[ \t]*<!--.*?-->\n?", re.DOTALL)
_FONT: Final = re.compile(r"Fira Code, ")


def drawn(demonstration: Mapping[str, Any]) -> str:
    """Return the picture of what the demonstration prints; ``demonstration`` is what ``--json`` gives."""
    tested = {one["tag"]: one for one in demonstration["valves"]}
    console = Console(record=True, width=_COLUMNS, file=io.StringIO())
    for valve in SHOWN:
        print_test(console, valve, tested[valve.tag])
    picture = console.export_svg(title="make demo", unique_id="demo")
    lines = _FONT.sub("", _FOREIGN.sub("", picture)).splitlines()
    return "\n".join(line.rstrip() for line in lines if line.strip()) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(drawn(json.load(sys.stdin)), encoding="utf-8")
