"""Published parameter sets, one cited file each; add one by its file and a line in PARAMETER_SETS."""

from __future__ import annotations

from typing import Final

from valve.errors import NotFoundError
from valve.messages import say
from valve.parameter_sets import graphite, nominal, rough, vendor
from valve.parameter_sets.base import ParameterSet

PARAMETER_SETS: Final[dict[str, ParameterSet]] = {
    entry.name: entry for entry in (vendor.SET, nominal.SET, rough.SET, graphite.SET)
}


def parameter_set(name: str) -> ParameterSet:
    """Return the set of this name. Raises NotFoundError for another name."""
    if name not in PARAMETER_SETS:
        raise NotFoundError(
            say(
                "parameter_set_unknown",
                "parameter set {name} is unknown: choose one of {choices:, }",
                name=repr(name),
                choices=tuple(PARAMETER_SETS),
            )
        )
    return PARAMETER_SETS[name]


__all__ = ["PARAMETER_SETS", "ParameterSet", "parameter_set"]
