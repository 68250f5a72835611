"""Who asks, and what that allows. A role is a set of rights; what it does not hold is denied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from service.model.requester import Requester, RequesterKind


class Right(StrEnum):
    """What a route may need."""

    VIEW = "view"
    RUN = "run"
    STOP = "stop"
    ACKNOWLEDGE = "acknowledge"
    ANALYZE = "analyze"
    CONFIGURE = "configure"
    SCHEDULE = "schedule"
    ADMINISTER = "administer"


class Role(StrEnum):
    """What a user or a token may be; ``LOCAL`` is whoever calls a service without sign-in, and nobody else."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    ENGINEER = "engineer"
    ADMIN = "admin"
    SCHEDULER = "scheduler"
    LOCAL = "local"


# Every role may stop: a valve goes to its safe value for whoever sees that it should.
_WATCH: Final = frozenset({Right.VIEW, Right.STOP})
_OPERATE: Final = _WATCH | {Right.RUN, Right.ACKNOWLEDGE, Right.ANALYZE}
_ENGINEER: Final = _OPERATE | {Right.CONFIGURE, Right.SCHEDULE}
RIGHTS: Final[Mapping[Role, frozenset[Right]]] = {
    Role.VIEWER: _WATCH,
    Role.OPERATOR: _OPERATE,
    Role.ENGINEER: _ENGINEER,
    Role.ADMIN: _WATCH | {Right.ADMINISTER},  # cannot move valves
    Role.SCHEDULER: _WATCH | {Right.RUN},
    Role.LOCAL: _ENGINEER,
}
_PLANT_WIDE: Final = frozenset({Right.SCHEDULE, Right.ADMINISTER})


@dataclass(frozen=True, slots=True)
class Principal:
    """A caller that is known. ``valves`` limits what it may do to valves, None where nothing does."""

    name: str
    role: Role
    kind: RequesterKind
    csrf_token: str | None = None
    valves: frozenset[str] | None = None

    def may(self, right: Right) -> bool:
        """Return whether the role holds this right; a limit to some valves leaves none over the whole plant."""
        return right in RIGHTS[self.role] and (self.valves is None or right not in _PLANT_WIDE)

    @property
    def requester(self) -> Requester:
        """Who asks, as tests and the audit log keep it."""
        return Requester(self.name, self.kind)


#: Whoever calls a service that listens on loopback without sign-in.
LOCAL_PRINCIPAL: Final = Principal("local", Role.LOCAL, RequesterKind.LOCAL)
