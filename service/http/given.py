"""What a route is given of the running service: its signature names each part by its type, and it gets no others.

``async def get_test(test_id: str, runs: Given[Runs]) -> RunView`` gets the service's ``Runs``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from fastapi import Depends, FastAPI, Request

Part = TypeVar("Part")


def give(app: FastAPI, parts: Mapping[type, object]) -> None:
    """Hand parts of the service, each by the type that routes name, to its application."""
    app.state.given = {**getattr(app.state, "given", {}), **parts}


def part_if_given(app: FastAPI, kind: type[Part]) -> Part | None:
    """Return a part of the service; None where the application was not given it, or not yet."""
    part = getattr(app.state, "given", {}).get(kind)
    assert part is None or isinstance(part, kind)
    return part


def part_of(app: FastAPI, kind: type[Part]) -> Part:
    """Return a part of a service that has started."""
    part = part_if_given(app, kind)
    assert part is not None, f"the application was given no {kind.__name__}"
    return part


@dataclass(frozen=True, slots=True)
class OfRequest:
    """The dependency that finds the part of one type in the service that got a request."""

    kind: type

    async def __call__(self, request: Request) -> object:  # a function would be called in a thread
        """Return it."""
        return request.app.state.given[self.kind]


if TYPE_CHECKING:
    Given = Annotated[Part, Depends(OfRequest)]
else:

    class Given:
        """``Given[Runs]`` is a ``Runs`` for the type checker, and for FastAPI the dependency that finds it."""

        def __class_getitem__(cls, kind: type) -> Any:
            return Annotated[kind, Depends(OfRequest(kind))]
