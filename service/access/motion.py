"""Who may run which test: valves by the token, sequences and overrides by the role."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.access.needs import require_covers
from service.access.principal import Principal, Right
from service.config.plant import Plant
from service.model.refusals import ForbiddenError
from service.model.sequences import choose_waveform
from valve.messages import say


def require_may_run(
    principal: Principal, plant: Plant, tag: str, sequence: str | None, overrides: Mapping[str, Any]
) -> None:
    """Raise ForbiddenError where the caller may not run this test; an unknown tag is left to whoever looks it up.

    Operators and schedules run approved sequences as they are; engineers any, and with overrides.
    """
    require_covers(principal, tag)
    if principal.may(Right.CONFIGURE):
        return
    if overrides:
        raise ForbiddenError(
            say(
                "overrides_of_engineer",
                "{tag}: {name} is {role}, overrides are an engineer's: run the sequence as it is, or ask an engineer",
                tag=tag[:64],
                name=principal.name,
                role=principal.role.value,
            )
        )
    approved = plant.service.access.approved_sequences
    valve = plant.valves.get(tag)
    if approved is None or valve is None:
        return
    name = sequence or choose_waveform(None, {}, valve.nameplate, valve.wiring.limits).name
    if name not in approved:
        raise ForbiddenError(
            say(
                "sequence_not_approved",
                "{tag}: sequence {name} is not approved for {role}: choose one of {approved:, }, or ask an engineer",
                tag=tag,
                name=name[:64],
                role=principal.role.value,
                approved=tuple(sorted(approved)),
            )
        )
