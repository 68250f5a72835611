"""The problem document as the OpenAPI page describes it."""

from __future__ import annotations

from typing import Any, Final

from pydantic import BaseModel, ConfigDict


class Problem(BaseModel):
    """A problem document (RFC 9457)."""

    model_config = ConfigDict(extra="allow")
    type: str
    title: str
    status: int
    detail: str
    instance: str


PROBLEMS: Final[dict[int | str, dict[str, Any]]] = {
    status: {
        "description": description,
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    for status, description in (
        (400, "The request cannot be read"),
        (401, "Nobody is signed in, or the token is over"),
        (403, "Whoever asks may not do this"),
        (404, "Unknown tag or test"),
        (406, "No format that the client accepts"),
        (408, "The request came too slowly"),
        (409, "The valve or its bus is busy"),
        (413, "The request is too large"),
        (415, "The body is of another type than the route takes"),
        (422, "The request is understood and wrong"),
        (423, "A permissive is missing: nothing moved"),
        (429, "Too many sign-ins failed, or too many uploads wait"),
    )
}
