"""The page on adding a cause: its file is the catalogue's, and its example runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

from discrepancy.rough.causes import SEEN_CAUSES

_ROOT: Final = Path(__file__).parents[2]
_BLOCKS: Final = re.findall(
    r"^```python\n(.*?)^```$",
    (_ROOT / "docs/developing/adding-a-cause.md").read_text("utf-8"),
    re.DOTALL | re.MULTILINE,
)


def test_the_file_on_the_page_is_the_catalogues() -> None:
    assert _BLOCKS[0] == (_ROOT / "discrepancy/rough/causes/positioner_dead_band.py").read_text("utf-8")
    assert "positioner_dead_band" in [one.name for one in SEEN_CAUSES]


def test_the_example_on_the_page_finds_the_dead_band_and_nothing_where_there_is_none() -> None:
    names: dict[str, Any] = {}
    for block in _BLOCKS[1:]:
        exec(compile(block, "adding-a-cause.md", "exec"), names)
    assert names["found"].message.startswith("The pressure follows only when the command has turned back by 1.5")
    assert len(_BLOCKS) == 3
