"""``--override KEY=VALUE``: changes of a sequence, as the ``overrides`` of ``POST /tests/run``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from valve.errors import RequestError
from valve.messages import say


def read_overrides(pairs: Sequence[str]) -> dict[str, Any]:
    """Return KEY=VALUE pairs with their values read as JSON. Raises RequestError."""
    overrides: dict[str, Any] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        try:
            overrides[key.strip()] = json.loads(text)
        except ValueError:
            separator = ""
        if not separator:
            raise RequestError(
                say(
                    "override_form",
                    "--override {pair}: write it as KEY=NUMBER or KEY=[NUMBER, ...]: cycles=2",
                    pair=repr(pair),
                )
            )
    return overrides
