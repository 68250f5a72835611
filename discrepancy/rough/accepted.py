"""A test beside the model that was accepted for its valve: what of it still holds, and what has changed.

The accepted causes are part of the plain valve. Each keeps its shape and, within what it was known to and a tolerance,
its size. A cause whose size is beyond that comes out as a finding, with what it was.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from discrepancy.rough.causes import CAUSES
from discrepancy.rough.causes.base import Cause, Fitted, Shape
from discrepancy.rough.causes.seen import Seen
from discrepancy.rough.causes.spring_preload import SpringPreload
from discrepancy.rough.evidence import Columns, Problem
from discrepancy.rough.saved_model import SavedModel
from discrepancy.rough.selection import column_of
from discrepancy.rough.setting import Setting
from valve.messages import UNITS, Message, say

#: Own choice: a strength that moved by less than this share has not changed, whatever its interval.
TOLERANCE: Final = 0.1
_SURE: Final = 3.0  # standard errors
NOTHING_NEW: Final = say("nothing_new", "Nothing beyond the model that was accepted for this valve.")


@dataclass(frozen=True, slots=True, eq=False)
class Accepted:
    """The model that was accepted, if any, and those of its causes that have a law in the balance: shape and size."""

    model: SavedModel | None = None
    laws: tuple[tuple[Cause, Shape], ...] = ()
    sizes: tuple[Fitted, ...] = ()

    @property
    def causes(self) -> Mapping[str, Mapping[str, Fitted]]:
        """The parameters of all accepted causes."""
        return {} if self.model is None else self.model.causes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes with a law, in their order."""
        return tuple(cause.name for cause, _ in self.laws)

    def columns(self, problem: Problem) -> Columns:
        """Return the laws as columns of the plain valve; their sizes may move within the tolerance."""
        columns = problem.no_columns
        for (cause, shape), size in zip(self.laws, self.sizes, strict=True):
            spread = math.hypot(size.std_error, TOLERANCE / _SURE * abs(size.value))
            columns = columns.with_column(column_of(cause, shape, problem, size.value), spread, size.value)
        return columns

    def candidates(self, setting: Setting) -> list[Cause]:
        """Return all causes to try; one that was accepted is tried in its accepted shape, for a change of its size."""
        known = dict(zip(self.names, self.laws, strict=True))
        return [known[one.name][0] if one.name in known else one(setting) for one in CAUSES]

    def has_changed(self, name: str, seen: Seen) -> bool:
        """Whether a cause that is seen directly was not accepted, or is another than it was."""
        was = self.causes.get(name)
        if was is None:
            return True
        for key, now in seen.fitted.items():
            before = was.get(key)
            if before is None:
                return True
            moved = abs(now.value - before.value)
            if moved > TOLERANCE * abs(before.value) and moved > _SURE * math.hypot(now.std_error, before.std_error):
                return True
        return False

    def words(self, name: str, key: str, now: Fitted, sentence: str) -> str:
        """Return the sentence of a cause, with what its parameter ``key`` was when it was accepted, if it was."""
        was = self.causes.get(name, {}).get(key)
        if was is None:
            return sentence
        if name == SpringPreload.name:
            return say(
                "beside_accepted",
                "{finding} That is beside the {was} that were accepted.",
                finding=sentence,
                was=_number(was),
            )
        if abs(now.value) < max(TOLERANCE * abs(was.value), _SURE * now.std_error):
            return say(
                "accepted_is_gone",
                "What was accepted as {cause} is gone: {key} was {was}.",
                cause=name,
                key=key,
                was=_number(was),
            )
        return say(
            "changed_since_accepted",
            "{finding} Since its model was accepted {key} went from {was} to {now}.",
            finding=sentence,
            key=key,
            was=_number(was),
            now=_number(now),
        )


def accepted_in(model: SavedModel | None, setting: Setting) -> Accepted:
    """Return the accepted model's causes as laws of a valve of this setting; the preload is the nameplate's."""
    if model is None:
        return Accepted()
    laws, sizes = [], []
    for kind in CAUSES:
        entries = model.causes.get(kind.name)
        if entries is None or kind is SpringPreload:
            continue
        names = [entry.name for entry in kind(setting).parameters]
        if any(name not in entries for name in names):
            continue
        shape = tuple(entries[name].value for name in names[1:])
        laws.append((kind(setting, shape), shape))
        sizes.append(entries[names[0]])
    return Accepted(model, tuple(laws), tuple(sizes))


def _number(entry: Fitted) -> Message:
    if entry.unit == "1":
        return say("parameter_of_no_unit", "{value:.3g}", value=entry.value)
    if entry.unit in UNITS:
        return say("parameter_value", "{value:.3g {unit}}", value=entry.value, unit=entry.unit)
    return say("parameter_of_other_unit", "{value:.3g} {unit}", value=entry.value, unit=entry.unit)
