"""What a person says of a file's columns where the headers leave it open: ``position_m=Hub [%]``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from valve.errors import RequestError
from valve.recording_csv import COLUMNS


def parse_mapping(text: str, names: Sequence[str] = COLUMNS) -> dict[str, str]:
    """Return ``position_m=Hub [%],time_s=Zeit [ms]`` as a dictionary, the contract's names first.

    A header may have commas. An empty right side leaves a column out. ``names``: what may stand on the left.
    Raises RequestError.
    """
    if not text.strip():
        return {}
    starts = list(re.finditer(rf"(?:^|,)\s*({'|'.join(names)})\s*=", text))
    if not starts or text[: starts[0].start()].strip():
        raise RequestError(
            f'map {text[:60]!r}: give it as "position_m=Hub [%],time_s=Zeit [ms]": on the left one of '
            f"{', '.join(names)}, on the right a header of the file"
        )
    mapping: dict[str, str] = {}
    for number, start in enumerate(starts):
        end = starts[number + 1].start() if number + 1 < len(starts) else len(text)
        if start[1] in mapping:
            raise RequestError(f"map: {start[1]} is given twice: give each name once")
        mapping[start[1]] = text[start.end() : end].strip().strip(",").strip()
    return mapping
